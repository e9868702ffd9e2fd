"""Units of measured quantities: their size in SI, and the spellings in which files and databases write them.

One table for whoever reads units: CAN databases and mappings, columns of tables, channels of measurement files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

_DEG = math.pi / 180.0
_G = 9.80665  # [m/s²]

# Units by quantity, each with its size in the first one, which is that of the messages.
QUANTITIES: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "angle": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3},
        "angular velocity": {"rad/s": 1.0, "deg/s": _DEG, "rpm": 2 * math.pi / 60, "mrad/s": 1e-3},
        "angular acceleration": {"rad/s²": 1.0, "deg/s²": _DEG},
        "velocity": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600, "mm/s": 1e-3, "cm/s": 1e-2},
        "acceleration": {"m/s²": 1.0, "g": _G, "mg": _G * 1e-3},
        "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "km": 1e3},
        "torque": {"N m": 1.0, "kN m": 1e3},
        "force": {"N": 1.0, "kN": 1e3},
        "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": 6894.757293168},
        "time": {"s": 1.0, "ms": 1e-3, "100us": 1e-4, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0},
        "number": {"1": 1.0},
    }
)

# Other spellings, lower case and without blanks, of units above. Those of Ford's databases begin with `unit_`.
_SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "unit_degreeofarc": "deg", "unit_degreofarc": "deg",
    "radian": "rad", "radians": "rad", "unit_radia": "rad",
    "°/s": "deg/s", "°/sec": "deg/s", "deg/sec": "deg/s", "degree/s": "deg/s", "degrees/s": "deg/s",
    "degree/sec": "deg/s", "degpersec": "deg/s", "dps": "deg/s", "grad/s": "deg/s", "deg/second": "deg/s",
    "degree/second": "deg/s", "degrees/sec": "deg/s", "degrees/second": "deg/s",
    "rad/sec": "rad/s", "radians/s": "rad/s", "radian/s": "rad/s", "rad/second": "rad/s", "unit_radiapersecon": "rad/s",
    "1/min": "rpm", "u/min": "rpm", "r/min": "rpm", "rev/min": "rpm", "min-1": "rpm", "/min": "rpm",
    "unit_minutinver": "rpm",
    "kph": "km/h", "kmh": "km/h", "km/hr": "km/h", "kmph": "km/h", "km/hour": "km/h", "unit_kilometerperhour": "km/h",
    "mi/h": "mph", "miles/h": "mph", "knot": "kn", "knots": "kn", "kts": "kn", "kt": "kn",
    "m/sec": "m/s", "mps": "m/s", "meter/s": "m/s", "meters/s": "m/s", "meters/second": "m/s",
    "metres/second": "m/s", "meter/second": "m/s", "metre/s": "m/s", "unit_meterpersecon": "m/s",
    "m/s^2": "m/s²", "m/s2": "m/s²", "m/s/s": "m/s²", "m/s**2": "m/s²", "m/(s^2)": "m/s²", "m/sec^2": "m/s²",
    "m/sec2": "m/s²", "mpss": "m/s²", "mps2": "m/s²", "ms-2": "m/s²", "unit_meterperseconsquar": "m/s²",
    "meter/s^2": "m/s²", "gn": "g", "g_n": "g",
    "rad/s^2": "rad/s²", "rad/s2": "rad/s²", "deg/s^2": "deg/s²", "deg/s2": "deg/s²", "°/s²": "deg/s²",
    "°/s^2": "deg/s²", "°/s2": "deg/s²",
    "meter": "m", "metre": "m", "meters": "m", "metres": "m", "unit_meter": "m", "foot": "ft", "feet": "ft",
    "nm": "N m", "n*m": "N m", "n.m": "N m", "n-m": "N m", "n·m": "N m", "newtonmeter": "N m", "unit_newtometer": "N m",
    "knm": "kN m", "n": "N", "newton": "N", "kn(force)": "kN",
    "pascal": "Pa", "pa": "Pa", "kpa": "kPa", "unit_kilopasca": "kPa", "unit_bar": "bar",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms",
    "µs": "us", "μs": "us", "usec": "us", "microsecond": "us", "microseconds": "us",
    "nsec": "ns", "nanosecond": "ns", "nanoseconds": "ns", "minute": "min", "minutes": "min", "hour": "h", "hours": "h",
    "day": "d", "days": "d",
    "-": "1", "": "1", "unitless": "1",
}  # fmt: skip
_EXACT = {"Nm": "N m", "kNm": "kN m", "MPa": "MPa", "mPa": "", "kN": "kN", "KN": "kN", "kn": "kn", "nm": "", "G": "g"}
_KNOWN = {unit: quantity for quantity, units in QUANTITIES.items() for unit in units}
_LOWER: dict[str, str] = {}
for _unit in _KNOWN:
    _LOWER.setdefault(_unit.lower().replace(" ", ""), _unit)


def canonical(text: str) -> str | None:
    """The unit that a text means, as it stands in `QUANTITIES`; None where it is none of these, or could be several.

    A degree sign is also found where a file was read in a wrong encoding.
    """
    text = text.strip().strip("[]()").strip()
    if text in _KNOWN:
        return text
    if text in _EXACT:
        return _EXACT[text] or None
    plain = text.replace("Â", "").replace("º", "°").replace("˚", "°").replace("\ufffd", "°").replace("â", "").lower()
    plain = "".join(plain.split())
    return _SPELLINGS.get(plain) or _LOWER.get(plain)


def quantity_of(unit: str) -> str | None:
    """The quantity of a unit in any spelling; None where it is not known."""
    symbol = canonical(unit)
    return None if symbol is None else _KNOWN[symbol]


def to_si(unit: str) -> float:
    """Size in SI units of a unit in any spelling; `KeyError` where it is not known."""
    symbol = canonical(unit)
    if symbol is None:
        raise KeyError(unit)
    return QUANTITIES[_KNOWN[symbol]][symbol]


def contradiction(stated: str, declared: str) -> bool:
    """True if a source's own unit and one that somebody says it has are both known and not the same."""
    stated_symbol, declared_symbol = canonical(stated), canonical(declared)
    return (
        stated.strip() not in ("", "-", "1")
        and stated_symbol is not None
        and declared_symbol is not None
        and stated_symbol != declared_symbol
    )
