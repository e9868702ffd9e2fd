"""The frame of a GNSS velocity and the position, on drives in closed form, turned and exchanged on purpose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import GNSS_SIGNALS, POSITION, STEP, VELOCITY, Array, Drive, aligned_of, motion_by, only
from vsense_ros.checks.finding import Confidence, Finding, Kind, Scale
from vsense_ros.checks.frames import course_stays, position_steps, velocity_against_position
from vsense_ros.checks.reason import Reason
from vsense_ros.messages.units import to_si

NAMES = ("x", "y", *GNSS_SIGNALS)


def receiver(*further: str, **drive: float) -> dict[str, Array]:
    return only(Drive(**drive).signals(), *NAMES, *further)


def found(signals: dict[str, Array]) -> Finding | None:
    return velocity_against_position(aligned_of(signals))


@settings(max_examples=12, deadline=None)
@given(heading=st.floats(-np.pi, np.pi), speed=st.floats(8.0, 40.0))
def test_a_velocity_that_is_the_change_of_the_position_is_right_wherever_the_drive_goes(heading, speed):
    assert found(receiver("wz", heading=heading, speed=speed)) is None


def in_axes_of_car(east: Array, north: Array) -> tuple[Array, Array]:
    speed = np.hypot(east, north)
    return speed, 0 * speed


FORMS = {
    Reason.VELOCITY_IN_CAR_AXES: (in_axes_of_car, Kind.FRAME),
    Reason.VELOCITY_EXCHANGED: (lambda east, north: (north, east), Kind.FRAME),
    Reason.VELOCITY_EAST_REVERSED: (lambda east, north: (-east, north), Kind.SIGN),
    Reason.VELOCITY_NORTH_REVERSED: (lambda east, north: (east, -north), Kind.SIGN),
    Reason.VELOCITY_REVERSED: (lambda east, north: (-east, -north), Kind.SIGN),
    Reason.VELOCITY_QUARTER_TURN: (lambda east, north: (-north, east), Kind.FRAME),
}


@pytest.mark.parametrize("reason", FORMS)
@pytest.mark.parametrize("further", [(), ("wz",)])
def test_the_frame_in_which_a_velocity_is_told_is_named(reason, further):
    change, kind = FORMS[reason]
    signals = receiver(*further, heading=0.9, turning=2.0)
    signals["east"], signals["north"] = change(signals["east"], signals["north"])
    finding = found(signals)
    assert finding is not None
    assert (finding.topic, finding.kind, finding.reason, finding.against) == (VELOCITY, kind, reason, POSITION)


def test_a_quarter_turn_to_the_right_is_named_as_one_to_the_left_is():
    signals = receiver(heading=0.9, turning=2.0)
    signals["east"], signals["north"] = signals["north"], -signals["east"]
    finding = found(signals)
    assert finding is not None
    assert finding.reason is Reason.VELOCITY_QUARTER_TURN


@pytest.mark.parametrize("unit", ["km/h", "mph", "kn"])
def test_the_unit_of_a_velocity_is_named_with_what_takes_it_to_si(unit):
    signals = receiver("wz")
    for name in GNSS_SIGNALS:
        signals[name] = signals[name] / to_si(unit)
    finding = found(signals)
    assert finding is not None
    assert (finding.kind, finding.reason) == (Kind.UNIT, Reason.VELOCITY_UNIT)
    assert finding.mend == Scale("linear", to_si(unit), given=unit, expected="m/s")
    assert finding.evidence["ratio"] == pytest.approx(1 / to_si(unit), rel=0.02)


@pytest.mark.parametrize(("factor", "named"), [(0.45, True), (0.7, False), (1.3, False), (2.7, True)])
def test_a_velocity_of_another_size_is_named_with_its_ratio(factor, named):
    signals = receiver("wz")
    for name in GNSS_SIGNALS:
        signals[name] = signals[name] * factor
    finding = found(signals)
    assert (finding is not None and finding.reason is Reason.VELOCITY_SIZE) == named
    if named:
        assert finding.evidence["ratio"] == pytest.approx(factor, rel=0.02)


def test_a_velocity_that_no_form_explains_is_doubted():
    signals = receiver(turning=2.0)
    course = np.arctan2(signals["north"], signals["east"]) + 1.0
    speed = np.hypot(signals["east"], signals["north"])
    signals["east"], signals["north"] = speed * np.cos(course), speed * np.sin(course)
    finding = found(signals)
    assert finding is not None
    assert (finding.reason, finding.confidence) == (Reason.VELOCITY_APART, Confidence.UNDECIDED)
    assert finding.evidence["apart"] == pytest.approx(2 * np.sin(0.5) * 15.0, rel=0.1)


def test_a_velocity_that_no_form_explains_is_not_doubted_for_a_little_or_in_a_short_drive():
    for turn, drive in ((0.3, {"turning": 2.0}), (1.0, {"turning": 2.0, "duration": 5.0})):
        signals = receiver(**drive)
        course = np.arctan2(signals["north"], signals["east"]) + turn
        speed = np.hypot(signals["east"], signals["north"])
        signals["east"], signals["north"] = speed * np.cos(course), speed * np.sin(course)
        assert found(signals) is None


def test_latitude_and_longitude_that_are_exchanged_are_named():
    signals = receiver("wz", heading=0.4, turning=2.0)
    signals["x'"], signals["y'"] = signals["x"], signals["y"]
    signals["x"], signals["y"] = 1.3 * signals["y"], 0.8 * signals["x"]
    finding = found(signals)
    assert finding is not None
    assert (finding.topic, finding.reason, finding.against) == (POSITION, Reason.POSITION_EXCHANGED, VELOCITY)


def test_a_position_that_turns_against_the_gyro_is_wrong_and_not_the_velocity():
    signals = receiver("wz", heading=0.4, turning=2.0)
    signals["x"] = -signals["x"]
    finding = found(signals)
    assert finding is not None
    assert (finding.topic, finding.reason) == (POSITION, Reason.POSITION_AGAINST_YAW_RATE)


def test_without_a_position_or_a_velocity_or_a_motion_nothing_is_compared():
    signals = receiver()
    assert found(only(signals, "x", "y")) is None
    assert found(only(signals, *GNSS_SIGNALS)) is None
    slow = receiver(speed=2.0, pushing=0.3)
    slow["east"] = -slow["east"]
    assert found(slow) is None


def test_fixes_are_averaged_for_longer_where_they_are_noisier():
    """Noise of so many metres, over means of a second, is not taken for a velocity that differs."""
    rng = np.random.default_rng(0)
    for sigma in (0.02, 1.0, 2.5):
        signals = receiver("wz")
        for name in "xy":
            rough = rng.normal(scale=sigma, size=len(signals[name]) // 5)
            signals[name] = signals[name] + np.repeat(rough, 5)
        assert found(signals) is None, sigma


def test_a_velocity_in_axes_of_the_car_is_seen_without_a_position_by_a_course_that_stays():
    signals = receiver("wz")
    assert course_stays(motion_by(only(signals, *GNSS_SIGNALS, "wz"))) is None
    signals["east"], signals["north"] = in_axes_of_car(signals["east"], signals["north"])
    finding = course_stays(motion_by(only(signals, *GNSS_SIGNALS, "wz")))
    assert finding is not None
    assert (finding.topic, finding.kind, finding.reason) == (VELOCITY, Kind.FRAME, Reason.COURSE_STAYS)
    assert finding.evidence["course"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("drive", "course"),
    [({"turning": 0.0}, 0.0), ({"turning": 0.05}, 0.0), ({}, 0.1), ({}, -0.1), ({"speed": 3.0}, 0.0)],
    ids=["straight", "nearly straight", "to the left", "to the right", "slow"],
)
def test_a_course_that_stays_is_no_axis_of_the_car_where_the_car_does_not_turn_or_the_course_is_another(drive, course):
    signals = receiver("wz", **drive)
    speed = np.hypot(signals["east"], signals["north"])
    signals["east"], signals["north"] = speed * np.cos(course), speed * np.sin(course)
    assert course_stays(motion_by(only(signals, *GNSS_SIGNALS, "wz"))) is None


def test_without_a_gyro_no_course_is_said_to_stay():
    signals = receiver()
    signals["east"], signals["north"] = in_axes_of_car(signals["east"], signals["north"])
    assert course_stays(motion_by(only(signals, *GNSS_SIGNALS))) is None


@settings(max_examples=15, deadline=None)
@given(step=st.sampled_from([-60.0, -9.0, 6.0, 30.0]), axis=st.sampled_from("xy"), at=st.floats(12.0, 28.0))
def test_a_position_that_steps_and_stays_there_is_named_with_how_far_and_when(step, axis, at):
    signals = receiver()
    times = np.arange(len(signals["x"])) * STEP
    signals[axis] = signals[axis] + np.where(times >= at, step, 0.0)
    (finding,) = position_steps(aligned_of(signals, begin=5.0))
    assert (finding.topic, finding.kind, finding.reason) == (POSITION, Kind.JUMP, Reason.POSITION_STEPS)
    assert finding.evidence["step"] == pytest.approx(abs(step), abs=0.3)
    assert finding.span == pytest.approx((at + 5.0, at + 5.0), abs=0.3)


def test_a_position_does_not_step_by_little_by_its_noise_or_in_a_short_drive():
    signals = receiver()
    times = np.arange(len(signals["x"])) * STEP
    assert list(position_steps(aligned_of(signals))) == []
    small = {**signals, "x": signals["x"] + np.where(times > 20.0, 3.0, 0.0)}
    assert list(position_steps(aligned_of(small))) == []
    wander = np.repeat(np.cumsum(np.random.default_rng(0).normal(scale=2.0, size=len(times) // 5)), 5)
    assert list(position_steps(aligned_of({**signals, "x": signals["x"] + wander}))) == []
    short = {name: values[:150] for name, values in signals.items()}
    short["x"] = short["x"] + np.where(times[:150] > 1.5, 30.0, 0.0)
    assert list(position_steps(aligned_of(short))) == []
    assert list(position_steps(aligned_of(only(signals, "x", "y")))) == []
