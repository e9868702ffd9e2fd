"""Messages of other projects, written by the CDR serialisation of rosbags."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.messages.definitions import schema_text
from vsense_ros.messages.foreign import READABLE, converted, is_foreign
from vsense_ros.messages.recording import FIELDS

rosbags = pytest.importorskip("rosbags.typesys")

STORE = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
STORE.register(
    {
        name: definition
        for kind in ("VelocityReport", "SteeringReport")
        for name, definition in rosbags.get_types_from_msg(
            schema_text(f"autoware_vehicle_msgs/msg/{kind}"), f"autoware_vehicle_msgs/msg/{kind}"
        ).items()
        if name.startswith("autoware")
    }
)
TYPES = STORE.types
VELOCITY, STEERING = "autoware_vehicle_msgs/msg/VelocityReport", "autoware_vehicle_msgs/msg/SteeringReport"
POSE, WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
FRAMES = st.text("abc_/é", max_size=9)
SECONDS, NANOSECONDS = st.integers(0, 2**31 - 1), st.integers(0, 999_999_999)


def made(kind: str, **fields: object) -> object:
    return TYPES[kind](**fields)


def header(frame: str, sec: int = 7, nanosec: int = 9) -> object:
    stamp = made("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(numbers: np.ndarray) -> object:
    return made(
        "geometry_msgs/msg/Pose",
        position=made("geometry_msgs/msg/Point", **dict(zip("xyz", numbers[:3], strict=True))),
        orientation=made("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", numbers[3:7], strict=True))),
    )


def payload(message: object, kind: str) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))


@given(
    frame=FRAMES,
    sec=SECONDS,
    nanosec=NANOSECONDS,
    values=st.lists(st.floats(-50, 50, width=32), min_size=3, max_size=3),
)
def test_a_velocity_report_is_a_velocity_in_axes_of_the_car(frame, sec, nanosec, values):
    names = ("longitudinal_velocity", "lateral_velocity", "heading_rate")
    message = made(VELOCITY, header=header(frame, sec, nanosec), **dict(zip(names, values, strict=True)))
    channel, damaged = converted(VELOCITY, "t", [payload(message, VELOCITY)], np.array([11]))
    assert channel is not None
    assert (channel.kind, channel.frame_id, damaged) == ("geometry_msgs/msg/TwistWithCovarianceStamped", frame, 0)
    assert channel.stamp.tolist() == [sec * 10**9 + nanosec]
    assert channel.received.tolist() == [11]
    assert channel.columns["linear"].tolist() == [[*values[:2], 0.0]]
    assert channel.columns["angular"].tolist() == [[0.0, 0.0, values[2]]]


@given(angle=st.floats(-1, 1, width=32))
def test_a_steering_report_is_the_angle_of_the_front_wheels(angle):
    stamp = made("builtin_interfaces/msg/Time", sec=3, nanosec=5)
    message = made(STEERING, stamp=stamp, steering_tire_angle=angle)
    channel, _ = converted(STEERING, "t", [payload(message, STEERING)] * 2, np.array([11, 12]))
    assert channel is not None
    assert (channel.kind, channel.names) == ("sensor_msgs/msg/JointState", ("road_wheel_front",))
    assert channel.columns["position"].tolist() == [[angle], [angle]]
    assert channel.columns["velocity"].shape == (2, 0)
    assert channel.stamp.tolist() == [3_000_000_005] * 2


@given(frame=FRAMES, seed=st.integers(0, 20))
def test_poses_are_odometry_without_velocities_with_the_covariance_that_they_state(frame, seed):
    numbers = np.random.default_rng(seed).normal(size=43)
    plain = made(POSE, header=header(frame), pose=pose(numbers))
    sure = made("geometry_msgs/msg/PoseWithCovariance", pose=pose(numbers), covariance=numbers[7:])
    stated = made(WITH_COVARIANCE, header=header(frame), pose=sure)
    for kind, message, covariance in ((POSE, plain, np.zeros(36)), (WITH_COVARIANCE, stated, numbers[7:])):
        channel, damaged = converted(kind, "t", [payload(message, kind)], np.array([1]))
        assert channel is not None
        assert (channel.kind, channel.frame_id, channel.child_frame_id, damaged) == (
            "nav_msgs/msg/Odometry", frame, "base_link", 0,
        )  # fmt: skip
        np.testing.assert_array_equal(channel.columns["position"][0], numbers[:3])
        np.testing.assert_array_equal(channel.columns["orientation"][0], numbers[3:7])
        np.testing.assert_array_equal(channel.columns["pose_covariance"][0], covariance)
        assert np.isnan(channel.columns["linear"]).all()
        assert np.isnan(channel.columns["angular"]).all()
        assert channel.columns["twist_covariance"][0, 0] == -1.0
        assert not channel.columns["twist_covariance"][0, 1:].any()


def test_damaged_messages_are_counted_and_the_others_kept_in_their_order():
    message = payload(made(POSE, header=header("map"), pose=pose(np.arange(7.0))), POSE)
    big_endian = b"\x00\x00" + message[2:]
    no_text = message[:12] + b"\x00\x00\x00\x00" + message[16:]
    long_text = message[:12] + b"\xff\x00\x00\x00" + message[16:]
    payloads = [message, message[:-1], big_endian, message[:10], no_text, long_text, b"", message]
    channel, damaged = converted(POSE, "t", payloads, np.arange(8))
    assert channel is not None
    assert damaged == 6
    assert channel.received.tolist() == [0, 7]
    assert converted(POSE, "t", payloads[1:7], np.arange(6)) == (None, 6)


def test_a_frame_may_be_as_long_as_the_message():
    """The text ends with the message: there are no numbers behind it."""
    stub = payload(made(POSE, header=header("map"), pose=pose(np.arange(7.0))), POSE)[:20]
    assert converted(POSE, "t", [stub], np.arange(1)) == (None, 1)


def test_types_of_ours_are_readable_and_not_foreign():
    assert {POSE, VELOCITY, *FIELDS} <= READABLE
    assert is_foreign(POSE)
    assert not is_foreign("sensor_msgs/msg/Imu")
