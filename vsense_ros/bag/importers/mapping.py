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
given by its number, counted from 1 (`column: 4`), or in a measurement file by its `group`.

A table with one value a row names the columns of names and values, and the names stand where columns stand else:
`rows: {name: PID, value: VALUE, unit: UNITS}`.

Other forms of fields: `gps/fix` from local `east`, `north`, `up` with an `origin: {latitude, longitude, altitude}`;
`gps/velocity` from velocities in the axes of the car, `forward`, `left` and its `heading` (clockwise from north);
`vehicle/velocity` from `forward` and `left`, or a `speed` alone; `reference/odometry` from `speed` and `side_slip`,
with `heading` instead of `yaw`.

Where three values of a field (`[…, …, …]`) have other axes than forward, left, up and east, north, up, or a steering
angle is positive to the right, `convention: sae_j670` says so for the whole file, and
`conventions: {gps/velocity: ned}` for one topic: iso_8855 (the default), sae_j670, ned or enu. Fields whose names say a
direction (`forward`, `left`, `course`) mean the same in all of them.

A table or a MATLAB file without times has `time: {rate: 200}`: its rows follow each other by 1/200 s.

Units of time beside s, ms, us, ns, min, h, d: `iso` (2024-05-01T12:00:00.1Z, or as `format` says:
`format: "%d-%b-%Y %H:%M:%S.%f"`), `hms` (12:00:00.1), `hhmmss` (120000.1) and `gps` (seconds of the GPS week; `week` is
its number or a column). Those without a date count from the midnight of `start`; days of a spreadsheet are `d` with
`start: 1899-12-30T00:00:00Z`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, overload

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, ValidationError

from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.convention import CONVENTIONS, IN_AXES, Axes, Convention, ConventionName
from vsense_ros.errors import InputError
from vsense_ros.messages import units, yaml_text
from vsense_ros.messages.topics import TOPICS, WHEELS

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
QUANTITIES: Mapping[str, Mapping[str, str]] = {
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
    ] = Field(min_length=1, description="column by its name, or by its number from 1; several are averaged")
    group: int | None = Field(default=None, description="group of channels in a measurement file")
    unit: str | None = Field(default=None, description="unit after scale and offset; default: that of the source")
    scale: float = Field(default=1.0, description="unit per raw value")
    offset: float = Field(default=0.0, description="added after the scale [unit]")
    sign: Literal[1, -1] = Field(default=1, description="-1 where positive is not as in ISO 8855")
    radius: Annotated[float, Field(gt=0)] | None = Field(
        default=None, description="turns a wheel's speed over ground into its angular velocity [m]"
    )
    ignore_stated_unit: bool = Field(default=False, description="the unit that the source states is wrong")

    @property
    def refs(self) -> tuple[Ref, ...]:
        """The columns that are averaged."""
        return tuple(Ref(name, self.group) for name in self.column)

    @property
    def words(self) -> str:
        """The columns in an error."""
        return ", ".join(map(str, self.refs))


def _form(value: object) -> str:
    """Which of the forms of a field this is; by which pydantic knows which one to check."""
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

    column: Name | None = Field(default=None, description="column by its name, or by its number from 1")
    unit: str = Field(default="s", description="s, ms, us, ns, min, h, d, or iso, hms, hhmmss, gps")
    start: datetime | None = Field(default=None, description="time of t = 0; without it t is Unix time")
    format: str | None = Field(default=None, description="of unit iso, as Python's strptime has it: %d.%m.%Y %H:%M:%S")
    week: Name | None = Field(default=None, description="GPS week: its number, or the name of a column")
    rate: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        default=None, description="rows a second, where the source has no times [Hz]; in place of `column`"
    )

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

    latitude: Annotated[float, Field(ge=-90, le=90)] = Field(description="[deg]")
    longitude: Annotated[float, Field(ge=-180, le=180)] = Field(description="[deg]")
    altitude: float = Field(default=0.0, description="above the ellipsoid [m]")


class Rows(_Model):
    """The columns of a table that has one value a row; the other columns of a mapping are then names of values."""

    name: str = Field(description="column with the names of the values")
    value: str = Field(description="column with the values")
    unit: str | None = Field(default=None, description="column with their units")


class ColumnMapping(_Model):
    """The mapping of a table or a measurement file."""

    time: Time = Field(default=Time(), description="the column of time; measurement files have their own")
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = Field(default=",", description="between columns")
    decimal: Literal[".", ","] = Field(default=".", description="decimal sign")
    skip_lines: Annotated[int, Field(ge=0)] = Field(default=0, description="lines above the header")
    encoding: str | None = Field(default=None, description="of the text; default: UTF-8, else Windows-1252")
    missing: tuple[str, ...] = Field(default=(), description="texts that stand for no value")
    units_line: bool | None = Field(
        default=None, description="units stand in a line below the header; default: if it looks like one"
    )
    comment: str | None = Field(default=None, description="beginning of lines that are left out")
    rows: Rows | None = Field(default=None, description="columns of a table that has one value a row")
    origin: Origin | None = Field(default=None, description="where local positions are counted from")
    convention: ConventionName = Field(default="iso_8855", description="axes and signs of vectors and of the steering")
    conventions: dict[str, ConventionName] = Field(
        default_factory=dict, description="the same for one topic, where it has others than the file"
    )
    topics: dict[str, dict[str, FieldMapping]] = Field(description="topics, their fields, and the signals of these")

    def fields(self, topic: str) -> dict[str, FieldMapping]:
        """The fields of a topic with the signals as they are in the axes of this project."""
        own = CONVENTIONS[self.conventions.get(topic, self.convention)]
        kinds = IN_AXES.get(topic, {})
        return {name: _in_own_axes(value, own, kinds.get(name)) for name, value in self.topics[topic].items()}

    def columns(self) -> list[Ref]:
        """All columns that topics use."""
        fields = [value for fields in self.topics.values() for value in fields.values()]
        return [ref for value in fields for signal in signals_of(value) for ref in signal.refs]


def _in_own_axes(value: FieldMapping, given: Convention, kind: Axes | None) -> FieldMapping:
    """A field whose signals have a convention: three signals are exchanged and reversed, steering angles reversed."""
    if isinstance(value, list) and kind in ("body", "map"):
        matrix = np.array(given.body if kind == "body" else given.map)
        sources = np.argmax(np.abs(matrix), axis=1)
        return [_times(value[source], int(matrix[row, source])) for row, source in enumerate(sources)]
    if isinstance(value, dict) and kind == "steering":
        return {joint: _times(signal, given.steering) for joint, signal in value.items()}
    return value


@overload
def _times(signal: Signal, sign: int) -> Signal: ...
@overload
def _times(signal: Signal | None, sign: int) -> Signal | None: ...
def _times(signal: Signal | None, sign: int) -> Signal | None:
    """A signal, with its sign turned where `sign` is -1."""
    return signal if signal is None or sign > 0 else signal.model_copy(update={"sign": -signal.sign})


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
    if mapping.time.rate is not None and mapping.time.column is not None:
        raise InputError(f"{where}: time: expected a column or a rate, found both")
    strange = [topic for topic in mapping.conventions if topic not in mapping.topics]
    if strange:
        raise InputError(
            f"{where}: conventions: {strange[0]!r} is no topic of this mapping; it has {', '.join(mapping.topics)}"
        )
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
        "option mapping; 'vsense import --guess' proposes one, docs/reference/mappings.md lists its keys"
    )


def _check(where: str, topic: str, fields: Mapping[str, Any], mapping: ColumnMapping) -> None:
    if topic not in TOPICS:
        raise InputError(f"{where}: topics: {topic!r} is no topic of this project; known: {', '.join(TOPICS)}")
    for name, value in fields.items():
        quantities = QUANTITIES[topic]
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
        for signal in signals_of(value):
            if signal.unit is not None:
                factor_to_si(where, f"{topic}.{name}", signal, signal.unit, quantities[name])
    if topic == "gps/fix" and "east" in fields and mapping.origin is None:
        raise InputError(f"{where}: gps/fix.east: local positions need the key origin: {{latitude: …, longitude: …}}")


def signals_of(value: Signal | list[Signal | None] | dict[str, Signal] | None) -> list[Signal]:
    """All signals of a field, in whichever form it is given."""
    if isinstance(value, Signal):
        return [value]
    if isinstance(value, dict):
        return list(value.values())
    return [signal for signal in value or [] if signal is not None]


def _size(unit: str, quantity: str) -> float | None:
    """Size of a unit, in any spelling, in the unit of the messages; None if it is not one of this quantity."""
    known = _QUANTITIES_OF_UNITS[quantity]
    return known.get(unit) or known.get(units.canonical(unit) or "")


def factor_to_si(where: str, key: str, signal: Signal, unit: str, quantity: str) -> float:
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


def unit_of(key: str, signal: Signal, stated: str) -> str:
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
    match = _BRACKETS.fullmatch(name)
    return match[1] if match and match[1].strip() and units.canonical(match[1]) else ""
