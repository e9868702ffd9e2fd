"""Smoothed inputs: against least squares, and against the signal to which the noise was added."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.checks.noise import white_noise
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.identification import cornering_stiffness, identify
from vsense_ros.identification.recorded import drives, signals
from vsense_ros.identification.smoothing import _penalised, smoothed
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.sensing import record

STEP = 0.01  # [s]
T = np.arange(6000) * STEP


@settings(deadline=None, max_examples=30)
@given(st.integers(4, 60), st.floats(-3, 3), st.integers(0, 1000))
def test_the_smoothed_signal_has_the_least_sum_of_squares(n, exponent, seed):
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=n), 10**exponent * rng.uniform(0.1, 10.0, n - 2)
    rows = np.vstack([np.eye(n), np.sqrt(weights)[:, None] * np.diff(np.eye(n), 2, axis=0)])
    expected = np.linalg.lstsq(rows, np.concatenate([values, np.zeros(n - 2)]), rcond=None)[0]
    assert _penalised(values, weights) == pytest.approx(expected, abs=1e-8 * max(1.0, 10**exponent))


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_where_nothing_moves_little_noise_is_left_and_where_something_does_it_is_kept(noise):
    signal = np.where((T > 20) & (T < 40), 0.03 * np.sin(2 * np.pi * 0.25 * (T - 20)), 0.0)
    off = smoothed(signal + noise * np.random.default_rng(0).normal(size=len(T)), noise, STEP) - signal
    assert off[(T > 3) & (T < 17)].std() < 0.1 * noise
    assert off[(T > 22) & (T < 38)].std() < 0.5 * noise
    assert np.abs(off[(T > 19) & (T < 41)]).max() < 3 * noise


def test_a_straight_line_and_a_signal_without_noise_stay_as_they_are():
    line = 0.2 - 0.01 * T
    assert smoothed(line, 1e-3, STEP) == pytest.approx(line, abs=1e-6)
    assert np.array_equal(smoothed(np.sin(T), 0.0, STEP), np.sin(T))


def test_the_steering_angle_of_a_drive_that_is_identified_is_smoothed_where_the_road_is_straight():
    car = load_vehicle(vehicle_path("jaguar_saloon"))
    recording = record(drive(MANOEUVRES["lane_change_45"], car), car, 3, name="gentle")
    measured = signals(recording, car)
    (identified,) = drives([measured], "single_track")
    straight = slice(200, 2000)  # 20 s ahead of the lanes
    assert identified.inputs[straight, 0].std() < 0.1 * white_noise(measured.steering[straight])


@pytest.mark.exam
def test_noise_of_the_steering_angle_does_not_make_tyres_soft():
    """At 25 km/h most of a drive is straight: there the measured angle is noise, which the yaw rate does not follow, as
    if the tyres were soft. Taken as it was measured, it moved the stiffness by three standard deviations."""
    car = load_vehicle(vehicle_path("jaguar_saloon"))
    quiet_sensor = car.sensors["steering"].model_copy(update={"simulated_noise": 0.0})
    quiet = car.model_copy(update={"sensors": {**car.sensors, "steering": quiet_sensor}})
    of_both = []
    for sensed in (car, quiet):
        recording = record(drive(MANOEUVRES["lane_change_25"], car), sensed, 3, name="gentle")
        found = identify([recording], car, "single_track")
        of_both.append([cornering_stiffness(found.information, axle, found.start) for axle in ("front", "rear")])
    for (noisy, deviation), (known, _) in zip(*of_both, strict=True):
        assert abs(noisy - known) < deviation
