"""Messages as bytes, checked against rclpy's own serialization."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message

from vsense_ros.errors import InputError
from vsense_ros.messages import cdr, cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import FIELDS, Sample
from vsense_ros.node.convert import message_type

STAMP = 1_723_456_789_123_456_789
INTEGERS = {"status": 2, "service": 11, "position_covariance_type": 2}


def numbers(message: object) -> list[float]:
    """Every number of a message behind its header, in the order of its definition."""
    if isinstance(message, int | float):
        return [float(message)]
    if isinstance(message, str):
        return []
    if hasattr(message, "get_fields_and_field_types"):
        names = [name for name in message.get_fields_and_field_types() if name != "header"]
        return [value for name in names for value in numbers(getattr(message, name))]
    return [value for element in message for value in numbers(element)]  # type: ignore[attr-defined]


def sample_of(kind: str) -> Sample:
    generator = np.random.default_rng(list(kind.encode()))
    names = ("wheel_fl", "wheel_fr", "a") if kind.endswith("JointState") else ()
    values = {
        field: np.array([float(INTEGERS[field])]) if field in INTEGERS else generator.normal(size=length or len(names))
        for field, length in FIELDS[kind].items()
    }
    child = "cog" if kind.endswith("Odometry") else ""
    return Sample("some/topic", kind, STAMP, values, "a_frame", names, child)


@pytest.mark.parametrize("kind", sorted(FIELDS))
def test_rclpy_reads_the_bytes_of_a_sample_as_the_same_message(kind: str) -> None:
    sample = sample_of(kind)
    message = deserialize_message(cdr.encode(sample), message_type(kind))
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP
    assert message.header.frame_id == "a_frame"
    expected = np.concatenate([sample.values[field] for field in FIELDS[kind]])
    assert sorted(numbers(message)) == sorted(expected)
    assert list(getattr(message, "name", [])) == list(sample.names)
    assert getattr(message, "child_frame_id", "") == sample.child_frame_id


@pytest.mark.parametrize("kind", sorted(FIELDS))
def test_the_bytes_that_rclpy_makes_are_read_as_the_same_sample(kind: str) -> None:
    sample = sample_of(kind)
    message = deserialize_message(cdr.encode(sample), message_type(kind))
    back = cdr.decode(kind, serialize_message(message), "some/topic")
    assert (back.stamp, back.frame_id, back.names, back.child_frame_id) == (
        STAMP,
        "a_frame",
        sample.names,
        sample.child_frame_id,
    )
    for field in FIELDS[kind]:
        np.testing.assert_array_equal(back.values[field], sample.values[field])


def test_diagnostics_arrive_with_level_words_and_figures() -> None:
    status = Diagnostic("imu: imu/data", Level.WARN, "saturated", {"accepted": "12", "rate [Hz]": "99.8"})
    array = deserialize_message(cdr_messages.encode_diagnostics(STAMP, [status], "imu_driver"), DiagnosticArray)
    (read,) = array.status
    assert (read.name, read.level, read.message, read.hardware_id) == (
        "imu: imu/data",
        b"\x01",
        "saturated",
        "imu_driver",
    )
    assert {v.key: v.value for v in read.values} == {"accepted": "12", "rate [Hz]": "99.8"}


def test_an_unknown_message_type_is_named() -> None:
    with pytest.raises(InputError, match="sensor_msgs/msg/Nothing"):
        message_type("sensor_msgs/msg/Nothing")
