"""Where everything stands in the bytes of a ROS message: CDR, little endian (XCDR1).

Strings stand at the front of all messages of `vsense_ros.messages.recording.FIELDS` and all else has a fixed size, so
two messages of one topic that carry the same strings have the same byte layout. A layout is worked out once
(`layout_of`) from the message definition.

Alignment counts from behind the four bytes of the encapsulation header (OMG DDS-XTypes 1.3, 7.6.2).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages import definitions
from vsense_ros.messages.recording import FIELDS

HEADER = b"\x00\x01\x00\x00"
_FORMATS = {
    "int8": "i1", "uint8": "u1", "byte": "u1", "uint16": "<u2", "int32": "<i4", "uint32": "<u4", "float64": "<f8",
}  # fmt: skip
_MAX_JOINTS = 4096

# Where the number fields of `FIELDS` stand in the message, if not under their own name at the top.
_PATHS: Mapping[str, Mapping[str, str]] = {
    "sensor_msgs/msg/NavSatFix": {"status": "status.status", "service": "status.service"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {
        "linear": "twist.twist.linear",
        "angular": "twist.twist.angular",
        "covariance": "twist.covariance",
    },
    "geometry_msgs/msg/TwistStamped": {"linear": "twist.linear", "angular": "twist.angular"},
    "geometry_msgs/msg/AccelStamped": {"linear": "accel.linear", "angular": "accel.angular"},
    "geometry_msgs/msg/AccelWithCovarianceStamped": {
        "linear": "accel.accel.linear",
        "angular": "accel.accel.angular",
        "covariance": "accel.covariance",
    },
    "geometry_msgs/msg/WrenchStamped": {"force": "wrench.force", "torque": "wrench.torque"},
    "nav_msgs/msg/Odometry": {
        "position": "pose.pose.position",
        "orientation": "pose.pose.orientation",
        "pose_covariance": "pose.covariance",
        "linear": "twist.twist.linear",
        "angular": "twist.twist.angular",
        "twist_covariance": "twist.covariance",
    },
}


@dataclass(frozen=True)
class Strings:
    """What decides the byte layout of a message: its strings and the lengths of its arrays."""

    kind: str
    frame_id: str = ""
    child_frame_id: str = ""
    names: tuple[str, ...] = ()
    counts: tuple[int, int, int] = (0, 0, 0)  # of position, velocity, effort of a JointState


@dataclass(frozen=True)
class Layout:
    """The place of each field in the bytes of a message."""

    strings: Strings
    template: bytes  # a message with these strings and all numbers zero
    offsets: Mapping[str, tuple[str, int, int]]  # field → numpy format, count, byte offset
    fixed: NDArray[np.intp]  # positions of the bytes that are the same in every message of this layout

    @cached_property
    def wide(self) -> Mapping[str, tuple[int, int]]:
        """First byte, and the one after the last, of each field of 64-bit numbers."""
        return {name: (begin, begin + 8 * n) for name, (format_, n, begin) in self.offsets.items() if format_ == "<f8"}

    @cached_property
    def other_fields(self) -> tuple[str, ...]:
        """All other fields that are no part of the stamp."""
        return tuple(name for name in self.offsets if name not in self.wide and name not in ("sec", "nanosec"))

    @cached_property
    def empty(self) -> tuple[str, ...]:
        """Fields of the message type that messages of this layout have no numbers for."""
        return tuple(name for name in FIELDS[self.strings.kind] if name not in self.offsets)

    @cached_property
    def runs(self) -> tuple[tuple[int, int, bytes], ...]:
        """The fixed bytes: first position, the one after the last, and what stands there."""
        parts = np.split(self.fixed, np.flatnonzero(np.diff(self.fixed) > 1) + 1)
        ends = [(int(part[0]), int(part[-1]) + 1) for part in parts]
        return tuple((begin, end, self.template[begin:end]) for begin, end in ends)

    def fits(self, data: bytes) -> bool:
        """Check if a message, not shorter than the template, has this layout."""
        return all(data[begin:end] == text for begin, end, text in self.runs)

    @cached_property
    def dtype(self) -> np.dtype:
        """Structured type of messages without padding."""
        return self.dtype_of(len(self.template))

    def dtype_of(self, length: int) -> np.dtype:
        """Structured type of messages of `length` bytes; some writers pad the end."""
        return np.dtype(
            {
                "names": list(self.offsets),
                "formats": [(f, (n,)) for f, n, _ in self.offsets.values()],
                "offsets": [offset for _, _, offset in self.offsets.values()],
                "itemsize": length,
            }
        )


@cache
def _primitives(kind: str) -> tuple[tuple[str, int, str], ...]:
    """Primitive type, count (0: sequence) and dotted path of each field in the order of the bytes."""

    def walk(name: str, path: str) -> Iterable[tuple[str, int, str]]:
        for field_type, field in definitions.fields(name):
            inner, _, bracket = field_type.partition("[")
            field_path = f"{path}.{field}" if path else field
            if definitions.is_message(inner):
                yield from walk(inner, field_path)
            else:
                yield inner, int(bracket[:-1] or 0) if bracket else 1, field_path

    return tuple(walk(kind, ""))


def _field_at(kind: str, path: str) -> str | None:
    """The field of `FIELDS[kind]` that a primitive belongs to."""
    for field in FIELDS[kind]:
        start = _PATHS.get(kind, {}).get(field, field)
        if path == start or path.startswith(f"{start}."):
            return field
    return None


@lru_cache(maxsize=1024)
def layout_of(strings: Strings) -> Layout:
    """The byte layout of messages with these strings."""
    data = bytearray(HEADER)
    offsets: dict[str, tuple[str, int, int]] = {}
    fixed = [0, 1]

    def align(size: int) -> None:
        data.extend(b"\0" * (-(len(data) - len(HEADER)) % size))

    def put(value: bytes) -> None:
        fixed.extend(range(len(data), len(data) + len(value)))
        data.extend(value)

    def put_string(text: str) -> None:
        align(4)
        encoded = text.encode() + b"\0"
        put(struct.pack("<I", len(encoded)) + encoded)

    counts = dict(zip(("position", "velocity", "effort"), strings.counts, strict=True))
    for primitive, count, path in _primitives(strings.kind):
        if path == "name":
            align(4)
            put(struct.pack("<I", len(strings.names)))
            for name in strings.names:
                put_string(name)
            continue
        if primitive == "string":
            put_string(strings.frame_id if path == "header.frame_id" else strings.child_frame_id)
            continue
        if count == 0:
            count = counts[path]
            align(4)
            put(struct.pack("<I", count))
            if not count:
                continue
        size = np.dtype(_FORMATS[primitive]).itemsize
        align(size)
        field = path.rpartition(".")[2] if path.startswith("header.") else _field_at(strings.kind, path)
        if field is None:
            raise LookupError(f"{strings.kind}: {path} belongs to no number field")
        _, count_before, begin = offsets.get(field, ("", 0, len(data)))
        offsets[field] = _FORMATS[primitive], count_before + count, begin
        data.extend(b"\0" * (size * count))
    return Layout(strings, bytes(data), offsets, np.array(fixed))


def read_strings(kind: str, data: bytes) -> Strings:
    """Strings and array lengths of a message. Raises ValueError if the bytes are no such message."""
    if len(data) < 4 or data[0] != 0 or data[1] != 1:
        raise ValueError(f"expected little-endian CDR (00 01), found {data[:2].hex(' ') or 'nothing'}")
    at = 12

    def number() -> int:
        nonlocal at
        at += -(at - 4) % 4
        if at + 4 > len(data):
            raise ValueError(f"ends at byte {len(data)}, inside its strings")
        (value,) = struct.unpack_from("<I", data, at)
        at += 4
        return value

    def text() -> str:
        nonlocal at
        length = number()
        if length == 0 or at + length > len(data):
            raise ValueError(f"a string of {length} bytes at byte {at} does not fit into {len(data)} bytes")
        at += length
        return data[at - length : at - 1].decode()

    frame_id = text()
    if kind == "nav_msgs/msg/Odometry":
        return Strings(kind, frame_id, child_frame_id=text())
    if kind != "sensor_msgs/msg/JointState":
        return Strings(kind, frame_id)
    count = number()
    if count > _MAX_JOINTS:
        raise ValueError(f"{count} joint names; at most {_MAX_JOINTS} are plausible")
    names = tuple(text() for _ in range(count))
    counts = []
    for _ in range(3):
        length = number()
        if length not in (0, count):
            raise ValueError(f"{length} values for {count} joints")
        counts.append(length)
        if length:
            at += -(at - 4) % 8 + 8 * length
    return Strings(kind, frame_id, names=names, counts=(counts[0], counts[1], counts[2]))
