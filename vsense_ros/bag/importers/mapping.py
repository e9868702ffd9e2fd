"""From columns of any table or measurement file to topics, as a YAML file says.

    time: {column: t, unit: s, start: 2018-08-20T21:00:00Z}   # start: time of t = 0; without it t is Unix time
    delimiter: ";"        # tables of text only, as are decimal, skip_lines, encoding, missing, units_line, comment
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
`unit` may be left out where the source states one; where both say something else, the mapping is refused, unless it has
`ignore_stated_unit: true`. Several columns (`column: [v_rl, v_rr]`) are averaged. A name that stands more than once is
told by its number, counted from 1 (`column: 4`), or in a measurement file by its `group`.

Other forms of fields: `gps/fix` from local `east`, `north`, `up` with an `origin: {latitude, longitude, altitude}`;
`gps/velocity` from velocities in the axes of the car, `forward`, `left` and its `heading` (clockwise from north);
`vehicle/velocity` from `forward` and `left`, or a `speed` alone; `reference/odometry` from `speed` and `side_slip`,
with `heading` instead of `yaw`.

Units of time beside s, ms, us, ns, min, h: `iso` (2024-05-01T12:00:00.1Z), `hms` (12:00:00.1), `hhmmss` (120000.1) and
`gps` (seconds of the GPS week; `week` is its number or a column). Those without a date count from the midnight of
`start`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, ValidationError

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.checks.held import period_of_updates
from vsense_ros.errors import InputError
from vsense_ros.messages import units, yaml_text
from vsense_ros.messages.memory import give_back
from vsense_ros.messages.recording import FIELDS, Channel, Recording
from vsense_ros.messages.topics import TOPICS, WHEELS

_DEG = np.pi / 180.0
_LOOKED_AT = 100_000  # rows at the beginning that tell whether values are held
_LAST = 4e9  # [s] of any time

_QUANTITIES_OF_UNITS: Mapping[str, Mapping[str, float]] = {
    **units.QUANTITIES,
    "geographic angle": {"deg": 1.0, "rad": 180.0 / np.pi, "min": 1 / 60},
}
CLOCKS = ("iso", "hms", "hhmmss", "gps")  # units of time that are none

# The quantity of each field that a mapping may fill, by message type and topic.
_IMU = {
    "angular_velocity": "angular velocity",
    "linear_acceleration": "acceleration",
    "yaw": "angle",
    "heading": "angle",
}
_BODY = {"forward": "velocity", "left": "velocity"}
_QUANTITIES: Mapping[str, Mapping[str, str]] = {
    "imu/data": _IMU,
    "gps/attitude": _IMU,
    "gps/fix": {
        "latitude": "geographic angle",
        "longitude": "geographic angle",
        "altitude": "length",
        "east": "length",
        "north": "length",
        "up": "length",
    },
    "gps/velocity": {
        "linear": "velocity", "speed": "velocity", "course": "angle", "up": "velocity", **_BODY, "heading": "angle",
        "yaw": "angle",
    },
    "vehicle/velocity": {"linear": "velocity", "speed": "velocity", **_BODY, "up": "velocity", "side_slip": "angle"},
    "vehicle/wheel_speeds": {"velocity": "angular velocity"},
    "vehicle/steering": {"position": "angle"},
    "vehicle/wheel_torques": {"effort": "torque"},
    "vehicle/brake_pressure": {"effort": "pressure"},
    "vehicle/suspension": {"position": "length"},
    "reference/odometry": {
        "position": "length",
        "yaw": "angle",
        "heading": "angle",
        "linear": "velocity",
        "speed": "velocity",
        "side_slip": "angle",
        **_BODY,
        "angular": "angular velocity",
    },
    "reference/acceleration": {"linear": "acceleration", "angular": "angular acceleration"},
    **{f"reference/wheel_force/{w}": {"force": "force", "torque": "torque"} for w in WHEELS},
}  # fmt: skip
_WRAPPING = ("course", "yaw", "heading")


class Column(NamedTuple):
    """A column: times [s], raw values, and the unit that the source states, empty if none."""

    time: Array
    values: Array
    unit: str = ""


class Ref(NamedTuple):
    """Which column: by name or number (from 1), in a measurement file also of which group."""

    name: str | int
    group: int | None = None

    def __str__(self) -> str:
        return f"{self.name!r}" + ("" if self.group is None else f" of group {self.group}")


Columns = Callable[[Ref], Column]
"""A column by what a mapping calls it; raises `InputError` if there is no such column, or more than one."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


Name = str | Annotated[int, Field(ge=1)]


class Signal(_Model):
    """Where a value comes from and what is done to it."""

    column: Annotated[
        tuple[Name, ...], BeforeValidator(lambda v: tuple(v) if isinstance(v, list | tuple) else (v,))
    ] = Field(min_length=1)
    group: int | None = None
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[1, -1] = 1
    radius: Annotated[float, Field(gt=0)] | None = None
    ignore_stated_unit: bool = False

    @property
    def refs(self) -> tuple[Ref, ...]:
        """The columns that are averaged."""
        return tuple(Ref(name, self.group) for name in self.column)

    @property
    def words(self) -> str:
        """The columns in an error."""
        return ", ".join(map(str, self.refs))


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
    """The time column. Measurement files bring their own time; there `column` is left out."""

    column: Name | None = None
    unit: str = "s"
    start: datetime | None = None
    week: Name | None = None  # of GPS time: its number, or the name of a column

    @property
    def base(self) -> int:
        """Unix time of t = 0 [ns]; of a clock that shows the time of day alone, the midnight before."""
        if self.start is None:
            return 0
        start = self.start if self.start.tzinfo else self.start.replace(tzinfo=UTC)
        if self.unit in ("hms", "hhmmss"):
            start = start.replace(hour=0, minute=0, second=0, microsecond=0)
        return round(start.timestamp()) * 1_000_000_000 + start.microsecond * 1000


class Origin(_Model):
    """Where local positions are counted from."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    altitude: float = 0.0


class ColumnMapping(_Model):
    """A mapping file."""

    time: Time = Time()
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    decimal: Literal[".", ","] = "."
    skip_lines: Annotated[int, Field(ge=0)] = 0
    encoding: str | None = None
    missing: tuple[str, ...] = ()
    units_line: bool | None = None  # below the header; None: if it looks like one
    comment: str | None = None
    origin: Origin | None = None
    topics: dict[str, dict[str, FieldMapping]]

    def columns(self) -> list[Ref]:
        """All columns that topics use."""
        fields = [value for fields in self.topics.values() for value in fields.values()]
        return [ref for value in fields for signal in _signals(value) for ref in signal.refs]


def load(source: str | Path | Mapping[str, Any], path: Path) -> ColumnMapping:
    """The mapping for the file `path`, checked; `source` is a YAML file or its content.

    Raises `InputError` naming the file, the key, what was found and what is allowed.
    """
    where = "mapping"
    content: Any = source
    if not isinstance(source, Mapping):
        where = str(source)
        if not Path(source).exists():
            raise InputError(f"{source}: no such mapping file for {path.name}")
        content = yaml_text.load_file(source)
    try:
        mapping = ColumnMapping.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        forms = ("signal", "three signals", "signals by name", "absent")
        key = ".".join(str(part) for part in first["loc"] if part not in forms)
        raise InputError(f"{where}: {key or 'file'}: {first['msg']}, found {first['input']!r}") from None
    for topic, fields in mapping.topics.items():
        _check(where, topic, fields, mapping)
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
        "option mapping; 'vsense import --guess' proposes one, vsense_ros/bag/importers/mapping.py tells its form"
    )


def _check(where: str, topic: str, fields: Mapping[str, Any], mapping: ColumnMapping) -> None:
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
            if signal.unit is not None:
                _factor(where, f"{topic}.{name}", signal, signal.unit, quantities[name])
    if topic == "gps/fix" and "east" in fields and mapping.origin is None:
        raise InputError(f"{where}: gps/fix.east: local positions need the key origin: {{latitude: …, longitude: …}}")


def _signals(value: Signal | list[Signal | None] | dict[str, Signal] | None) -> list[Signal]:
    if isinstance(value, Signal):
        return [value]
    if isinstance(value, dict):
        return list(value.values())
    return [signal for signal in value or [] if signal is not None]


def _size(unit: str, quantity: str) -> float | None:
    """Size of a unit, in any spelling, in the unit of the messages; None if it is not one of this quantity."""
    known = _QUANTITIES_OF_UNITS[quantity]
    return known.get(unit) or known.get(units.canonical(unit) or "")


def _factor(where: str, key: str, signal: Signal, unit: str, quantity: str) -> float:
    """Factor to SI of a signal."""
    if signal.radius is not None:
        size = _size(unit, "velocity")
        if quantity != "angular velocity" or size is None:
            raise InputError(
                f"{where}: {key}: a radius turns a speed ({', '.join(units.QUANTITIES['velocity'])}) into an angular "
                f"velocity; found unit {unit!r} for a field that is an {quantity}"
            )
        return size / signal.radius
    size = _size(unit, quantity)
    if size is None:
        hint = ", or a speed with a radius" if quantity == "angular velocity" else ""
        raise InputError(
            f"{where}: {key}: column {signal.words} has unit {unit!r}, expected an {quantity}: "
            f"{', '.join(_QUANTITIES_OF_UNITS[quantity])}{hint}"
        )
    return size


def _unit(key: str, signal: Signal, stated: str) -> str:
    """The unit of a signal: what the mapping says, which must not contradict what the source states, or the latter."""
    if signal.unit is None:
        if units.canonical(stated) is None:
            raise InputError(
                f"mapping: {key}: column {signal.words} has no unit: state one"
                + (f"; the source says {stated!r}" if stated else "")
            )
        return stated
    if abs(signal.scale) == 1.0 and not signal.ignore_stated_unit and units.contradiction(stated, signal.unit):
        raise InputError(
            f"mapping: {key}: the source gives {signal.words} in {stated!r}, the mapping says {signal.unit!r}; correct "
            "the unit, or state the scale between the two, or where the source is wrong, ignore_stated_unit: true"
        )
    return signal.unit


_BRACKETS = re.compile(r".*[\[(]([^\])\[(]*)[\])]\s*")


def unit_in_name(name: str) -> str:
    """The unit that a column's name ends with in brackets, as in `speed [km/h]`; empty if there is none."""
    found = _BRACKETS.fullmatch(name)
    return found[1] if found and found[1].strip() and units.canonical(found[1]) else ""


def apply(mapping: ColumnMapping, columns: Columns, name: str, source: str, base: int | None = None) -> Recording:
    """The recording that the mapping makes of the columns; `base` is the Unix time [ns] of their time 0, if not that
    of the mapping."""
    notes: list[str] = []
    made = _Maker(mapping, columns, mapping.time.base if base is None else base, notes)
    channels = {}
    for topic, fields in mapping.topics.items():
        if fields:
            channels[topic] = made.channel(topic, fields)
            give_back()
    return Recording(channels, name, tuple(dict.fromkeys(notes)), 0, {"source": source})


class _Maker:
    """Makes the channels of a mapping."""

    def __init__(self, mapping: ColumnMapping, columns: Columns, base: int, notes: list[str]) -> None:
        self._mapping, self._columns, self._base, self._notes = mapping, columns, base, notes
        self._stamps: tuple[Array, build.Stamps] | None = None

    def channel(self, topic: str, fields: Mapping[str, Any]) -> Channel:
        signals = [(field, signal) for field, value in fields.items() for signal in _signals(value)]
        if not signals:
            raise InputError(f"{topic}: no column is given for any of its fields")
        raw = {ref: self._columns(ref) for _, signal in signals for ref in signal.refs}
        longest = max(raw, key=lambda ref: np.count_nonzero(np.isfinite(raw[ref].values)))
        time = raw[longest].time
        if all(len(c.time) == len(time) and np.array_equal(c.time, time) for c in raw.values()):
            keep = np.any([np.isfinite(c.values) for c in raw.values()], axis=0)
            keep = self._updates(topic, raw, keep)
        else:
            keep = np.isfinite(raw[longest].values)
            self._notes.append(f"{topic}: its columns have different times; interpolated to those of {longest}")
        time = time if keep.all() else time[keep]
        if not len(time):
            raise InputError(f"{topic}: none of its columns ({', '.join(map(str, raw))}) holds a number")
        if not (np.abs(time) < _LAST).all():
            raise InputError(
                f"{topic}: a time of {time[np.argmax(~(np.abs(time) < _LAST))]:g} s is none; is its unit right?"
            )

        def value(field: str, signal: Signal | None) -> Array:
            if signal is None:
                return np.broadcast_to(np.nan, len(time))
            found = [self._brought(raw[ref], keep, time, field in _WRAPPING) for ref in signal.refs]
            own = found.pop(0) if len(found) == 1 else np.mean(found, axis=0)
            key = f"{topic}.{field}"
            unit = _unit(key, signal, next((raw[ref].unit for ref in signal.refs if raw[ref].unit), ""))
            factor = _factor("mapping", key, signal, unit, _QUANTITIES[topic][field])
            own *= signal.scale  # in its place: tables are long
            own += signal.offset
            own *= signal.sign * factor
            return own

        return _Fields(topic, fields, value, len(time), self._mapping.origin).channel(self._stamps_of(time))

    def _stamps_of(self, time: Array) -> build.Stamps:
        """Of topics whose rows are the same, once."""
        if self._stamps is None or self._stamps[0] is not time:
            self._stamps = time, build.nanoseconds(time, self._base)
        return self._stamps[1]

    def _updates(self, topic: str, raw: Mapping[Ref, Column], keep: np.ndarray) -> np.ndarray:
        """Rows at which a slower source brought something new, where a faster table repeats its values."""
        rows = np.flatnonzero(keep)
        beginning = rows[:_LOOKED_AT]
        every = period_of_updates(np.column_stack([column.values[beginning] for column in raw.values()]))
        if every is None:
            return keep
        values = np.column_stack([column.values[rows] for column in raw.values()])
        changed = np.concatenate([[True], (np.diff(np.nan_to_num(values), axis=0) != 0).any(axis=1)])
        since = np.arange(len(rows)) - np.maximum.accumulate(np.where(changed, np.arange(len(rows)), 0))
        fresh = changed | (since % every == 0)  # standing still, the same value comes again
        self._notes.append(f"{topic}: each value stands in {every} rows; only the first of them is a measurement")
        found = np.zeros(len(keep), bool)
        found[rows[fresh]] = True
        return found

    def _brought(self, column: Column, keep: np.ndarray, time: Array, wraps: bool) -> Array:
        """Values of a column at the times of a topic."""
        if len(column.time) == len(keep) and np.array_equal(column.time[keep], time):
            return column.values[keep]
        unit = units.canonical(column.unit) or ""
        turn = 2 * np.pi if unit == "rad" else 360.0
        if wraps and np.nanmax(np.abs(column.values), initial=0.0) < 7.0 and unit != "deg":
            turn = 2 * np.pi
        return _between(time, column.time, column.values, turn if wraps else None)


def _between(time: Array, own_time: Array, own: Array, turn: float | None) -> Array:
    """A column at other times than its own: linear between its values, NaN outside them; angles the short way round."""
    good = np.isfinite(own)
    if not good.any():
        return np.full(len(time), np.nan)
    known = np.unwrap(own[good], period=turn) if turn else own[good]
    return np.interp(time, own_time[good], known, left=np.nan, right=np.nan)


class _Fields:
    """The fields of one topic, and the message that they make."""

    def __init__(
        self,
        topic: str,
        fields: Mapping[str, Any],
        value: Callable[[str, Signal | None], Array],
        rows: int,
        origin: Origin | None,
    ) -> None:
        self._topic, self._fields, self._value, self._rows, self._origin = topic, fields, value, rows, origin

    def vector(self, field: str) -> Array:
        given = self._fields.get(field) or [None, None, None]
        if not isinstance(given, list):
            raise InputError(f"mapping: {self._topic}.{field}: expected three values: x, y, z")
        if not any(signal is not None for signal in given):
            return np.broadcast_to(np.nan, (self._rows, len(given)))
        found = np.full((self._rows, len(given)), np.nan)
        for i, signal in enumerate(given):
            if signal is not None:
                found[:, i] = self._value(field, signal)
        return found

    def scalar(self, field: str) -> Array:
        given = self._fields.get(field)
        if isinstance(given, list | dict):
            raise InputError(f"mapping: {self._topic}.{field}: expected one signal")
        return self._value(field, given)

    def yaw(self) -> Array:
        """Counter-clockwise from east [rad]."""
        return np.pi / 2 - self.scalar("heading") if "heading" in self._fields else self.scalar("yaw")

    def body_velocity(self) -> Array:
        """Velocity in the axes of the car (n, 3) [m/s]."""
        if "linear" in self._fields:
            return self.vector("linear")
        up = self.scalar("up") if "up" in _QUANTITIES[self._topic] else np.full(self._rows, np.nan)
        if "speed" in self._fields:
            speed = self.scalar("speed")
            if "side_slip" not in self._fields:
                return np.column_stack([speed, np.full(self._rows, np.nan), up])
            slip = self.scalar("side_slip")
            return np.column_stack([speed * np.cos(slip), speed * np.sin(slip), up])
        return np.column_stack([self.scalar("forward"), self.scalar("left"), up])

    def enu_velocity(self) -> Array:
        """Velocity to the east, north and up (n, 3) [m/s]."""
        if "linear" in self._fields:
            return self.vector("linear")
        if "forward" in self._fields:
            if not {"heading", "yaw"} & self._fields.keys():
                raise InputError(
                    "mapping: gps/velocity: velocities in the axes of the car need its heading or yaw; without one "
                    "they are vehicle/velocity"
                )
            yaw, along, across = self.yaw(), self.scalar("forward"), self.scalar("left")
            across = across if "left" in self._fields else np.zeros(self._rows)
            east, north = along * np.cos(yaw) - across * np.sin(yaw), along * np.sin(yaw) + across * np.cos(yaw)
            return np.column_stack([east, north, self.scalar("up")])
        if "course" not in self._fields:
            raise InputError(
                "mapping: gps/velocity: a speed without a course has no direction; say it as vehicle/velocity.speed"
            )
        return build.course_velocity(self.scalar("speed"), self.scalar("course"), self.scalar("up"))

    def fix(self, stamp: build.Stamps) -> Channel:
        if "east" not in self._fields:
            return build.fix(stamp, self.scalar("latitude"), self.scalar("longitude"), self.scalar("altitude"))
        assert self._origin is not None
        up = self.scalar("up") if "up" in self._fields else np.zeros(self._rows)
        origin = (self._origin.latitude, self._origin.longitude, self._origin.altitude)
        latitude, longitude, altitude = build.geodetic_from_enu(self.scalar("east"), self.scalar("north"), up, origin)
        return build.fix(stamp, latitude, longitude, altitude if "up" in self._fields else np.full(self._rows, np.nan))

    def channel(self, stamp: build.Stamps) -> Channel:
        topic, fields = self._topic, self._fields
        spec = TOPICS[topic]
        if spec.names:
            field, joints = next((name, given) for name, given in fields.items() if given)
            return build.joints(topic, stamp, field, {j: self._value(field, signal) for j, signal in joints.items()})
        if topic == "gps/fix":
            return self.fix(stamp)
        if topic == "gps/velocity":
            return build.velocity(stamp, self.enu_velocity())
        if topic == "vehicle/velocity":
            return build.body_velocity(stamp, self.body_velocity())
        oriented = bool({"yaw", "heading"} & fields.keys())
        if topic == "imu/data" and not oriented:
            return build.imu(stamp, self.vector("angular_velocity"), self.vector("linear_acceleration"))
        return self._general(stamp)

    def _general(self, stamp: build.Stamps) -> Channel:
        topic, kind = self._topic, TOPICS[self._topic].kind
        made = {f: self.vector(f) for f in FIELDS[kind] if _QUANTITIES[topic].get(f) and f not in ("yaw", "heading")}
        absent: dict[str, Array] = {}
        if kind == "sensor_msgs/msg/Imu":
            for field in ("angular_velocity", "linear_acceleration"):
                if np.isnan(made[field]).all():
                    absent[f"{field}_covariance"] = np.tile([-1.0] + [0.0] * 8, (len(stamp), 1))
                    made[field] = np.zeros((len(stamp), 3))
        if "orientation" in FIELDS[kind]:
            yaw = self.yaw()
            zero = np.where(np.isnan(yaw), np.nan, 0.0)
            made["orientation"] = np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])
        if kind == "nav_msgs/msg/Odometry":
            made["linear"] = self.body_velocity()
            unknown = np.zeros((len(stamp), 36))
            unknown[:, [21, 28]] = np.nan
            absent["pose_covariance"] = unknown
        return build.channel(topic, stamp, made | absent)
