"""Which CAN signal becomes which topic: the schema of `config/can/*.yaml`."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.messages.units import QUANTITIES, canonical, quantity_of, to_si

JointField = Literal["position", "velocity", "effort"]
JOINT_UNITS: dict[str, tuple[str, ...]] = {
    "position": ("rad", "m"),
    "velocity": ("rad/s",),
    "effort": ("N m", "Pa"),
}
UNITS = tuple(
    unit
    for quantity in ("angle", "angular velocity", "velocity", "acceleration", "length", "pressure", "torque")
    for unit in QUANTITIES[quantity]
)
ImuAxis = Literal[
    "angular_velocity_x",
    "angular_velocity_y",
    "angular_velocity_z",
    "linear_acceleration_x",
    "linear_acceleration_y",
    "linear_acceleration_z",
]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


_Values = Annotated[
    tuple[float | str, ...], BeforeValidator(lambda v: tuple(v) if isinstance(v, list | tuple) else (v,))
]


class Valid(_Part):
    """A signal of the same message that says whether a value may be believed, as quality flags do."""

    signal: str = Field(description="signal of the DBC")
    values: _Values = Field(description="numbers or names (VAL_) at which the value is believed", min_length=1)


class SignBit(_Part):
    """A signal of the same message that says the direction of another, which is a magnitude."""

    signal: str = Field(description="signal of the DBC")
    negative: _Values = Field(
        default=(1,), description="its numbers or names (VAL_) where the magnitude counts as negative", min_length=1
    )


class Signal(_Part):
    """From a signal of the DBC to SI: (sum of the signals × factor + offset), which is then in `unit`.

    A negative factor turns a signal whose positive direction is not that of ISO 8855.
    """

    signals: Annotated[tuple[str, ...], BeforeValidator(lambda v: (v,) if isinstance(v, str) else v)] = Field(
        description="signal of the DBC, or several that are added", min_length=1
    )
    unit: str = Field(description=f"unit after factor and offset, one of {', '.join(UNITS)}")
    factor: float = Field(default=1.0, description="unit per unit of the DBC's physical value")
    offset: float = Field(default=0.0, description="added after the factor [unit]")
    sign: SignBit | None = Field(
        default=None, description="signal that says the direction, where `signals` are a magnitude"
    )
    rolling_radius: float | None = Field(
        default=None, gt=0, lt=2, description="turns a wheel's speed over ground into its angular velocity [m]"
    )
    range: tuple[float, float] | None = Field(
        default=None, description="plausible values [unit]; replaces the ranges of the DBC"
    )
    standard_deviation: float | None = Field(default=None, gt=0, description="of the noise [SI]; for Imu messages")
    ignore_stated_unit: bool = Field(default=False, description="the unit that the DBC gives is wrong")
    valid: Valid | None = Field(default=None, description="when the value is believed")

    @model_validator(mode="after")
    def _consistent(self) -> Signal:
        if canonical(self.unit) not in UNITS:
            raise ValueError(f"unit {self.unit!r} is not known; known are {', '.join(UNITS)}")
        if self.factor == 0 or not math.isfinite(self.factor):
            raise ValueError(f"factor is {self.factor}, expected a finite number other than 0")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range is {list(self.range)}, expected [lowest, highest]")
        if self.rolling_radius is not None and self.si_unit != "m/s":
            raise ValueError(f"rolling_radius needs a unit of speed over ground (m/s, km/h, mph), found {self.unit!r}")
        return self

    @property
    def si_unit(self) -> str:
        """SI unit before a rolling radius is applied."""
        return next(iter(QUANTITIES[quantity_of(self.unit) or "number"]))

    @property
    def to_si(self) -> float:
        """Size of the unit in SI."""
        return to_si(self.unit)

    @property
    def output_unit(self) -> str:
        """SI unit of the value in the message."""
        return "rad/s" if self.rolling_radius is not None else self.si_unit


class _Output(_Part):
    """What outputs of all kinds have."""

    topic: str = Field(min_length=1, description="topic of the message that is made")
    message: str = Field(description="message of the DBC, or NAME@0x123 where several have one name")
    valid: Valid | None = Field(default=None, description="when all of its values are believed")

    def named_signals(self) -> dict[str, Signal]:
        """Signals by the name of the value that each gives."""
        raise NotImplementedError


class JointStateOutput(_Output):
    """A sensor_msgs/JointState made from one CAN message; other messages may give other joints of the same topic."""

    kind: Literal["joint_state"] = Field(description="what it is")
    field: JointField = Field(description="angles and lengths are positions, torques and pressures efforts")
    joints: dict[str, Signal] = Field(min_length=1, description="joint name: signal, in the order of the message")

    @model_validator(mode="after")
    def _units(self) -> JointStateOutput:
        for joint, signal in self.joints.items():
            if signal.output_unit not in JOINT_UNITS[self.field]:
                raise ValueError(
                    f"{joint}: {self.field} is in {' or '.join(JOINT_UNITS[self.field])}, but the signal gives "
                    f"{signal.output_unit} (unit: {signal.unit})"
                )
        return self

    def named_signals(self) -> dict[str, Signal]:
        """Signals by joint."""
        return self.joints


class ImuOutput(_Output):
    """A sensor_msgs/Imu made from one CAN message; axes that are not listed are NaN. Other messages may give those."""

    kind: Literal["imu"] = Field(description="what it is")
    frame_id: str = Field(min_length=1, description="frame of the sensor, as in the vehicle file")
    axes: dict[ImuAxis, Signal] = Field(min_length=1, description="axis: signal, each with its standard deviation")

    @model_validator(mode="after")
    def _units(self) -> ImuOutput:
        for axis, signal in self.axes.items():
            expected = "rad/s" if axis.startswith("angular") else "m/s²"
            if signal.output_unit != expected:
                raise ValueError(f"{axis} is in {expected}, but the signal gives {signal.output_unit}")
            if signal.standard_deviation is None:
                raise ValueError(f"{axis} needs a standard_deviation [{expected}]")
        return self

    def named_signals(self) -> dict[str, Signal]:
        """Signals by axis."""
        return {str(axis): signal for axis, signal in self.axes.items()}


class CounterCheck(_Part):
    """A counter that the sender raises by one with each frame and that wraps at the width of its signal."""

    signal: str = Field(description="signal of the DBC")
    max_delta: int = Field(default=1, ge=1, description="largest step at which a frame is still believed")


class ChecksumCheck(_Part):
    """A checksum byte."""

    algorithm: str = Field(description=f"one of {', '.join(CHECKSUMS)}")
    byte: int = Field(default=-1, ge=-1, le=63, description="place in the data; -1: the last")

    @model_validator(mode="after")
    def _known(self) -> ChecksumCheck:
        if self.algorithm not in CHECKSUMS:
            raise ValueError(f"checksum algorithm {self.algorithm!r} is not known; known are {', '.join(CHECKSUMS)}")
        return self


class MessageCheck(_Part):
    """What is known of a message besides its signals."""

    length: int | None = Field(
        default=None, ge=0, le=64, description="exact number of data bytes; default: that of the DBC or more"
    )
    rate: float | None = Field(default=None, gt=0, description="nominal rate [Hz]")
    timeout: float = Field(default=0.5, gt=0, description="silence that makes the sensor stale [s]")
    latency: float = Field(default=0.0, ge=-1, le=1, description="from the measurement to the frame's stamp [s]")
    counter: CounterCheck | None = Field(default=None, description="counter that is checked")
    checksum: ChecksumCheck | None = Field(default=None, description="checksum that is checked")
    j1939: bool | None = Field(
        default=None, description="found by its PGN, whoever sends it; default: if the DBC says that it is of J1939"
    )
    source: int | None = Field(default=None, ge=0, le=255, description="source address; default: the first one heard")


class CanMapping(_Part):
    """The mapping of a CAN bus."""

    name: str = Field(min_length=1, description="for messages about it")
    bus_timeout: float = Field(default=0.5, gt=0, description="silence of the whole bus that is an error [s]")
    messages: dict[str, MessageCheck] = Field(default_factory=dict, description="by name in the DBC")
    outputs: tuple[Annotated[JointStateOutput | ImuOutput, Field(discriminator="kind")], ...] = Field(
        min_length=1, description="messages that are made of the frames"
    )

    @model_validator(mode="after")
    def _one_source_per_topic(self) -> CanMapping:
        by_topic: dict[str, list[JointStateOutput | ImuOutput]] = {}
        for output in self.outputs:
            by_topic.setdefault(output.topic, []).append(output)
        for topic, parts in by_topic.items():
            _must_be_parts(topic, parts)
        used = {output.message for output in self.outputs}
        for name in self.messages:
            if name not in used:
                raise ValueError(f"message {name} is described under messages but no output uses it")
        return self


def _must_be_parts(topic: str, parts: list[JointStateOutput | ImuOutput]) -> None:
    """A topic may come from several messages, each of which gives other joints or axes of it."""
    if len({part.kind for part in parts}) > 1:
        raise ValueError(f"topic {topic} is made as two kinds of message; it has one")
    alike = {part.field if isinstance(part, JointStateOutput) else part.frame_id for part in parts}
    if len(alike) > 1:
        raise ValueError(f"topic {topic} is made as {' and as '.join(sorted(alike))}; its parts must agree")
    given: dict[str, str] = {}
    for part in parts:
        for name in part.named_signals():
            if name in given:
                raise ValueError(
                    f"topic {topic}: {name} is made twice, of {given[name]} and of {part.message}; it has one source"
                )
            given[name] = part.message


def load_mapping(path: str | Path) -> CanMapping:
    """Read and check a mapping file; `InputError` names file, line, key, what was found and what is allowed."""
    path = Path(path)
    text = yaml_text.read_text(path)
    yaml_text.check(text, str(path))
    try:
        document = YAML(typ="rt").load(text)
    except (YAMLError, ValueError, RecursionError, OverflowError, TypeError) as error:
        raise InputError(f"{path}: not valid YAML: {error}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a CAN mapping with the keys {_list(CanMapping.model_fields)}, found none")
    try:
        return CanMapping.model_validate(document)
    except ValidationError as error:
        lines = []
        for item in error.errors():
            where = tuple(part for part in item["loc"] if part not in ("joint_state", "imu"))
            key = ".".join(str(part) for part in where) or "file"
            found = item["input"] if not isinstance(item["input"], dict | list) else "see there"
            text = item["msg"].removeprefix("Value error, ")
            lines.append(f"{path}, line {_line(document, where)}, {key}: {text} (found: {found})")
        raise InputError("\n".join(lines)) from None


def _line(document: object, where: tuple[str | int, ...]) -> int:
    """Line of the innermost key of `where` that the file has, counted from 1."""
    line = 1
    for part in where:
        try:
            position = document.lc.key(part) if isinstance(part, str) else document.lc.item(part)  # type: ignore[attr-defined]
            document = document[part]  # type: ignore[index]
        except (KeyError, IndexError, AttributeError, TypeError):
            break
        line = position[0] + 1
    return line


def _list(names: Iterable[str]) -> str:
    return ", ".join(names)


def suggestion(name: str, known: Iterable[str]) -> str:
    """`; did you mean …?` with the nearest known name, or nothing."""
    near = difflib.get_close_matches(name, list(known), 1, 0.5)
    return f"; did you mean {near[0]}?" if near else ""
