"""Messages of other people that say what a type of this project says: each becomes one of that type.

Autoware's reports of a vehicle, and poses of a localization. Types that have a numeric form of their own stand in
`messages.recording.FIELDS`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.cdr_layout import HEADER
from vsense_ros.messages.recording import FIELDS, Channel

Array = NDArray[np.float64]
Read = tuple[int, str, tuple[float, ...]]  # stamp [ns], frame, numbers

_POSE = 7  # numbers of a position and a quaternion


class _Cursor:
    """Reads little-endian CDR bytes field by field. Raises `struct.error` where they end too soon."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != HEADER[:2]:
            raise struct.error("not little-endian CDR")
        self.data, self.at = data, len(HEADER)

    def numbers(self, code: str, count: int) -> tuple[float, ...]:
        size = struct.calcsize(code)
        self.at += -(self.at - len(HEADER)) % size
        values = struct.unpack_from(f"<{count}{code}", self.data, self.at)
        self.at += size * count
        return values

    def stamp(self) -> int:
        seconds, nanoseconds = int(self.numbers("i", 1)[0]), int(self.numbers("I", 1)[0])
        return seconds * 1_000_000_000 + nanoseconds

    def text(self) -> str:
        length = int(self.numbers("I", 1)[0])
        if not 0 < length <= len(self.data) - self.at:
            raise struct.error("a text that goes beyond the message")
        text = self.data[self.at : self.at + length - 1].decode(errors="replace")
        self.at += length
        return text


def _velocity_report(data: bytes) -> Read:
    cursor = _Cursor(data)
    return cursor.stamp(), cursor.text(), cursor.numbers("f", 3)


def _steering_report(data: bytes) -> Read:
    cursor = _Cursor(data)
    return cursor.stamp(), "", cursor.numbers("f", 1)


def _pose(data: bytes) -> Read:
    cursor = _Cursor(data)
    return cursor.stamp(), cursor.text(), cursor.numbers("d", _POSE)


def _pose_with_covariance(data: bytes) -> Read:
    cursor = _Cursor(data)
    return cursor.stamp(), cursor.text(), cursor.numbers("d", _POSE + 36)


def _body_velocity(numbers: Array) -> tuple[str, dict[str, Array], tuple[str, ...]]:
    """Forward and to the left [m/s], turning left [rad/s]; their noise is not stated."""
    rows = len(numbers)
    linear = np.column_stack([numbers[:, :2], np.zeros(rows)])
    angular = np.column_stack([np.zeros((rows, 2)), numbers[:, 2]])
    columns = {"linear": linear, "angular": angular, "covariance": np.zeros((rows, 36))}
    return "geometry_msgs/msg/TwistWithCovarianceStamped", columns, ()


def _road_wheel(numbers: Array) -> tuple[str, dict[str, Array], tuple[str, ...]]:
    """Angle of the front wheels [rad], positive to the left."""
    empty = np.zeros((len(numbers), 0))
    return (
        "sensor_msgs/msg/JointState",
        {"position": numbers, "velocity": empty, "effort": empty},
        ("road_wheel_front",),
    )


def _odometry(numbers: Array) -> tuple[str, dict[str, Array], tuple[str, ...]]:
    """A pose in the map, without velocities."""
    rows = len(numbers)
    covariance = numbers[:, _POSE:] if numbers.shape[1] > _POSE else np.zeros((rows, 36))
    absent = np.zeros((rows, 36))
    absent[:, 0] = -1.0
    columns = {
        "position": numbers[:, :3],
        "orientation": numbers[:, 3:_POSE],
        "pose_covariance": covariance,
        "linear": np.full((rows, 3), np.nan),
        "angular": np.full((rows, 3), np.nan),
        "twist_covariance": absent,
    }
    return "nav_msgs/msg/Odometry", columns, ()


_Made = Callable[[Array], tuple[str, dict[str, Array], tuple[str, ...]]]
# How each type is read, and what is made of its numbers.
_FOREIGN: Mapping[str, tuple[Callable[[bytes], Read], _Made]] = MappingProxyType(
    {
        "autoware_vehicle_msgs/msg/VelocityReport": (_velocity_report, _body_velocity),
        "autoware_auto_vehicle_msgs/msg/VelocityReport": (_velocity_report, _body_velocity),
        "autoware_vehicle_msgs/msg/SteeringReport": (_steering_report, _road_wheel),
        "autoware_auto_vehicle_msgs/msg/SteeringReport": (_steering_report, _road_wheel),
        "geometry_msgs/msg/PoseStamped": (_pose, _odometry),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (_pose_with_covariance, _odometry),
    }
)
READABLE = frozenset({*FIELDS, *_FOREIGN})  # types of which messages become numbers


def is_foreign(kind: str) -> bool:
    """True for a type whose messages become those of another."""
    return kind in _FOREIGN


def converted(
    kind: str, topic: str, payloads: Sequence[bytes] | NDArray[np.uint8], received: NDArray[np.int64]
) -> tuple[Channel | None, int]:
    """The messages of a foreign type as a channel of this project's, in their order; and how many are damaged.

    `payloads` are CDR bytes, `received` (n,) their times of arrival [ns].
    """
    read_message, make = _FOREIGN[kind]
    rows, stamps, numbers, frame = [], [], [], ""
    for row, payload in enumerate(payloads):
        try:
            stamp, frame, values = read_message(bytes(payload))
        except struct.error:
            continue
        rows.append(row)
        stamps.append(stamp)
        numbers.append(values)
    damaged = len(payloads) - len(rows)
    if not rows:
        return None, damaged
    ros_type, columns, names = make(np.array(numbers, dtype=np.float64))
    child = "base_link" if ros_type == "nav_msgs/msg/Odometry" else ""
    stamp_array = np.array(stamps, dtype=np.int64)
    return Channel(topic, ros_type, stamp_array, received[rows], columns, frame, names, child), damaged
