"""Signals of recordings, and what noise is in them."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.mismatch.evidence import Readings, Window
from vsense_ros.mismatch.signals import CUT_OFF, noise, signals
from vsense_ros.model.sensors import Imu

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
    found = noise(drive, drive.readings, SENSORS, 0.3)["yaw_rate"]
    clean = window_of(slalom(t), t)
    left = signals(drive, drive.readings, SENSORS, 0.3)["yaw_rate"]
    left = left - signals(clean, clean.readings, SENSORS, 0.3)["yaw_rate"]
    assert found == pytest.approx(left.std(), rel=0.15)
    assert found == pytest.approx(deviation * np.sqrt(2 * CUT_OFF * PERIOD), rel=0.05)


def test_a_signal_without_noise_has_next_to_none():
    t = np.arange(BEGIN - 1.0, END + 1.0, PERIOD)
    drive = window_of(slalom(t), t)
    assert noise(drive, drive.readings, SENSORS, 0.3)["yaw_rate"] < 1e-4
