"""What sensors cannot determine is absent from what is published, and it is said what would determine it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.estimates import UNESTIMATED_VARIANCE
from vsense_ros.messages.recording import Recording
from vsense_ros.model.schema.drivetrain import Drivetrain
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import run


def without(vehicle: Vehicle, *names: str, driven: str | None = None) -> Vehicle:
    """The vehicle without some sensors."""
    sensors = {name: sensor for name, sensor in vehicle.sensors.items() if name not in names}
    return vehicle.model_copy(update={"sensors": sensors, "drivetrain": Drivetrain.model_validate({"driven": driven})})


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_model"))


@pytest.fixture(scope="module")
def drive() -> Recording:
    """Four seconds of a step of the steering."""
    return import_recording(Path(__file__).parents[2] / "bags" / "step_steer").between(None, 4.0)


def published(vehicle: Vehicle, drive: Recording) -> tuple[Recording, str]:
    """Estimates of a drive, and what is said about observability."""
    result = run(drive, vehicle)
    return result.output, " ".join(line.message for line in result.diagnostics if line.name == "observability")


def test_without_wheel_speeds_longitudinal_forces_are_absent_and_the_rest_is_there(
    car: Vehicle, drive: Recording
) -> None:
    output, words = published(without(car, "wheel_speeds", "wheel_torques"), drive)
    force = output["vsense/wheel_force/fl"].columns["force"]
    assert np.isnan(force[:, 0]).all()
    assert np.isfinite(force[:, 1:]).all()
    assert np.isnan(output["vsense/wheel_slip/rr"].columns["vector"][:, 0]).all()
    signals = read_signals(output, "vsense")
    assert "wheel_force_fl_x" not in signals
    assert "wheel_force_fl_y" in signals
    assert "need wheel speeds" in words


def test_a_car_that_says_what_is_driven_has_longitudinal_forces_without_wheel_speeds(
    car: Vehicle, drive: Recording
) -> None:
    output, words = published(without(car, "wheel_speeds", "wheel_torques", driven="rear"), drive)
    assert np.isfinite(output["vsense/wheel_force/rl"].columns["force"]).all()
    assert "wheel speeds" not in words


def test_without_a_measured_height_that_of_the_road_is_absent(car: Vehicle, drive: Recording) -> None:
    output, words = published(car, drive)
    odometry = output["vsense/odometry"]
    assert np.isnan(odometry.columns["position"][:, 2]).all()
    assert np.isfinite(odometry.columns["position"][:, :2]).all()
    assert (odometry.columns["pose_covariance"][:, 14] == UNESTIMATED_VARIANCE).all()
    assert "position" in read_signals(output, "vsense")
    assert "gnss_height" in words


def test_a_car_that_lays_its_own_map_has_a_height(car: Vehicle, drive: Recording) -> None:
    output, words = published(without(car, "position", "velocity"), drive)
    assert np.isfinite(output["vsense/odometry"].columns["position"]).all()
    assert not words
