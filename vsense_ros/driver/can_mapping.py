"""Which CAN signal becomes which topic: the schema of `config/can/*.yaml`."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_mapped_signal import Output, Part, Signal
from vsense_ros.driver.can_motion import MOTION_OUTPUTS, MotionOutput
from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text

JointField = Literal["position", "velocity", "effort"]
JOINT_UNITS: dict[str, tuple[str, ...]] = {
    "position": ("rad", "m"),
    "velocity": ("rad/s",),
    "effort": ("N m", "Pa"),
}
ImuAxis = Literal[
    "angular_velocity_x",
    "angular_velocity_y",
    "angular_velocity_z",
    "linear_acceleration_x",
    "linear_acceleration_y",
    "linear_acceleration_z",
]


class JointStateOutput(Output):
    """A sensor_msgs/JointState made from one CAN message; other messages may give other joints of the same topic."""

    kind: Literal["joint_state"] = Field(description="what it is")
    field: JointField = Field(description="angles and lengths are positions, torques and pressures efforts")
    joints: dict[str, Signal] = Field(min_length=1, description="joint name: signal, in the order of the message")

    @model_validator(mode="after")
    def _units(self) -> JointStateOutput:
        for joint, signal in self.joints.items():
            if signal.output_unit not in JOINT_UNITS[self.field]:
                hint = "; the speed of the car is kind: speed" if signal.output_unit == "m/s" else ""
                raise ValueError(
                    f"{joint}: {self.field} is in {' or '.join(JOINT_UNITS[self.field])}, but the signal gives "
                    f"{signal.output_unit} (unit: {signal.unit}){hint}"
                )
        return self

    @property
    def message_kind(self) -> str:
        return "sensor_msgs/msg/JointState"

    def named_signals(self) -> dict[str, Signal]:
        """Signals by joint."""
        return self.joints


class ImuOutput(Output):
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

    @property
    def message_kind(self) -> str:
        return "sensor_msgs/msg/Imu"

    def named_signals(self) -> dict[str, Signal]:
        """Signals by axis."""
        return {str(axis): signal for axis, signal in self.axes.items()}


class CounterCheck(Part):
    """A counter that the sender raises by one with each frame and that wraps at the width of its signal."""

    signal: str = Field(description="signal of the DBC")
    max_delta: int = Field(default=1, ge=1, description="largest step at which a frame is still believed")


class ChecksumCheck(Part):
    """A checksum byte."""

    algorithm: str = Field(description=f"one of {', '.join(CHECKSUMS)}")
    byte: int = Field(default=-1, ge=-1, le=63, description="place in the data; -1: the last")

    @model_validator(mode="after")
    def _known(self) -> ChecksumCheck:
        if self.algorithm not in CHECKSUMS:
            raise ValueError(f"checksum algorithm {self.algorithm!r} is not known; known are {', '.join(CHECKSUMS)}")
        return self


class MessageCheck(Part):
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


def _speed_of_the_car(output: object) -> object:
    """A joint of `vehicle/speed`, which has none, as the speed that is meant."""
    if isinstance(output, dict) and output.get("kind") == "joint_state" and output.get("topic") == "vehicle/speed":
        signals = list(output.get("joints") or {"": None})
        rest = {key: value for key, value in output.items() if key not in ("kind", "joints", "field")}
        return rest | {"kind": "speed", "speed": output["joints"][signals[0]] if len(signals) == 1 else None}
    return output


AnyOutput = JointStateOutput | ImuOutput | MotionOutput
_KINDS = ("joint_state", "imu", *(kind for output in MOTION_OUTPUTS for kind in output.kinds()))


class CanMapping(Part):
    """The mapping of a CAN bus."""

    name: str = Field(min_length=1, description="for messages about it")
    bus: str | None = Field(default=None, description="which channel of a log of several buses it is of")
    bus_timeout: float = Field(default=0.5, gt=0, description="silence of the whole bus that is an error [s]")
    messages: dict[str, MessageCheck] = Field(default_factory=dict, description="by name in the DBC")
    outputs: tuple[Annotated[AnyOutput, Field(discriminator="kind"), BeforeValidator(_speed_of_the_car)], ...] = Field(
        min_length=1, description="messages that are made of the frames"
    )

    @model_validator(mode="after")
    def _one_source_per_topic(self) -> CanMapping:
        by_topic: dict[str, list[AnyOutput]] = {}
        for output in self.outputs:
            by_topic.setdefault(output.topic, []).append(output)
        for topic, parts in by_topic.items():
            _must_be_parts(topic, parts)
        used = {output.message for output in self.outputs}
        for name in self.messages:
            if name not in used:
                raise ValueError(f"message {name} is described under messages but no output uses it")
        return self


def _must_be_parts(topic: str, parts: list[AnyOutput]) -> None:
    """A topic may come from several messages, each of which gives other joints or axes of it."""
    if len({part.kind for part in parts}) > 1:
        raise ValueError(f"topic {topic} is made as two kinds of message; it has one")
    if len(parts) > 1 and not isinstance(parts[0], JointStateOutput | ImuOutput):
        raise ValueError(f"topic {topic} is made of {len(parts)} messages; a {parts[0].kind} is made of one")
    alike = {part.field if isinstance(part, JointStateOutput) else getattr(part, "frame_id", "") for part in parts}
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
            where = tuple(part for part in item["loc"] if part not in _KINDS)
            key = ".".join(str(part) for part in where) or "file"
            given = item["input"] if not isinstance(item["input"], dict | list) else "see there"
            text = item["msg"].removeprefix("Value error, ")
            lines.append(f"{path}, line {_line(document, where)}, {key}: {text} (found: {given})")
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
