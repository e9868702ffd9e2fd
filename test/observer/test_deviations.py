"""Standard deviations of accelerations and tyre forces are as large as their errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drives import feed, messages
from vsense_ros.evaluate.consistency import errors_of
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.topics import WHEELS
from vsense_ros.model.coordinates import RATES, VELOCITY
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.state import FORCE, TWIST
from vsense_ros.runner import Runner, run

FORCES = tuple(f"wheel_force_{wheel}_{axis}" for wheel in WHEELS for axis in "xyz")
ACCELERATIONS = tuple(f"{axis}_acceleration" for axis in ("longitudinal", "lateral", "vertical"))


@pytest.mark.exam
@pytest.mark.parametrize(("manoeuvre", "load"), [("double_lane_change", 60.0), ("steady_state_circle", -100.0)])
def test_errors_on_a_car_that_is_loaded_and_on_a_road_that_grips_less_are_as_large_as_told(
    plant: Vehicle, vehicle: Vehicle, manoeuvre: str, load: float
) -> None:
    """The observer takes the car for one of 700 kg on a friction of 1.0; that of the road is 0.8."""
    mass = vehicle.physics.chassis.mass + load
    drive = generate(manoeuvre, plant.with_parameters({"chassis.mass": mass}), seed=3)
    found = errors_of(run(drive, vehicle).output, drive)
    assert {*FORCES, *ACCELERATIONS} <= set(found)
    for name in (*FORCES, *ACCELERATIONS):
        assert found[name].inside > 0.9, name
        assert found[name].nees < 2.0, name
    together = np.mean([found[name].nees for name in FORCES])
    assert 0.3 < together < 1.5


def test_the_covariance_of_the_acceleration_is_that_of_its_first_order(clean: Runner) -> None:
    """By differences of the model's accelerations: of a state that is drawn from the filter's belief."""
    car, covariance = clean.filter.car, clean.filter.belief().covariance
    told = clean.snapshot().acceleration_covariance

    def accelerations() -> np.ndarray:
        udot, u = car.present()[0], car.mean[TWIST]
        velocity, rates = u[VELOCITY], u[RATES]
        return np.concatenate([udot[VELOCITY] + np.cross(rates, velocity), udot[RATES]])

    by_error = differences(car, accelerations)
    np.testing.assert_allclose(told, by_error @ covariance @ by_error.T, rtol=0.02, atol=2e-4)


def test_the_deviations_of_tyre_forces_are_those_of_their_first_order(clean: Runner, vehicle: Vehicle) -> None:
    """Likewise, and what the car may weigh beyond its file."""
    car, covariance = clean.filter.car, clean.filter.belief().covariance
    estimate = clean.snapshot()
    by_error = differences(car, lambda: clean.snapshot().wheels[:4].T.ravel().copy())
    variance = np.sum((by_error @ covariance) * by_error, axis=1).reshape(4, 4).T
    share = vehicle.observer.surroundings.load / vehicle.physics.chassis.mass
    expected = np.sqrt(variance + (share * estimate.wheels[:4]) ** 2)
    np.testing.assert_allclose(estimate.wheel_deviations, expected, rtol=0.02, atol=0.1)


def differences(car: Any, outcome: Any) -> np.ndarray:
    """Derivative of an outcome by the errors of the car's state, by central differences; errors of accelerations act
    through the mass matrix, on the tyres by what is lacking along y and about z."""
    n, before = car.layout.size, car.mean.copy()
    columns = []
    for i in range(n):
        step = 1e-6
        each = []
        for sign in (1.0, -1.0):
            car.mean[:] = before
            if FORCE.start <= i < FORCE.stop:
                car.error[:] = 0.0
                car.error[i] = sign * step
                car.forces.call()
                car.mean[FORCE] += car.forces.results[0][:, 0]
            else:
                car.mean[i] += sign * step
            each.append(outcome())
        columns.append((each[0] - each[1]) / (2 * step))
    car.mean[:] = before
    return np.array(columns).T


def test_a_car_with_a_known_load_has_surer_vertical_forces(vehicle: Vehicle, lane_change: Any) -> None:
    around = vehicle.observer.surroundings.model_copy(update={"load": 0.0})
    settings = vehicle.observer.model_copy(update={"surroundings": around})
    known = feed(Runner(vehicle.model_copy(update={"observer": settings})), messages(lane_change, 3.0)).snapshot()
    unknown = feed(Runner(vehicle), messages(lane_change, 3.0)).snapshot()
    assert np.all(known.wheel_deviations[2] < 0.5 * unknown.wheel_deviations[2])
    np.testing.assert_allclose(known.wheels, unknown.wheels)
