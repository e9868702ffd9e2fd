"""Signals of recordings, and what noise is in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import detrend
from scipy.spatial.transform import Rotation

from vsense_ros.mismatch.signals import SIGNALS, difference, grid, noise, signals
from vsense_ros.mismatch.windows import Readings, Window
from vsense_ros.model.sensors import GnssVelocity, Imu

BEGIN, END, PERIOD = 0.0, 200.0, 0.01
SENSORS = {"imu": Imu()}


def window_of(yaw_rate: np.ndarray, t: np.ndarray) -> Window:
    value = np.zeros((len(t), 6))
    value[:, 2] = yaw_rate
    speed, straight = Readings(t, np.full((len(t), 1), 20.0)), Readings(t, np.zeros((len(t), 1)))
    return Window(0, "drive", BEGIN, END, {"imu": Readings(t, value)}, speed, 0.0, False, straight, straight)


def slalom(t: np.ndarray) -> np.ndarray:
    """Yaw rate of quick steering [rad/s]."""
    return 0.4 * np.sin(2 * np.pi * 1.0 * t)


@pytest.mark.parametrize("deviation", [0.001, 0.02])
def test_the_noise_of_a_signal_is_what_the_filter_leaves_of_it_whatever_the_car_does(deviation):
    t = np.arange(BEGIN - 1.0, END + 1.0, PERIOD)
    errors = deviation * np.random.default_rng(1).standard_normal(len(t))
    drive = window_of(slalom(t) + errors, t)
    found = noise([(drive, drive.readings, SENSORS, 0.3)])["yaw_rate"]
    clean = window_of(slalom(t), t)
    left = signals(drive, drive.readings, SENSORS, 0.3)["yaw_rate"]
    left = left - signals(clean, clean.readings, SENSORS, 0.3)["yaw_rate"]
    assert found == pytest.approx(left.std(), rel=0.15)
    assert found == pytest.approx(deviation * np.sqrt(2 * SIGNALS.cut_off * PERIOD), rel=0.05)


def test_a_signal_without_noise_has_next_to_none():
    t = np.arange(BEGIN - 1.0, END + 1.0, PERIOD)
    drive = window_of(slalom(t), t)
    assert noise([(drive, drive.readings, SENSORS, 0.3)])["yaw_rate"] < 1e-4


def test_windows_that_are_too_short_to_know_their_noise_know_it_together():
    deviation, t = 0.01, np.arange(BEGIN - 1.0, END + 1.0, 0.1)
    drive = window_of(slalom(t / 10) + deviation * np.random.default_rng(5).standard_normal(len(t)), t)
    parts = [drive.part(b, b + 1.9, run_in=0.5, yaw_rate=0.0, lateral_velocity=0.0) for b in np.arange(5.0, 190.0, 5.0)]
    apart = [(part, part.readings, SENSORS, 0.3) for part in parts]
    assert noise(apart)["yaw_rate"] == pytest.approx(deviation, rel=0.2)
    assert "yaw_rate" not in noise(apart[:1])


@pytest.mark.parametrize(("step", "held"), [(0.02, 1), (0.02, 5), (0.0, 5)], ids=["coarse", "coarse, held", "held"])
def test_values_in_steps_and_held_values_have_the_noise_of_what_was_sampled(step, held):
    t = np.arange(BEGIN - 1.0, END + 1.0, PERIOD)
    deviation = 0.002
    exact = slalom(t / 50)  # slow beside the samples, as a steered curve is
    read = exact + deviation * np.random.default_rng(3).standard_normal(len(t))
    read = np.repeat(read[::held], held)[: len(t)]
    read = np.round(read / step) * step if step else read
    drive = window_of(read, t)
    expected = float(np.hypot(deviation, step / np.sqrt(12)) * np.sqrt(2 * SIGNALS.cut_off * PERIOD * held))
    assert noise([(drive, drive.readings, SENSORS, 0.3)])["yaw_rate"] == pytest.approx(expected, rel=0.6)


def test_side_slip_is_the_course_less_the_heading_up_to_what_drifts():
    t = np.arange(BEGIN - 1.0, 20.0 + 1.0, PERIOD)
    rate, slip = slalom(t), 0.02 * np.sin(2 * np.pi * 0.5 * t)
    heading = np.cumsum(rate) * PERIOD
    imu = np.zeros((len(t), 6))
    imu[:, 2] = rate + 0.001  # a bias, which detrending takes off
    course = heading + slip
    velocity = np.column_stack([20.0 * np.cos(course), 20.0 * np.sin(course), np.zeros(len(t))])[::10]
    straight = Readings(t, np.zeros((len(t), 1)))
    readings = {"imu": Readings(t, imu), "velocity": Readings(t[::10], velocity)}
    drive = Window(
        0, "drive", BEGIN, 20.0, readings, Readings(t, straight.value + 20.0), 0.0, False, straight, straight
    )
    sensors = {"imu": Imu(), "velocity": GnssVelocity()}
    measured = signals(drive, readings, sensors, 0.3)
    at_rest = {"side_slip": np.zeros(len(measured["side_slip"]))}
    found = difference(measured, at_rest)["side_slip"]
    expected = detrend(np.interp(grid(drive), t, slip))
    assert np.abs(found - expected).max() < 0.003
    assert "side_slip" not in signals(drive, {"velocity": readings["velocity"]}, sensors, 0.3)


@pytest.mark.parametrize("attitude", [(np.pi, 0.0, 0.0), (0.0, 0.0, np.pi / 2), (0.02, -0.3, 1.0)])
def test_signals_are_the_cars_however_the_inertial_sensor_is_mounted(attitude):
    t = np.arange(BEGIN - 1.0, 20.0 + 1.0, PERIOD)
    of_car = np.random.default_rng(2).standard_normal((len(t), 6))
    of_car[:, 5] += 9.81
    to_car = Rotation.from_euler("xyz", attitude)
    as_mounted = np.hstack([to_car.inv().apply(of_car[:, :3]), to_car.inv().apply(of_car[:, 3:])])
    usual, turned = replace(window_of(t, t), end=20.0), Imu(attitude=attitude)
    expected = signals(usual, {"imu": Readings(t, of_car)}, SENSORS, 0.3)
    found = signals(usual, {"imu": Readings(t, turned.in_axes_of_car(as_mounted))}, {"imu": turned}, 0.3)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name] == pytest.approx(values, abs=1e-9), name


def test_what_a_turned_sensor_does_not_measure_is_absent_in_the_axes_of_the_car():
    t = np.arange(BEGIN - 1.0, 20.0 + 1.0, PERIOD)
    value = np.random.default_rng(2).standard_normal((len(t), 6))
    value[:, [0, 1]] = np.nan  # a yaw rate and three accelerometers
    usual, turned = replace(window_of(t, t), end=20.0), Imu(attitude=(0.02, -0.3, np.pi / 2))
    found = signals(usual, {"imu": Readings(t, turned.in_axes_of_car(value))}, {"imu": turned}, 0.3)
    names = {"yaw_rate", "longitudinal_acceleration", "lateral_acceleration", "vertical_acceleration"}
    assert found.keys() == names
    assert all(np.isfinite(values).all() for values in found.values())
