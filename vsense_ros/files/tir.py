"""Tyre property files (`.tir`): read into the parameters of a Magic Formula tyre.

The format is that of ini files: sections in brackets, `KEY = value`, strings in quotes, comments behind `$` or `!`.
Only dimensional values follow the section UNITS; coefficients are those of SI units and radians in every file.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from vsense_ros.errors import InputError
from vsense_ros.model.parameter import Part
from vsense_ros.model.tyres.magic_formula import MagicFormula
from vsense_ros.model.tyres.magic_formula_coefficients import (
    ASYMMETRIC,
    Aligning,
    Lateral,
    Longitudinal,
    Scaling,
    adapted_sae_to_iso,
)

Axes = Literal["iso", "adapted_sae"]

# FITTYP, by the version of the Magic Formula that it stands for.
VERSIONS = {5: 5.2, 6: 5.2, 21: 5.2, 51: 5.2, 52: 5.2, 60: 6.1, 61: 6.1, 62: 6.1}
FORMATS = ("MF-TYRE", "MF_05", "PAC2002", "USER")

UNITS: dict[str, dict[str, float]] = {
    "LENGTH": {"meter": 1, "m": 1, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "millimeter": 1e-3, "inch": 0.0254,
               "foot": 0.3048},
    "FORCE": {
        "newton": 1, "n": 1, "kilo_newton": 1e3, "kilonewton": 1e3, "kn": 1e3,
        "pound_force": 4.4482216152605, "lbf": 4.4482216152605, "kilogram_force": 9.80665, "kgf": 9.80665,
    },
    "ANGLE": {"radians": 1, "radian": 1, "rad": 1, "degrees": 0.017453292519943295, "deg": 0.017453292519943295},
    "TIME": {"second": 1, "sec": 1, "s": 1, "millisecond": 1e-3, "ms": 1e-3},
    "PRESSURE": {"pascal": 1, "pa": 1, "kpa": 1e3, "kilopascal": 1e3, "bar": 1e5, "psi": 6894.757293168},
}  # fmt: skip

# Dimensional keys: where they go, and of which units, with exponents, they are.
_DIMENSIONAL: dict[str, tuple[str, dict[str, int]]] = {
    "FNOMIN": ("nominal_load", {"FORCE": 1}),
    "UNLOADED_RADIUS": ("unloaded_radius", {"LENGTH": 1}),
    "FZMIN": ("smallest_load", {"FORCE": 1}),
    "FZMAX": ("largest_load", {"FORCE": 1}),
    "CAMMAX": ("largest_camber", {"ANGLE": 1}),
    "NOMPRES": ("nominal_pressure", {"PRESSURE": 1}),
    "INFLPRES": ("inflation_pressure", {"PRESSURE": 1}),
    "LONGVL": ("reference_speed", {"LENGTH": 1, "TIME": -1}),
    "LONGITUDINAL_STIFFNESS": ("longitudinal_stiffness", {"FORCE": 1, "LENGTH": -1}),
    "LATERAL_STIFFNESS": ("lateral_stiffness", {"FORCE": 1, "LENGTH": -1}),
}
_GROUPS: dict[str, type[Part]] = {
    "longitudinal": Longitudinal,
    "lateral": Lateral,
    "aligning": Aligning,
    "scaling": Scaling,
}
_OTHER_NAMES = {"LGYR": "lres", "LKYG": "lkyc", "LKZG": "lkzc", "LKXK": "lkx", "LKYA": "lky", "IP": "INFLPRES"}
# Keys that are read outside of the section UNITS.
_KEYS = {
    *("PROPERTY_FILE_FORMAT", "FITTYP", "TYRESIDE"), *_DIMENSIONAL, *_OTHER_NAMES,
    *(name.upper() for group in _GROUPS.values() for name in group.model_fields),
}  # fmt: skip
_LARGEST = 4 << 20  # [byte] that are read
_LEAST_LOAD = 0.02  # of the nominal load, where FZMIN is smaller or missing
_MOST_LOAD = 2.5  # of the nominal load, where FZMAX is missing


@dataclass(frozen=True, slots=True)
class _Entry:
    text: str
    line: int


def read_tir(path: str | Path, axes: Axes = "iso", changes: Mapping[str, Any] | None = None) -> MagicFormula:
    """The Magic Formula tyre of a `.tir` file; `changes` to its parameters, as in a vehicle file, take precedence.

    `axes` says which way y points in the file; nearly all files are ISO (TYDEX W axes). Keys that the model has no use
    for (overturning moment, rolling resistance, turn slip, vertical stiffness) are passed over. Raises `InputError`
    that names file, line, key, what was found and what is expected.
    """
    path = Path(path)
    entries = _entries(path)
    data = _parameters(path, entries, axes)
    _merge(data, changes or {})
    try:
        return MagicFormula.model_validate(data)
    except ValidationError as error:
        raise InputError("\n".join(_fault(path, entries, fault) for fault in error.errors())) from None


def _entries(path: Path) -> dict[str, _Entry]:
    """Values of the keys that the model uses, upper case, with their lines."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: not a regular file; expected a tyre property file (.tir)")
    try:
        with path.open("rb") as file:
            lines = file.read(_LARGEST).decode("utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        raise InputError(f"{path}: no such tyre file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    entries: dict[str, _Entry] = {}
    section = ""
    for number, line in enumerate(lines, 1):
        text = re.split(r"[$!]", line, maxsplit=1)[0].strip()
        if not text:
            continue
        if heading := re.fullmatch(r"\[\s*([^\]]+?)\s*\]", text):
            section = heading.group(1).upper()
            continue
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            if section.endswith("COEFFICIENTS") or section in ("UNITS", "MODEL", "VERTICAL"):
                raise InputError(f"{path}:{number}: expected KEY = value in section [{section}], found {text!r}")
            continue  # tables, like that of the section SHAPE
        key = key.upper()
        if key not in (UNITS if section == "UNITS" else _KEYS):
            continue
        entry = _Entry(value.strip("'\" "), number)
        if not entry.text:  # written so by tools for what was not set
            continue
        if key in entries and entries[key].text != entry.text:
            raise InputError(
                f"{path}:{number}: {key} = {entry.text} contradicts line {entries[key].line}, where it is "
                f"{entries[key].text}; remove one of them"
            )
        entries.setdefault(key, entry)
    if not entries:
        raise InputError(f"{path}: no tyre property file: expected sections like [MODEL] with lines KEY = value")
    return entries


def _number(path: Path, key: str, entry: _Entry) -> float:
    try:
        return float(re.sub(r"(?<=[0-9.])[dD](?=[+-]?\d)", "e", entry.text))
    except ValueError:
        raise InputError(f"{path}:{entry.line}: {key}: expected a number, found {entry.text!r}") from None


def _units(path: Path, entries: Mapping[str, _Entry]) -> dict[str, float]:
    """Size of each of the file's units in SI units."""
    sizes = {}
    for quantity, sizes_by_unit in UNITS.items():
        entry = entries.get(quantity)
        name = entry.text.lower() if entry else next(iter(sizes_by_unit))
        if name not in sizes_by_unit:
            line = f":{entry.line}" if entry else ""
            raise InputError(f"{path}{line}: {quantity}: unknown unit {name!r}; known are {', '.join(sizes_by_unit)}")
        sizes[quantity] = sizes_by_unit[name]
    return sizes


def _version(path: Path, entries: Mapping[str, _Entry]) -> float:
    form = entries.get("PROPERTY_FILE_FORMAT")
    if form and form.text.upper().replace(" ", "") not in FORMATS:
        raise InputError(
            f"{path}:{form.line}: PROPERTY_FILE_FORMAT {form.text!r} is no Magic Formula of version 5.2 or 6; "
            f"expected one of {', '.join(FORMATS)}"
        )
    entry = entries.get("FITTYP")
    if entry is None:
        if form and form.text.upper() == "PAC2002":
            return 5.2
        raise InputError(f"{path}: FITTYP is missing in section [MODEL]: it says which Magic Formula this is; add it")
    number = _number(path, "FITTYP", entry)
    if number not in VERSIONS:
        raise InputError(
            f"{path}:{entry.line}: FITTYP {entry.text} is not supported; expected one of "
            f"{', '.join(map(str, VERSIONS))} (MF 5.2 and MF 6)"
        )
    return VERSIONS[int(number)]


def _parameters(path: Path, entries: dict[str, _Entry], axes: Axes) -> dict[str, Any]:
    """Fields of a Magic Formula tyre in SI units and ISO axes."""
    units = _units(path, entries)
    data: dict[str, Any] = {"model": "magic_formula", "version": _version(path, entries)}
    for other_name, key in _OTHER_NAMES.items():
        if other_name in entries:
            entries.setdefault(key.upper(), entries[other_name])
    for key, (name, dimensions) in _DIMENSIONAL.items():
        if key in entries:
            data[name] = _number(path, key, entries[key])
            for quantity, exponent in dimensions.items():
                data[name] *= units[quantity] ** exponent
    side = _side(path, entries)
    data["measured_side"] = -1.0 if side == "RIGHT" else 1.0
    coefficients = _coefficients(path, entries, axes, symmetric=side in ("SYMMETRIC", "BOTH"))
    for name, group in _GROUPS.items():
        data[name] = {key: value for key, value in coefficients.items() if key in group.model_fields}
    if (load := data.get("nominal_load")) is not None:
        data["smallest_load"] = max(data.get("smallest_load", 0.0), _LEAST_LOAD * load)
        data.setdefault("largest_load", _MOST_LOAD * load)
    if "inflation_pressure" in data:
        data.setdefault("nominal_pressure", data["inflation_pressure"])
    elif "nominal_pressure" in data:
        data["inflation_pressure"] = data["nominal_pressure"]
    return data


def _side(path: Path, entries: Mapping[str, _Entry]) -> str:
    """Side of the car that the tyre was measured for. Raises `InputError` for an unknown one."""
    side = entries["TYRESIDE"].text.upper() if "TYRESIDE" in entries else "LEFT"
    if side not in ("LEFT", "RIGHT", "SYMMETRIC", "BOTH", "UNKNOWN"):
        raise InputError(
            f"{path}:{entries['TYRESIDE'].line}: TYRESIDE: expected LEFT, RIGHT or SYMMETRIC, found {side!r}"
        )
    return side


def _coefficients(path: Path, entries: Mapping[str, _Entry], axes: Axes, symmetric: bool) -> dict[str, float]:
    """Dimensionless coefficients in ISO axes; those that make a tyre asymmetric are zero for a `symmetric` one. Raises
    `InputError` where the sign of the cornering stiffness contradicts the axes."""
    coefficients = {
        name: _number(path, name.upper(), entries[name.upper()])
        for group in _GROUPS.values()
        for name in group.model_fields
        if name.upper() in entries
    }
    if coefficients.get("pty1") == 0.0 or coefficients.get("pty2") == 0.0:  # not measured for relaxation
        logging.getLogger(__name__).warning("%s: PTY1 or PTY2 is 0: the lateral force follows without a lag", path)
        coefficients |= {"pty1": 0.0}
        coefficients.pop("pty2", None)
    if symmetric:
        coefficients |= dict.fromkeys(ASYMMETRIC, 0.0)
    if axes == "adapted_sae":
        coefficients = adapted_sae_to_iso(coefficients)
    if coefficients.get("pky1", -1.0) > 0:
        other_axes = "iso" if axes == "adapted_sae" else "adapted_sae"
        raise InputError(
            f"{path}:{entries['PKY1'].line}: PKY1 {entries['PKY1'].text} has the wrong sign for {axes} axes: the "
            f"lateral force would push the tyre on; if the file's axes are others, say `axes: {other_axes}`"
        )
    return coefficients


def _merge(data: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(data.get(key), dict):
            _merge(data[key], value)
        else:
            data[key] = value


def _fault(path: Path, entries: Mapping[str, _Entry], fault: Any) -> str:
    name = str(fault["loc"][-1]) if fault["loc"] else ""
    key = next((key for key, (field, _) in _DIMENSIONAL.items() if field == name), name.upper())
    if fault["type"] == "missing":
        return f"{path}: {key or 'a section'} is missing; add it"
    place = f"{path}:{entries[key].line}: {key}: " if key in entries else f"{path}: {f'{name}: ' if name else ''}"
    value = f", found {fault['input']!r}" if isinstance(fault["input"], str | int | float) else ""
    return f"{place}{fault['msg'].removeprefix('Value error, ')}{value}"
