"""How sure the mounting of the inertial sensor is, where a gyro across reads a share of every turn."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_inertial import inertial
from vsense_ros.prepare.calibrated import Calibrated
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle

PITCH = 0.03  # [rad] of the mounting, nose down


def catalogue_car() -> Vehicle:
    return new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle


def pitch_of_mounting(cross_axis: float, grade: float, seed: int, seconds: float = 120.0) -> Calibrated:
    """Pitch of a sensor whose roll gyro reads a share of the yaw rate, on bends of a road with a mean grade."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, CALIBRATION.step)
    rate = 0.2 * np.sin(0.4 * t) + 0.1 * np.sin(0.13 * t)
    speed = 13.0 + 4.0 * np.sin(0.07 * t)
    pace = np.gradient(speed, CALIBRATION.step)
    noise = rng.normal(0, [[0.003], [0.003], [0.003], [0.1], [0.1], [0.1]], (6, len(t)))
    roll_gyro = -PITCH * rate + cross_axis * rate
    forward = pace - GRAVITY * (PITCH - grade)
    rates = np.column_stack([roll_gyro, 0 * rate, rate]) + noise[:3].T
    forces = np.column_stack([forward, speed * rate, np.full(len(t), GRAVITY)]) + noise[3:].T
    course = np.cumsum(rate) * CALIBRATION.step
    drive = CalibrationDrive(
        "bends", t, rates, forces, speed[:, None] * np.column_stack([np.cos(course), np.sin(course)]),
        np.full((len(t), 4), np.nan), np.full(len(t), np.nan), {},
    )  # fmt: skip
    found = inertial([drive], catalogue_car())
    return next(one for one in found if one.name.startswith("pitch"))


def test_the_error_of_the_pitch_is_as_large_as_its_deviation_says_over_many_sensors_and_roads() -> None:
    rng = np.random.default_rng(5)
    relative = []
    for seed in range(40):
        one = pitch_of_mounting(rng.uniform(-0.02, 0.02), rng.normal(0, 0.015), seed)
        relative.append((one.after - PITCH) / one.deviation)
    assert np.mean(np.abs(relative) < 2) >= 0.9
    assert 0.4 < np.std(relative) < 1.3


def test_a_shorter_drive_says_less_of_the_pitch_because_its_mean_grade_is_less_known() -> None:
    long, short = (pitch_of_mounting(0.0, 0.0, 1, seconds) for seconds in (600.0, 40.0))
    assert long.deviation < short.deviation
    assert long.after == pytest.approx(PITCH, abs=2 * long.deviation)
