"""A velocity in the axes of the car: what it measures, and what it is good for."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.checks.inspect import inspect
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import BodyVelocity, known_topics
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import run

AHEAD, YAW = 0.5, 0.1  # [m, rad] of its mounting


def with_it(name: str) -> Vehicle:
    car = load_vehicle(vehicle_path(name))
    sensor = BodyVelocity(position=(AHEAD, 0.0, -0.2), yaw=YAW)
    return car.model_copy(update={"sensors": {**car.sensors, "optical": sensor}})


@pytest.fixture(scope="module")
def drive() -> Recording:
    return generate("double_lane_change", with_it("prototype_real"), 1)


def test_it_measures_the_velocity_of_its_place_in_its_own_axes(drive: Recording) -> None:
    channel, truth = drive["vehicle/velocity"], drive["reference/odometry"]

    def at(field: str, column: int) -> np.ndarray:
        return np.interp(channel.stamp, truth.stamp, truth.columns[field][:, column])

    forward, left = at("linear", 0), at("linear", 1) + AHEAD * at("angular", 2)
    turned = np.column_stack([np.cos(YAW) * forward + np.sin(YAW) * left, np.cos(YAW) * left - np.sin(YAW) * forward])
    error = channel.columns["linear"][:, :2] - turned
    np.testing.assert_allclose(np.std(error, axis=0), 0.05, rtol=0.1)
    assert np.abs(np.mean(error, axis=0)).max() < 0.01
    assert inspect(drive, known_topics()).problems == ()


@pytest.mark.slow
def test_the_observer_knows_the_lateral_velocity_better_with_it(drive: Recording) -> None:
    truth = drive["reference/odometry"]

    def error(car: Vehicle) -> float:
        found = run(drive, car).output["vsense/odometry"]
        lateral = np.interp(found.stamp, truth.stamp, truth.columns["linear"][:, 1])
        return float(np.sqrt(np.mean((found.columns["linear"][:, 1] - lateral) ** 2)))

    assert error(with_it("prototype_model")) < 0.5 * error(load_vehicle(vehicle_path("prototype_model")))
