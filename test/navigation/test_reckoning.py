"""Axes of an inertial sensor are reckoned from wheels, steering and GNSS where their readings cannot be believed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.sensors import SensorBase
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.reckoning import ACROSS, UP, YAW_RATE, Reckoning, ReckoningSettings

GATE, STEP = 6.0, 0.01  # [standard deviations], [s]
SETTINGS = ReckoningSettings()
CAR = load_vehicle(vehicle_path("prototype_model"))
SENSORS = CAR.sensing()
NUMBERS = car_numbers(CAR, SENSORS.values())
NOISE = np.full(6, 0.003**2)


def of(kind: str) -> SensorBase:
    return next(one for one in SENSORS.values() if kind in one.measures)


def reckoning() -> Reckoning:
    made = Reckoning(np.zeros(Reckoning.SIZE), range(6), NUMBERS)
    made.restart()
    return made


def accept(made: Reckoning, sensor: SensorBase, value: np.ndarray) -> None:
    """Give a reading of a sensor that is not inertial."""
    taken = made.takes(sensor)
    assert taken is not None
    taken(value)


def turning(speed: float, rate: float) -> np.ndarray:
    """Spins of four wheels [rad/s] that roll in a bend."""
    off = 0.5 * rate * NUMBERS["rear_track"]
    return np.array([speed - off, speed + off] * 2) / NUMBERS["rolling_radius"]


def drive(made: Reckoning, seconds: float, speed: float, rate: float, reading: np.ndarray | None) -> list[list[int]]:
    """Go on in a steady bend, with a reading at each step or none; which axes were refused."""
    refused = []
    for _ in range(round(seconds / STEP)):
        if made.go_on(STEP):
            made.reckon(STEP)
        accept(made, of("rolling speed"), turning(speed, rate))
        if reading is not None:
            refused.append(made.read(reading, NOISE, GATE)[2])
    return refused


def steady(speed: float, rate: float) -> np.ndarray:
    return np.array([0.0, 0.0, rate, 0.0, speed * rate, 9.80665])


@settings(max_examples=15, deadline=None)
@given(speed=st.floats(5.0, 40.0), rate=st.floats(-0.4, 0.4))
def test_while_readings_are_missing_the_yaw_rate_is_that_of_the_wheels(speed: float, rate: float) -> None:
    made = reckoning()
    drive(made, 1.0, speed, rate, steady(speed, rate))
    drive(made, 3.0, speed, rate, None)
    assert made.doubted.all()
    assert made.expected[YAW_RATE] == pytest.approx(rate, abs=0.02)
    assert made.expected[ACROSS] == pytest.approx(speed * rate, abs=0.2)
    assert made.expected[UP] == pytest.approx(9.81, abs=0.01)


@given(jump=st.sampled_from([-3.0, -0.5, 0.5, 3.0]), axis=st.integers(0, 2))
@settings(deadline=None)
def test_a_gyro_that_jumps_is_refused_and_no_other_axis(jump: float, axis: int) -> None:
    made, wrong = reckoning(), steady(15.0, 0.2)
    assert not any(drive(made, 1.0, 15.0, 0.2, steady(15.0, 0.2)))
    wrong[axis] += jump
    assert drive(made, 0.05, 15.0, 0.2, wrong) == [[axis]] * 5


def test_a_reading_that_is_right_again_is_believed_again() -> None:
    made, wrong = reckoning(), steady(15.0, 1.2)
    drive(made, 1.0, 15.0, 0.2, steady(15.0, 0.2))
    drive(made, 0.5, 15.0, 0.2, wrong)
    assert not any(drive(made, 0.5, 15.0, 0.2, steady(15.0, 0.2)))
    assert not made.doubted.any()


def test_a_car_that_turns_in_as_quickly_as_it_can_is_believed() -> None:
    """Within 0.2 s from straight on to 0.8 rad/s, faster than the sine with dwell of the committed bags."""
    made = reckoning()
    drive(made, 1.0, 20.0, 0.0, steady(20.0, 0.0))
    for rate in np.linspace(0.0, 0.8, 20):
        assert drive(made, STEP, 20.0, float(rate), steady(20.0, float(rate))) == [[]]


def test_what_is_reckoned_is_known_less_well_the_longer_it_lasts_and_never_worse_than_by_the_others_alone() -> None:
    made = reckoning()
    drive(made, 1.0, 15.0, 0.2, steady(15.0, 0.2))
    spoilt = []
    for _ in range(8):
        drive(made, 0.5, 15.0, 0.2, None)
        spoilt.append(made.spoils(YAW_RATE))
    assert np.all(np.diff(spoilt) > 0)
    assert spoilt[-1] < 2 * SETTINGS.memory * SETTINGS.yaw_rate_deviation**2


def test_without_wheels_and_steering_the_course_determines_the_yaw_rate() -> None:
    made, course = reckoning(), of("course")
    for k in range(300):
        made.go_on(STEP)
        if k % 10 == 0:
            angle = 0.2 * k * STEP
            accept(made, course, 15.0 * np.array([np.cos(angle), np.sin(angle)]))
        if k < 100:
            made.read(steady(15.0, 0.2), NOISE, GATE)
        elif made.doubted.any():
            made.reckon(STEP)
    assert made.expected[YAW_RATE] == pytest.approx(0.2, abs=0.02)
    assert made.expected[ACROSS] == pytest.approx(3.0, abs=0.5)
