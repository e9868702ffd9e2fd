"""Where a car is not meant to be, and gets to: in the air, on its stops, sideways, backwards, on locked wheels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from stepping import Stepper
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import model_functions
from vsense_ros.model.coordinates import TORQUES
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

G = 9.80665
STEP = 2e-3  # [s]


@pytest.fixture(scope="module", params=["tables", "straight guides"])
def car(request: pytest.FixtureRequest) -> Vehicle:
    """The prototype on suspension tables, and on straight guides."""
    prototype = load_vehicle(Path(__file__).parents[2] / "config/vehicles/prototype_real.yaml")
    assert prototype.suspension is not None
    return prototype if request.param == "tables" else prototype.model_copy(update={"suspension": None})


def rolling(vehicle: Vehicle, speed: float) -> Stepper:
    stepper = Stepper(vehicle)
    stepper.u[0] = speed
    stepper.u[10:] = speed / rolling_radii(vehicle)
    return stepper


def mass_matrix(vehicle: Vehicle, stepper: Stepper) -> np.ndarray:
    """Mass matrix of the derivatives of u, (14, 14)."""
    car = car_of(vehicle)
    force = model_functions(car)["force"]
    none = np.zeros(car.internal_state.numel())
    here = [stepper.q, stepper.inputs, stepper.disturbances, vehicle.parameter_vector(), none]
    columns = [np.asarray(force(*here, unit))[:, 0] for unit in np.eye(14)]
    return np.column_stack(columns)


def at_rest(stepper: Stepper, vehicle: Vehicle) -> None:
    """Asserts that the car stands in its design position, wherever it is."""
    assert np.abs(stepper.u).max() < 0.01
    assert_allclose(stepper.q[2], vehicle.physics.chassis.cog_height, atol=5e-4)
    assert_allclose(stepper.q[[3, 4, 6, 7, 8, 9]], 0, atol=2e-3)
    assert_allclose(stepper.wheels[2].sum(), vehicle.physics.chassis.mass * G, rtol=1e-3)


def test_a_standing_car_keeps_standing(car):
    stepper = Stepper(car)
    start = stepper.q.copy()
    stepper.run(4.0, STEP)
    assert_allclose(stepper.q, start, atol=1e-6)
    assert_allclose(stepper.wheels[:2], 0, atol=1e-3)


def test_in_the_air_no_tyre_has_a_force_and_the_car_falls_as_a_stone(car):
    still = car.with_parameters({"aerodynamics.drag_area": 0.0})
    stepper = Stepper(still)
    stepper.q[2] += 5.0
    stepper.q[3:5] = 0.3, -0.2
    assert not stepper.wheels[:4].any()
    # Springs push wheels and chassis apart: only what they cannot reach, the momentum of the whole, tells the fall.
    momentum = mass_matrix(still, stepper)[:3] @ stepper.acceleration
    assert_allclose(np.linalg.norm(momentum), still.physics.chassis.mass * G, rtol=1e-9)


def test_dropped_from_half_a_metre_it_goes_beyond_its_tables_bounces_and_comes_to_rest(car):
    stepper = Stepper(car)
    stepper.q[2] += 0.5
    stepper.q[3] = 0.05
    deepest, lifted = np.zeros(4), False

    def watch(stepper: Stepper) -> None:
        nonlocal lifted
        np.maximum(deepest, stepper.q[6:10], out=deepest)
        lifted |= bool(np.any(stepper.wheels[2] == 0))
        assert np.all(np.isfinite(stepper.u))

    stepper.run(6.0, STEP, watch)
    assert lifted
    assert deepest.max() > 0.065
    at_rest(stepper, car)


def test_a_car_on_two_wheels_falls_back_on_four(car):
    stepper = Stepper(car)
    stepper.q[3] = np.radians(25)
    stepper.q[2] += 0.26
    loads = stepper.wheels[2]
    assert np.all(loads[[0, 2]] == 0)
    stepper.run(8.0, STEP)
    at_rest(stepper, car)


def test_backwards_it_rolls_on_and_steers_the_other_way(car):
    stepper = rolling(car, -8.0)
    stepper.run(1.0, STEP)
    assert -8.0 < stepper.u[0] < -7.5
    assert abs(stepper.u[5]) < 1e-6
    stepper.inputs[0] = 0.05
    stepper.run(0.3, STEP)
    assert stepper.u[5] < -0.05


def test_wheels_that_spin_push_the_standing_car_with_what_grip_there_is(car):
    stepper = Stepper(car)
    stepper.inputs[3:] = 1500.0
    stepper.run(0.5, STEP)
    assert np.all(stepper.u[12:] * 0.27 > 3 * stepper.u[0])
    rear = stepper.wheels[:, 2:]
    assert np.all(rear[4] > car.physics.rear.tyre.longitudinal.double.slip_at_sliding)
    grip = np.hypot(rear[0], rear[1]) / rear[2]
    assert np.all((0.5 * car.physics.road.friction < grip) & (grip < 1.1 * car.physics.road.friction))
    assert stepper.u[0] > 1.0


def test_with_locked_wheels_it_slides_to_a_halt_and_stays(car):
    stepper = rolling(car, 15.0)

    def brake(stepper: Stepper) -> None:
        stepper.inputs[TORQUES] = -900.0 * np.tanh(stepper.u[10:] / 4)

    stepper.run(0.5, STEP, brake)
    assert np.all(np.abs(stepper.u[10:]) < 0.1 * stepper.u[0] / 0.27)
    deceleration = -(stepper.acceleration[0] + stepper.u[4] * stepper.u[2] - stepper.u[5] * stepper.u[1])
    assert 0.75 * car.physics.road.friction * G < deceleration < 1.05 * car.physics.road.friction * G
    stepper.run(4.5, STEP, brake)
    place = stepper.q[:2].copy()
    stepper.run(2.0, STEP, brake)
    assert_allclose(stepper.q[:2], place, atol=0.05)
    at_rest(stepper, car)


@pytest.mark.parametrize("step", [1e-2, 4e-3, 1e-3])
def test_on_locked_wheels_it_loses_the_speed_that_friction_takes_at_every_step_length(car, step):
    # Sliding forces in proportion to the load: whatever the loads, the road takes 0.9 times its friction times g.
    proportional = {
        f"{axle}.tyre.longitudinal.{load}.sliding": 1350.0 * ratio
        for axle in ("front", "rear")
        for load, ratio in (("nominal", 1), ("double", 2))
    }
    car = car.with_parameters(proportional | {"aerodynamics.drag_area": 0.0})
    stepper = rolling(car, 25.0)
    asked = 0.0

    def brake(stepper: Stepper) -> None:
        nonlocal asked
        stepper.inputs[TORQUES] = -1500.0 * np.tanh(stepper.u[10:])
        asked += stepper.acceleration[0] * step

    stepper.run(1.0, step, brake)
    assert stepper.u[0] - 25.0 == pytest.approx(asked, rel=0.02)  # while the wheels lock
    before, asked = stepper.u[0], 0.0
    stepper.run(1.0, step, brake)
    assert np.all(np.abs(stepper.u[10:]) < 0.03 * stepper.u[0] / 0.27)
    assert stepper.u[0] - before == pytest.approx(asked, rel=0.005)
    assert stepper.u[0] - before == pytest.approx(-0.9 * car.physics.road.friction * G, rel=0.01)


def test_long_steps_stop_it_on_locked_wheels_where_short_ones_do(car):
    def stopped(step: float) -> float:
        def brake(stepper: Stepper) -> None:
            stepper.inputs[TORQUES] = -1500.0 * np.tanh(stepper.u[10:] / 20)

        stepper = rolling(car, 8.0).run(3.0, step, brake)
        at_rest(stepper, car)
        return float(stepper.q[0])

    assert stopped(1e-2) == pytest.approx(stopped(1e-3), rel=0.04)


def test_a_car_that_turns_round_while_it_slides_comes_to_rest(car):
    stepper = rolling(car, 15.0)
    stepper.u[1], stepper.u[5] = 6.0, 4.0

    def brake(stepper: Stepper) -> None:
        stepper.inputs[TORQUES] = -300.0 * np.tanh(stepper.u[10:] / 2)

    stepper.run(10.0, STEP, brake)
    assert abs(stepper.q[5]) > np.pi / 2
    at_rest(stepper, car)


def test_the_wheels_stay_at_the_end_of_the_rack_when_more_is_asked_for(car):
    end = 0.7 if car.suspension is None else car.suspension.steering  # straight guides have no rack that ends
    rates = []
    for angle in (0.9 * end, end, 1.1 * end, 1.5 * end):
        stepper = rolling(car, 10.0)
        stepper.inputs[0] = angle
        rates.append(stepper.acceleration)
    assert np.all(np.isfinite(rates))
    assert not np.allclose(rates[0], rates[1])
    for beyond in rates[2:]:
        assert np.allclose(beyond, rates[1]) == (car.suspension is not None)
