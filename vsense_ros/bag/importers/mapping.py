"""From columns of any table or measurement file to topics, as a YAML file says.

    time: {column: t, unit: s, start: 2018-08-20T21:00:00Z}   # start: time of t = 0; without it t is Unix time
    delimiter: ";"                                            # CSV only; also decimal, skip_lines
    topics:
      imu/data:
        angular_velocity: [null, null, {column: yaw_rate, unit: deg/s, sign: -1}]
        linear_acceleration: [{column: ax, unit: g}, {column: ay, unit: g}, null]
      vehicle/wheel_speeds:
        velocity:
          wheel_fl: {column: v_fl, unit: km/h, radius: 0.33}  # radius [m]: from speed at the rim to rad/s
      vehicle/steering:
        position: {steering_wheel: {column: delta, unit: deg, offset: -1.5}}
      gps/fix: {latitude: {column: lat, unit: deg}, longitude: {column: lon, unit: deg}, altitude: null}
      gps/velocity: {speed: {column: v, unit: km/h}, course: {column: heading, unit: deg}}

A value is `sign * (scale * raw + offset)` in `unit`, turned into SI. `null` and fields left out are absent (NaN).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import FIELDS, Channel, Recording
from vsense_ros.messages.topics import TOPICS, WHEELS

_G = 9.80665  # [m/s²]
_DEG = np.pi / 180.0

UNITS: Mapping[str, Mapping[str, float]] = {
    "angle": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3},
    "angular velocity": {"rad/s": 1.0, "deg/s": _DEG, "rpm": 2 * np.pi / 60},
    "angular acceleration": {"rad/s²": 1.0, "rad/s2": 1.0, "deg/s²": _DEG, "deg/s2": _DEG},
    "velocity": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600},
    "acceleration": {"m/s²": 1.0, "m/s2": 1.0, "g": _G, "mg": _G * 1e-3},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048},
    "geographic angle": {"deg": 1.0, "rad": 180.0 / np.pi, "min": 1 / 60},
    "torque": {"N m": 1.0, "Nm": 1.0, "kNm": 1e3},
    "force": {"N": 1.0, "kN": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "number": {"": 1.0, "1": 1.0},
}

# The quantity of each field that a mapping may fill, by message type and topic; `speed`, `course` and `yaw` are
# other ways to say a velocity and an orientation.
_IMU = {"angular_velocity": "angular velocity", "linear_acceleration": "acceleration", "yaw": "angle"}
_QUANTITIES: Mapping[str, Mapping[str, str]] = {
    "imu/data": _IMU,
    "gps/attitude": _IMU,
    "gps/fix": {"latitude": "geographic angle", "longitude": "geographic angle", "altitude": "length"},
    "gps/velocity": {"linear": "velocity", "speed": "velocity", "course": "angle", "up": "velocity"},
    "vehicle/wheel_speeds": {"velocity": "angular velocity"},
    "vehicle/steering": {"position": "angle"},
    "vehicle/wheel_torques": {"effort": "torque"},
    "vehicle/brake_pressure": {"effort": "pressure"},
    "vehicle/suspension": {"position": "length"},
    "reference/odometry": {
        "position": "length",
        "yaw": "angle",
        "linear": "velocity",
        "angular": "angular velocity",
    },
    "reference/acceleration": {"linear": "acceleration", "angular": "angular acceleration"},
    **{f"reference/wheel_force/{w}": {"force": "force", "torque": "torque"} for w in WHEELS},
}

Columns = Callable[[str], tuple[Array, Array]]
"""Times [s] and raw values of a column by its name; raises `InputError` if there is no such column."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Signal(_Model):
    """Where a value comes from and what is done to it."""

    column: str
    unit: str
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[1, -1] = 1
    radius: Annotated[float, Field(gt=0)] | None = None


def _form(value: object) -> str:
    """Which of the forms of a field this is; tells pydantic which one to check."""
    if isinstance(value, list):
        return "three signals"
    if isinstance(value, Mapping) and value and all(isinstance(inner, Mapping) for inner in value.values()):
        return "signals by name"
    return "absent" if value is None else "signal"


FieldMapping = Annotated[
    Annotated[Signal, Tag("signal")]
    | Annotated[list[Signal | None], Tag("three signals")]
    | Annotated[dict[str, Signal], Tag("signals by name")]
    | Annotated[None, Tag("absent")],
    Discriminator(_form),
]


class Time(_Model):
    """The time column. MDF4 files bring their own time; there `column` is left out."""

    column: str | None = None
    unit: str = "s"
    start: datetime | None = None


class ColumnMapping(_Model):
    """A mapping file."""

    time: Time = Time()
    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    skip_lines: Annotated[int, Field(ge=0)] = 0
    topics: dict[str, dict[str, FieldMapping]]

    def columns(self) -> list[str]:
        """Names of all columns that topics use."""
        return [s.column for fields in self.topics.values() for value in fields.values() for s in _signals(value)]


def load(source: str | Path | Mapping[str, Any], path: Path) -> ColumnMapping:
    """The mapping for the file `path`, checked; `source` is a YAML file or its content.

    Raises `InputError` naming the file, the key, what was found and what is allowed.
    """
    where = "mapping"
    content: Any = source
    if not isinstance(source, Mapping):
        where = str(source)
        try:
            content = YAML(typ="safe", pure=True).load(Path(source).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"{source}: no such mapping file for {path.name}") from None
        except (YAMLError, OSError, UnicodeDecodeError) as error:
            raise InputError(f"{source}: not a YAML file: {error}") from None
    try:
        mapping = ColumnMapping.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        forms = ("signal", "three signals", "signals by name", "absent")
        key = ".".join(str(part) for part in first["loc"] if part not in forms)
        raise InputError(f"{where}: {key or 'file'}: {first['msg']}, found {first['input']!r}") from None
    for topic, fields in mapping.topics.items():
        _check(where, topic, fields)
    return mapping


def default_mapping(path: Path, mapping: str | Path | Mapping[str, Any] | None) -> str | Path | Mapping[str, Any]:
    """The given mapping, or the YAML file beside the data."""
    if mapping is not None:
        return mapping
    for candidate in (path.with_suffix(".yaml"), path.with_suffix(".yml")):
        if candidate.exists():
            return candidate
    raise InputError(
        f"{path}: which column is what? Expected a mapping file {path.with_suffix('.yaml').name} beside it or the "
        "option mapping; see vsense_ros/bag/importers/mapping.py for its form"
    )


def _check(where: str, topic: str, fields: Mapping[str, Any]) -> None:
    if topic not in TOPICS:
        raise InputError(f"{where}: topics: {topic!r} is no topic of this project; known: {', '.join(TOPICS)}")
    for name, value in fields.items():
        quantities = _QUANTITIES[topic]
        if name not in quantities:
            raise InputError(f"{where}: {topic}: no field {name!r}; known: {', '.join(quantities)}")
        named = TOPICS[topic].names
        if named and not isinstance(value, dict):
            raise InputError(f"{where}: {topic}.{name}: expected one signal per name ({', '.join(named)})")
        if isinstance(value, dict):
            wrong = [joint for joint in value if joint not in named]
            if wrong:
                raise InputError(f"{where}: {topic}.{name}: unknown {wrong[0]!r}; known: {', '.join(named) or 'none'}")
        if isinstance(value, list) and len(value) != 3:
            raise InputError(f"{where}: {topic}.{name}: {len(value)} values, expected three: x, y, z")
        for signal in _signals(value):
            _factor(where, f"{topic}.{name}", signal, quantities[name])


def _signals(value: Signal | list[Signal | None] | dict[str, Signal] | None) -> list[Signal]:
    if isinstance(value, Signal):
        return [value]
    if isinstance(value, dict):
        return list(value.values())
    return [signal for signal in value or [] if signal is not None]


def _factor(where: str, key: str, signal: Signal, quantity: str) -> float:
    """Factor to SI of a signal."""
    if signal.radius is not None:
        if quantity != "angular velocity" or signal.unit not in UNITS["velocity"]:
            raise InputError(
                f"{where}: {key}: a radius turns a speed ({', '.join(UNITS['velocity'])}) into an angular velocity; "
                f"found unit {signal.unit!r} for a field that is an {quantity}"
            )
        return UNITS["velocity"][signal.unit] / signal.radius
    if signal.unit not in UNITS[quantity]:
        hint = ", or a speed with a radius" if quantity == "angular velocity" else ""
        raise InputError(
            f"{where}: {key}: column {signal.column!r} has unit {signal.unit!r}, expected an {quantity}: "
            f"{', '.join(UNITS[quantity])}{hint}"
        )
    return UNITS[quantity][signal.unit]


def apply(mapping: ColumnMapping, columns: Columns, name: str, source: str) -> Recording:
    """The recording that the mapping makes of the columns."""
    base = 0
    if mapping.time.start is not None:
        start = mapping.time.start if mapping.time.start.tzinfo else mapping.time.start.replace(tzinfo=UTC)
        base = round(start.timestamp() * 1e9)
    notes: list[str] = []
    channels = {
        topic: _channel(topic, fields, columns, base, notes) for topic, fields in mapping.topics.items() if fields
    }
    return Recording(channels, name, tuple(notes), 0, {"source": source})


def _channel(topic: str, fields: Mapping[str, Any], columns: Columns, base: int, notes: list[str]) -> Channel:
    signals = [(field, signal) for field, value in fields.items() for signal in _signals(value)]
    if not signals:
        raise InputError(f"{topic}: no column is given for any of its fields")
    raw = {signal.column: columns(signal.column) for _, signal in signals}
    longest = max(raw, key=lambda column: np.count_nonzero(np.isfinite(raw[column][1])))
    time, first = raw[longest]
    if all(len(t) == len(time) and np.array_equal(t, time) for t, _ in raw.values()):
        keep = np.any([np.isfinite(v) for _, v in raw.values()], axis=0)
    else:
        keep = np.isfinite(first)
        notes.append(f"{topic}: its columns have different times; interpolated to those of {longest!r}")
    time = time[keep]
    if not len(time):
        raise InputError(f"{topic}: none of its columns ({', '.join(raw)}) holds a number")

    def value(field: str, signal: Signal | None) -> Array:
        if signal is None:
            return np.full(len(time), np.nan)
        own_time, own = raw[signal.column]
        factor = _factor("mapping", f"{topic}.{field}", signal, _QUANTITIES[topic][field])
        values = signal.sign * (signal.scale * own + signal.offset) * factor
        if len(own_time) == len(keep) and np.array_equal(own_time[keep], time):
            return values[keep]
        return _held(time, own_time, values, wraps=field in ("course", "yaw"))

    def vector(field: str) -> Array:
        given = fields.get(field) or [None, None, None]
        if not isinstance(given, list):
            raise InputError(f"mapping: {topic}.{field}: expected three values: x, y, z")
        return np.column_stack([value(field, signal) for signal in given])

    def scalar(field: str) -> Array:
        given = fields.get(field)
        if isinstance(given, list | dict):
            raise InputError(f"mapping: {topic}.{field}: expected one signal")
        return value(field, given)

    stamp = build.nanoseconds(time, base)
    spec = TOPICS[topic]
    if spec.names:
        field, joints = next((name, given) for name, given in fields.items() if given)
        return build.joints(topic, stamp, field, {joint: value(field, signal) for joint, signal in joints.items()})
    if topic == "gps/fix":
        return build.fix(stamp, scalar("latitude"), scalar("longitude"), scalar("altitude"))
    if topic == "gps/velocity":
        if "linear" in fields:
            return build.velocity(stamp, vector("linear"))
        return build.velocity(stamp, build.course_velocity(scalar("speed"), scalar("course"), scalar("up")))
    if topic == "imu/data" and "yaw" not in fields:
        return build.imu(stamp, vector("angular_velocity"), vector("linear_acceleration"))
    made = {field: vector(field) for field in FIELDS[spec.kind] if _QUANTITIES[topic].get(field) and field != "yaw"}
    absent = {}
    if spec.kind == "sensor_msgs/msg/Imu":
        for field in ("angular_velocity", "linear_acceleration"):
            if np.isnan(made[field]).all():
                absent[f"{field}_covariance"] = np.tile([-1.0] + [0.0] * 8, (len(stamp), 1))
                made[field] = np.zeros((len(stamp), 3))
    if "orientation" in FIELDS[spec.kind]:
        yaw = scalar("yaw")
        zero = np.where(np.isnan(yaw), np.nan, 0.0)
        made["orientation"] = np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])
    if spec.kind == "nav_msgs/msg/Odometry":
        unknown = np.zeros((len(stamp), 36))
        unknown[:, [21, 28]] = np.nan
        absent["pose_covariance"] = unknown
    return build.channel(topic, stamp, made | absent)


def _held(time: Array, own_time: Array, own: Array, wraps: bool) -> Array:
    """A column at other times than its own: linear between its values, NaN outside them; angles the short way round."""
    good = np.isfinite(own)
    if not good.any():
        return np.full(len(time), np.nan)
    known = np.unwrap(own[good]) if wraps else own[good]
    return np.interp(time, own_time[good], known, left=np.nan, right=np.nan)
