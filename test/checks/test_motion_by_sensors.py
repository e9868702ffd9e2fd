"""How each sensor measures the motion of a drive in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from synthetic_motion import (
    GNSS_SIGNALS,
    STEERED,
    STEP,
    WHEEL_SIGNALS,
    Drive,
    aligned_of,
    motion_by,
    only,
    subject_of,
)
from vsense_ros.checks.motion import (
    ACCELEROMETER,
    GNSS,
    GYRO,
    ROAD_WHEEL,
    STEERING_WHEEL,
    WHEELS,
    ground_span,
    motion_of,
)

DRIVE = Drive()
SIGNALS = DRIVE.signals()
TRUE_SPEED = np.hypot(SIGNALS["east"], SIGNALS["north"])
INSIDE = slice(60, -60)
SOURCES = (GNSS, WHEELS, GYRO, ACCELEROMETER, STEERING_WHEEL, ROAD_WHEEL)


@pytest.mark.parametrize("source", SOURCES)
def test_each_source_measures_how_the_car_turns(source):
    turn = motion_by(SIGNALS).turns[source][INSIDE]
    assert np.isfinite(turn).all()
    assert np.sqrt(np.mean((turn - SIGNALS["wz"][INSIDE]) ** 2)) < 0.015


@pytest.mark.parametrize("source", [GNSS, WHEELS, ACCELEROMETER])
def test_each_source_measures_how_the_car_gains_speed(source):
    push = motion_by(SIGNALS).pushes[source][INSIDE]
    assert np.sqrt(np.mean((push - SIGNALS["ax"][INSIDE]) ** 2)) < 0.12


def test_the_speed_is_that_over_ground_or_by_the_position_or_by_the_wheels():
    for names, error in ((GNSS_SIGNALS, 1e-9), (("x", "y"), 1.5), (WHEEL_SIGNALS, 1e-9)):
        speed = motion_by(only(SIGNALS, *names)).speed[INSIDE]
        assert speed == pytest.approx(TRUE_SPEED[INSIDE], abs=error)
    backwards = {name: -values for name, values in only(SIGNALS, *WHEEL_SIGNALS).items()}
    assert (motion_by(backwards).speed > 0).all()


def test_without_a_speed_the_inertial_sensor_says_how_it_turns_and_nobody_else():
    motion = motion_by(only(SIGNALS, "wz", "ax", *STEERED))
    assert not motion.has_speed
    assert motion.turns.keys() == {GYRO}
    assert motion.pushes.keys() == {ACCELEROMETER}
    assert motion.along is None


def test_a_velocity_that_cannot_be_used_is_replaced_by_the_change_of_the_position():
    wrong = {**only(SIGNALS, "x", "y"), "east": 0 * SIGNALS["east"], "north": 0 * SIGNALS["north"]}
    motion = motion_of(aligned_of(wrong), course_by_position=True)
    assert np.nanmax(np.abs(motion.turns[GNSS][100:-100] - SIGNALS["wz"][100:-100])) < 0.35
    assert motion.speed[100:-100] == pytest.approx(TRUE_SPEED[100:-100], abs=1.5)
    assert motion.gnss_span == 2.0


@pytest.mark.parametrize(("sign", "scale"), [(1.0, 1.0), (-1.0, 1.0), (1.0, 3.6)])
def test_the_radius_by_which_wheels_roll_has_the_sign_of_their_turning(sign, scale):
    wheels = {name: sign * scale * v for name, v in only(SIGNALS, *WHEEL_SIGNALS).items()}
    motion = motion_by({**only(SIGNALS, *GNSS_SIGNALS), **wheels})
    assert motion.radius == pytest.approx(sign * 0.32 / scale, rel=1e-6)
    assert motion.radius_scatter == pytest.approx(0.0, abs=1e-6)
    assert motion_by(wheels).radius is None


@pytest.mark.parametrize(("rear", "used"), [(1.0, True), (-1.0, False), (0.0, True)])
def test_wheels_do_not_say_how_the_car_turns_where_one_axle_contradicts_the_other(rear, used):
    signals = only(SIGNALS, *WHEEL_SIGNALS)
    middle, half = (signals["wheel_fr"] + signals["wheel_fl"]) / 2, (signals["wheel_fr"] - signals["wheel_fl"]) / 2
    signals["wheel_rl"], signals["wheel_rr"] = middle - rear * half, middle + rear * half
    motion = motion_by(signals)
    assert (WHEELS in motion.turns) == used


def test_the_rear_wheels_say_how_the_car_turns_and_the_front_wheels_where_there_are_no_others():
    signals = only(SIGNALS, *WHEEL_SIGNALS)
    signals["wheel_fr"] = signals["wheel_fl"] + 2 * (signals["wheel_fr"] - signals["wheel_fl"])
    assert motion_by(signals).turns[WHEELS][INSIDE] == pytest.approx(
        motion_by(only(signals, "wheel_rl", "wheel_rr")).turns[WHEELS][INSIDE], rel=0.2, abs=0.01
    )
    front = motion_by(only(SIGNALS, "wheel_fl", "wheel_fr")).turns[WHEELS]
    assert front[INSIDE] == pytest.approx(SIGNALS["wz"][INSIDE], abs=0.02)
    assert WHEELS not in motion_by(only(SIGNALS, "wheel_fl", "wheel_rr")).turns


def test_nothing_is_said_of_the_turning_at_walking_pace_or_while_the_car_brakes_hard():
    t = np.arange(0.0, 20.0, STEP)
    speed = np.interp(t, [0.0, 8.0, 10.0, 13.0, 20.0], [25.0, 25.0, 10.0, 2.0, 2.0])
    heading = 0.1 * t
    motion = motion_by({"east": speed * np.cos(heading), "north": speed * np.sin(heading), "wz": 0 * t + 0.1})
    for first, end, present in ((0.5, 7.0, True), (8.7, 9.3, False), (10.8, 12.0, True), (13.5, 19.0, False)):
        within = motion.turns[GYRO][(t > first) & (t < end)]
        assert np.isfinite(within).all() if present else np.isnan(within).all(), (first, end)
    assert np.isnan(motion.turns[GNSS][(t > 12.2)]).all()  # slower than 5 m/s


def test_gnss_is_averaged_over_two_of_its_periods():
    assert ground_span(aligned_of(only(SIGNALS, *GNSS_SIGNALS), period=0.1)) == 0.3
    assert ground_span(aligned_of(only(SIGNALS, *GNSS_SIGNALS), period=1.0)) == 2.0
    assert ground_span(aligned_of(only(SIGNALS, "wz"))) == 0.3


def test_signals_are_compared_as_the_slower_of_both_is_averaged():
    motion = motion_by(SIGNALS, period=1.0)
    found = motion.compared(motion.turns, GYRO, GNSS)
    assert found is not None
    assert found.correlation > 0.99
    assert found.ratio == pytest.approx(1.0, abs=0.03)
    assert found.lag == pytest.approx(0.0, abs=0.03)


def test_the_first_source_that_turns_is_taken():
    motion = motion_by(SIGNALS)
    assert motion.first_turning(WHEELS, GNSS) == WHEELS
    motion.turns[WHEELS] = 0 * motion.turns[WHEELS]
    assert motion.first_turning(WHEELS, GNSS) == GNSS
    assert motion.first_turning(WHEELS) is None
    assert motion.first_turning(GNSS, least=10.0) is None


@pytest.mark.parametrize("source", [GNSS, GYRO, WHEELS])
def test_the_acceleration_to_the_left_is_speed_times_turning(source):
    motion = motion_by(SIGNALS)
    left = motion.to_the_left(source)[INSIDE]
    assert np.sqrt(np.mean((left - SIGNALS["ay"][INSIDE]) ** 2)) < 0.3


def test_the_acceleration_along_the_car_is_that_of_gnss_or_of_the_wheels():
    for names in (GNSS_SIGNALS, WHEEL_SIGNALS):
        along = motion_by(only(SIGNALS, *names)).along
        assert along is not None
        assert np.sqrt(np.mean((along[INSIDE] - SIGNALS["ax"][INSIDE]) ** 2)) < 0.15


def test_a_recording_whose_velocity_is_in_axes_of_the_car_has_the_motion_of_its_position():
    signals = only(SIGNALS, "x", "y", "wz", *GNSS_SIGNALS)
    speed = np.hypot(signals["east"], signals["north"])
    subject = subject_of({**signals, "east": speed, "north": 0 * speed})
    assert subject.velocity_is_wrong
    assert subject.motion is not None
    assert subject.motion.gnss_span == 2.0
    alone = subject_of({"wz": signals["wz"], "east": speed, "north": 0 * speed})
    assert [finding.topic for finding in alone.course_findings] == ["gps/velocity"]
    assert alone.motion is not None
    assert GNSS not in alone.motion.turns
    right = subject_of(signals)
    assert not right.velocity_is_wrong
    assert right.motion is right.measured_motion
    assert subject_of(only(SIGNALS, "wz")).motion is None
