"""Findings and what mends them in words, and roles of topics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from synthetic_motion import STEERING, WHEELS, recorded
from vsense_ros.bag.importers import build
from vsense_ros.checks.finding import Finding, Kind, Rename, Scale, Turn
from vsense_ros.checks.mending import mended
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import USUAL_TOPICS, Role, message_type
from vsense_ros.checks.sentences import mend_in_words, sentence
from vsense_ros.checks.setting import JUDGEMENT, described, setting
from vsense_ros.checks.subject import Subject, measured, present
from vsense_ros.messages.recording import Recording
from vsense_ros.messages.topics import INPUTS

START = 1_600_000_000_000_000_000


@pytest.mark.parametrize(
    ("mend", "words"),
    [
        (Rename((("wheel_fl", "wheel_fr"),)), "t: left and right exchanged"),
        (Scale("velocity", -1.0), "t: the sign reversed"),
        (Scale("position", -1.0, "steering_wheel"), "t: steering_wheel: the sign reversed"),
        (Scale("position", np.pi / 180, "steering_wheel", "deg", "rad"), "t: steering_wheel: degrees into rad"),
        (Scale("linear", 1 / 3.6, given="km/h", expected="m/s"), "t: km/h into m/s"),
        (
            Turn(("angular_velocity",), ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))),
            "t: the sensor is turned: forward is −y, left is +x, up is +z",
        ),
    ],
)
def test_what_mends_a_topic_is_said_in_words(mend, words):
    assert mend_in_words(Finding("t", Kind.AXES, Reason.SENSOR_TURNED, mend=mend)) == words


def test_a_signal_is_said_as_its_field_is_named_where_its_values_are_meant():
    jump = Finding(
        "imu/data", Kind.JUMP, Reason.SIGNAL_JUMPS, "angular_velocity.z", span=(2.0, 2.0), evidence={"change": -3.0}
    )
    assert sentence(jump) == "angular_velocity.z jumps by -3 at 2.00 s"
    frozen = Finding("imu/data", Kind.FROZEN, Reason.VALUE_STANDS, "angular_velocity.z", span=(1.0, 3.5))
    assert sentence(frozen) == "angular_velocity.z is frozen for 2.5 s from 1.0 s on"
    size = Finding("imu/data", Kind.UNIT, Reason.RATE_SIZE, "angular_velocity.z", "wheels", evidence={"ratio": 2.5})
    assert (
        sentence(size) == "the yaw rate is 2.500 times the difference of the wheels on the right and left, expected 1"
    )


def test_the_unit_that_was_given_is_that_of_the_mend():
    mend = Scale("velocity", 3.0, given="m/s", expected="rad/s")
    finding = Finding(WHEELS, Kind.UNIT, Reason.WHEELS_UNIT, evidence={"ratio": 1.0}, mend=mend)
    assert sentence(finding).startswith("look like m/s, expected rad/s")


def test_mends_are_applied_in_turn_and_noted_and_what_has_none_is_left():
    stamp = build.nanoseconds(np.arange(20) * 0.1, START)
    recording = recorded(build.joints(STEERING, stamp, "position", {"steering_wheel": np.arange(20.0)})).recording
    degrees = Finding(STEERING, Kind.UNIT, Reason.STEERING_RANGE, mend=Scale("position", 0.5, "steering_wheel"))
    sign = Finding(STEERING, Kind.SIGN, Reason.TURNS_AGAINST, mend=Scale("position", -1.0, "steering_wheel"))
    nothing = Finding(STEERING, Kind.JUMP, Reason.SIGNAL_JUMPS)
    result = mended(recording, [degrees, nothing, sign])
    assert result[STEERING].columns["position"][:, 0].tolist() == (-0.5 * np.arange(20.0)).tolist()
    assert len(result.notes) == 2
    assert all(note.startswith("mended: vehicle/steering: ") for note in result.notes)
    assert recording[STEERING].columns["position"][1, 0] == 1.0


def test_roles_are_the_inputs_in_their_order():
    assert list(USUAL_TOPICS.values()) == list(INPUTS)
    assert message_type(Role.IMU) == message_type(Role.ATTITUDE) == "sensor_msgs/msg/Imu"
    assert message_type(Role.STEERING) == "sensor_msgs/msg/JointState"
    assert message_type(Role.POSITION) == "sensor_msgs/msg/NavSatFix"


@pytest.mark.parametrize(
    ("rows", "period", "usable"), [(20, 0.1, True), (9, 0.5, False), (10, 0.2, True), (20, 0.05, False)]
)
def test_of_a_topic_with_few_messages_or_of_less_than_a_second_nothing_is_said(rows, period, usable):
    stamp = build.nanoseconds(np.arange(rows) * period, START)
    subject = recorded(build.joints(WHEELS, stamp, "velocity", {"wheel_fl": np.ones(rows)}))
    assert (subject.channel(Role.WHEELS) is not None) == usable
    assert [role for role, _ in subject.channels()] == ([Role.WHEELS] if usable else [])
    assert list(subject.channels(Role.STEERING)) == []


def test_a_topic_of_another_type_is_not_looked_at():
    stamp = build.nanoseconds(np.arange(50) * 0.1, START)
    imu = build.imu(stamp, np.ones((50, 3)), np.ones((50, 3)))
    subject = Subject(Recording({WHEELS: replace(imu, topic=WHEELS)}))
    assert subject.channel(Role.WHEELS) is None
    assert subject.seconds(int(stamp[-1])) == pytest.approx(4.9)


def test_vectors_that_some_messages_mark_as_absent_are_absent_there():
    stamp = build.nanoseconds(np.arange(4) * 0.1, START)
    imu = build.imu(stamp, np.ones((4, 3)), np.ones((4, 3)))
    marks = np.zeros((4, 9))
    marks[1, 0] = -1.0
    some = replace(imu, columns={**imu.columns, "angular_velocity_covariance": marks})
    np.testing.assert_array_equal(
        np.isnan(present(some).columns["angular_velocity"][:, 0]), [False, True, False, False]
    )
    assert np.isfinite(present(some).columns["linear_acceleration"]).all()
    marks[:, 0] = -1.0
    assert np.isfinite(present(some).columns["angular_velocity"]).all()  # absent in all: nothing to mark
    assert "angular_velocity.x" not in dict(measured(some))
    assert "angular_velocity.x" in dict(measured(imu))
    assert "orientation.x" not in dict(measured(imu))


def test_measured_values_are_named_by_their_components_or_joints():
    stamp = build.nanoseconds(np.arange(4) * 0.1, START)
    zero = np.zeros(4)
    assert list(dict(measured(build.velocity(stamp, np.ones((4, 3)))))) == ["linear.x", "linear.y", "linear.z"]
    assert list(dict(measured(build.fix(stamp, zero, zero, zero)))) == ["latitude", "longitude", "altitude"]
    wheels = build.joints(WHEELS, stamp, "velocity", {"wheel_fl": zero, "wheel_fr": zero + 1})
    assert {name: v[0] for name, v in measured(wheels)} == {"velocity.wheel_fl": 0.0, "velocity.wheel_fr": 1.0}
    one = build.joints(WHEELS, stamp, "velocity", {"wheel_fl": zero})
    assert list(dict(measured(one))) == ["velocity.wheel_fl"]


def test_a_setting_has_its_unit_meaning_and_source():
    @dataclass(frozen=True)
    class Settings:
        span: float = setting(3.0, "s", "of means", JUDGEMENT)

    assert Settings().span == 3.0
    assert described(Settings) == {"span": ("s", "of means", "judgement")}
