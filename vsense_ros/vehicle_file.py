"""Vehicle files: reading one, with errors that name the line and the key, and writing one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from vsense_ros.errors import InputError
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.tir import read_tir


def load_vehicle(path: str | Path) -> Vehicle:
    """Read and validate a vehicle file.

    A tyre `{model: magic_formula, tir: FILE}` is read from a `.tir` file, its name relative to the vehicle file. Other
    keys beside `tir` replace what the file says; `axes: adapted_sae` says that y points to the right in it.

    Raises `InputError` that names file, line, key, what was found and what is allowed, one line for each fault.
    """
    path = Path(path)
    try:
        tree = YAML().load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such vehicle file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise InputError(f"{path}:{line}: not valid YAML: {error.problem}") from None
    except YAMLError as error:
        raise InputError(f"{path}: not valid YAML: {error}") from None
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{path}: expected a mapping with the keys {', '.join(Vehicle.model_fields)}")
    try:
        return Vehicle.model_validate(_resolved(path, tree))
    except ValidationError as error:
        raise InputError("\n".join(_fault(path, tree, fault) for fault in error.errors())) from None


def save_vehicle(path: str | Path, vehicle: Vehicle) -> None:
    """Write a vehicle file with all its values spelt out."""
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    with Path(path).open("w", encoding="utf-8") as file:
        yaml.dump(vehicle.model_dump(mode="json"), file)


def _resolved(path: Path, tree: CommentedMap) -> Any:
    """The file's content, with the parameters of `.tir` files in the place of their names."""
    plain = _plain(tree)
    physics = plain.get("physics")
    for axle in ("front", "rear"):
        part = physics.get(axle) if isinstance(physics, dict) else None
        tyre = part.get("tyre") if isinstance(part, dict) else None
        if not isinstance(tyre, dict) or "tir" not in tyre or not isinstance(part, dict):
            continue
        data = tree["physics"][axle]["tyre"].lc.data or {}
        line = data["tir"][0] + 1 if "tir" in data else "?"
        where = f"{path}:{line}: physics.{axle}.tyre.tir"
        if tyre.get("model") != "magic_formula":
            raise InputError(f"{where}: only a tyre of `model: magic_formula` is read from a .tir file")
        axes = tyre.get("axes", "iso")
        if axes not in ("iso", "adapted_sae"):
            raise InputError(f"{where}: axes: expected iso or adapted_sae, found {axes!r}")
        changes = {key: value for key, value in tyre.items() if key not in ("tir", "axes")}
        try:
            part["tyre"] = read_tir(path.parent / str(tyre["tir"]), axes, changes).model_dump()
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    return plain


def _plain(node: Any) -> Any:
    if isinstance(node, dict):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node]
    if isinstance(node, bool) or node is None or isinstance(node, str):
        return node
    if isinstance(node, int):
        return int(node)
    return float(node) if isinstance(node, float) else node


def _fault(path: Path, tree: CommentedMap, fault: Any) -> str:
    """One line for one fault; the location of a tagged union carries the tag, which is no key of the file."""
    node: Any = tree
    line = tree.lc.line + 1
    keys: list[str] = []
    for step in fault["loc"]:
        if isinstance(node, CommentedMap) and step in node:
            line = node.lc.key(step)[0] + 1
            node = node[step]
        elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
            line = node.lc.item(step)[0] + 1
            node = node[step]
        elif fault["type"] != "missing" or step != fault["loc"][-1]:
            continue
        keys.append(str(step))
    where = f"{path}:{line}: {'.'.join(keys) or 'file'}"
    if fault["type"] == "missing":
        return f"{where}: missing; expected {_expectation(fault['loc'])}"
    if fault["type"] == "extra_forbidden":
        return f"{where}: unknown key; remove it or correct its spelling"
    found = fault["input"]
    shown = f", found {found!r}" if isinstance(found, str | int | float | bool) or found is None else ""
    message = fault["msg"].removeprefix("Value error, ")
    return f"{where}: {message[:1].lower() + message[1:]}{shown}{_unit(fault['loc'])}"


def _field(location: tuple[Any, ...]) -> FieldInfo | None:
    """The schema's field at a location, or None."""
    model: Any = Vehicle
    field = None
    for step in location:
        fields = getattr(model, "model_fields", {})
        if step not in fields:
            return None
        field = fields[step]
        model = field.annotation
    return field


def _unit(location: tuple[Any, ...]) -> str:
    field = _field(location)
    extra = field.json_schema_extra if field else None
    return f" (a number in {extra['unit']})" if isinstance(extra, dict) and "unit" in extra else ""


def _expectation(location: tuple[Any, ...]) -> str:
    field = _field(location)
    return f"{field.description}{_unit(location)}" if field and field.description else "a value"
