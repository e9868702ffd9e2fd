"""The course of GNSS separates the scale of a gyro from its latency, and what changes from what stays."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_course import course, rear_compliance
from vsense_ros.prepare.calibrated import Calibrated
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle


def catalogue_car() -> Vehicle:
    return new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle


def by_course(car: Vehicle, scale: float = 0.0, late: float = 0.0, bias: float = 0.0) -> dict[str, Calibrated]:
    """What the course says of a gyro on bends at many speeds, of a car that is as its file says."""
    t = np.arange(0.0, 300.0, CALIBRATION.step)
    rate = 0.25 * np.sin(0.3 * t) + 0.1 * np.sin(0.11 * t)
    speed = 11.0 + 5.0 * np.sin(0.05 * t)
    arm, slip = car.physics.chassis.cog_to_rear_axle, rear_compliance(car)
    heading = np.cumsum(rate) * CALIBRATION.step
    direction = heading + arm * rate / speed - slip * speed * rate
    read = np.interp(t - late, t, rate) * (1 + scale) + bias
    rng = np.random.default_rng(4)
    velocity = speed[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    drive = CalibrationDrive(
        "bends", t, np.column_stack([0 * t, 0 * t, read]), np.full((len(t), 3), np.nan),
        velocity + rng.normal(0, 0.03, velocity.shape), np.full((len(t), 4), np.nan), np.full(len(t), np.nan), {},
    )  # fmt: skip
    return {one.name: one for one in course([drive], car)}


@pytest.mark.parametrize("scale", [-0.012, 0.008])
def test_an_error_of_the_scale_is_found_and_no_latency_is_made_of_it(scale: float) -> None:
    found = by_course(catalogue_car(), scale=scale, bias=0.004)
    yaw_rate = found["error of the yaw rate's scale"]
    assert yaw_rate.determined
    assert yaw_rate.after == pytest.approx(scale, abs=max(3 * yaw_rate.deviation, 0.002))
    assert found["bias of the yaw rate"].after == pytest.approx(0.004, abs=5e-4)
    latency = next(one for name, one in found.items() if name.startswith("latency"))
    assert not latency.is_changed


def test_a_late_gyro_is_found_as_late_and_no_scale_is_made_of_it() -> None:
    found = by_course(catalogue_car(), late=0.08)
    latency = found["latency of the bus (inertial sensor, steering, wheels)"]
    assert latency.is_changed
    assert latency.after == pytest.approx(0.08, abs=3 * latency.deviation)
    assert found["error of the yaw rate's scale"].after == pytest.approx(0.0, abs=0.002)
