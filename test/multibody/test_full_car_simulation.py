"""The full car as a plant: the same inputs and coordinates as the simplified car, and the same motion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vsense_ros.errors import InputError
from vsense_ros.model.coordinates import FORCE_Z, GRADE, GRADE_CHANGE, INPUTS, ROAD_HEIGHT, SPEED_X, X, Y
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.simulation.full_car import FullCarPlant, simulate_full_car
from vsense_ros.model.simulation.surface import Waves
from vsense_ros.model.vehicle import Vehicle

Array = np.ndarray


def bend(t: float, q: Array, u: Array) -> Array:
    """Straight on, then slowly into a gentle bend, with a little thrust at the rear."""
    return np.array([0.02 * min(max(t - 0.2, 0.0) / 0.5, 1.0), 0.0, 0.0, 25.0, 25.0])


@pytest.fixture(scope="module")
def both(vehicle: Vehicle) -> tuple[Trajectory, Trajectory]:
    """The bend at 14 m/s with the full and with the simplified car."""
    q, u = rolling_straight(vehicle, 14.0)
    full = simulate_full_car(vehicle, bend, 3.0, step=0.004, q=q, u=u)
    simple = simulate(vehicle, bend, 3.0, step=0.001, keep_every=4, q=q, u=u)
    return full, simple


def test_in_a_gentle_bend_full_and_simplified_car_agree_to_a_thousandth(both: tuple[Trajectory, Trajectory]):
    """The simplified one runs on suspension tables made from the linkages of the full one."""
    full, simple = both
    assert_allclose(full.t, simple.t)
    assert simple.u[-1, 5] > 0.1
    assert_allclose(full.u[-1, 0], simple.u[-1, 0], rtol=1e-4)
    assert_allclose(full.u[-1, 5], simple.u[-1, 5], rtol=1e-3)
    assert_allclose(full.acceleration[-1, 1], simple.acceleration[-1, 1], rtol=1e-3)
    assert_allclose(full.q[-1, 3], simple.q[-1, 3], rtol=5e-3)
    assert_allclose(full.wheels[-1, 2], simple.wheels[-1, 2], rtol=1e-3)
    assert_allclose(full.wheels[-1, 6], simple.wheels[-1, 6], atol=1e-4)


def test_velocities_and_accelerations_are_derivatives(both: tuple[Trajectory, Trajectory]):
    full, _ = both
    h = full.t[1]
    smooth = slice(400, None)
    change = (full.u[2:] - full.u[:-2]) / (2 * h)
    assert_allclose(change[smooth], full.udot[1:-1][smooth], atol=2e-2 * np.abs(full.udot[1:-1]).max(axis=0).max())
    coordinates = (full.q[2:, 6:] - full.q[:-2, 6:]) / (2 * h)
    assert_allclose(coordinates[smooth], full.u[1:-1, 6:][smooth], atol=2e-3)


def test_it_starts_in_the_state_that_it_is_given(vehicle: Vehicle):
    q, u = rolling_straight(vehicle, 9.0)
    q[:6] = 3.0, -2.0, 0.41, 0.02, -0.01, 0.7
    q[6:10] = 0.01, -0.02, 0.005, 0.015
    u[1:10] = 0.2, 0.05, 0.1, -0.2, 0.3, 0.1, -0.15, 0.2, 0.05
    plant = FullCarPlant(vehicle, 0.004)
    plant.place(q, u, np.zeros(len(INPUTS)))
    assert_allclose(plant.q, q, atol=1e-9)
    assert_allclose(plant.u, u, atol=1e-9)


def test_a_correction_moves_it_to_the_state_asked_for(vehicle: Vehicle):
    q, u = rolling_straight(vehicle, 12.0)
    plant = FullCarPlant(vehicle, 0.004)
    plant.place(q, u, np.zeros(len(INPUTS)))
    for i in range(50):
        plant.step(np.array([0.001 * i, 0.0, 0.0, 50.0, 50.0]))
    random = np.random.default_rng(3)
    wanted_q, wanted_u = plant.q + 1e-3 * random.normal(size=14), plant.u + 1e-2 * random.normal(size=14)
    plant.correct(wanted_q, wanted_u)
    assert_allclose(plant.q, wanted_q, atol=1e-9)
    assert_allclose(plant.u, wanted_u, atol=1e-9)
    _, _, *constraints, _ = plant.integrator.dynamics()
    assert max(np.abs(c).max() for c in constraints) < 1e-8

    before = plant.q.copy()
    wanted_q[6] = 0.5
    with pytest.raises(InputError, match=r"cannot be put to travels \[500\.0, .* mm from where it is"):
        plant.correct(wanted_q, wanted_u)
    plant.step(np.array([0.05, 0.0, 0.0, 50.0, 50.0]))
    assert_allclose(plant.q[:6], before[:6], atol=0.1)


def test_a_jump_of_the_steering_that_no_linkage_can_follow_is_refused(vehicle: Vehicle):
    q, u = rolling_straight(vehicle, 12.0)
    plant = FullCarPlant(vehicle, 0.004)
    plant.place(q, u, np.array([0.3, 0, 0, 0, 0]))
    with pytest.raises(InputError, match=r"a step of 0\.004 s does not converge"):
        plant.step(np.array([-0.3, 0, 0, 0, 0]))
    assert np.all(np.isfinite(plant.q))


@pytest.mark.exam
def test_uphill_it_slows_as_gravity_says(vehicle: Vehicle):
    q, u = rolling_straight(vehicle, 10.0)
    grade = np.array([0.05, *[0.0] * 6])
    level, uphill = (
        simulate_full_car(vehicle, lambda t, q, u: np.zeros(5), 0.8, step=0.004, q=q, u=u, disturbances=around)
        for around in (None, grade)
    )
    # Wheels turn slower too: their inertia adds to the mass.
    front, rear = vehicle.physics.front, vehicle.physics.rear
    turning = 2 * (front.wheel_spin_inertia + rear.wheel_spin_inertia) / 0.268**2
    share = vehicle.physics.chassis.mass / (vehicle.physics.chassis.mass + turning)
    assert_allclose(uphill.u[-1, 0] - level.u[-1, 0], -9.80665 * np.sin(0.05) * 0.8 * share, rtol=0.02)


def test_steering_beyond_the_rack_is_refused(vehicle: Vehicle):
    with pytest.raises(InputError, match="more than the rack's"):
        simulate_full_car(vehicle, lambda t, q, u: np.array([0.6 * t, 0, 0, 0, 0]), 1.0, step=0.004)


def test_an_unsteered_car_is_refused(vehicle: Vehicle):
    assert vehicle.linkage is not None
    front = vehicle.linkage.front.model_copy(update={"steered": False})
    fixed = vehicle.model_copy(update={"linkage": vehicle.linkage.model_copy(update={"front": front})})
    with pytest.raises(InputError, match="cannot be steered: set `steered: true`"):
        FullCarPlant(fixed, 0.004)


@pytest.mark.exam
def test_over_hills_its_wheels_carry_what_gravity_and_the_bend_of_the_road_ask_of_them(vehicle: Vehicle):
    """On long waves the body follows the road: the loads add up to m (g cos slope + v² curvature)."""
    hills = Waves(((1.5, 0.0, 200.0),))
    q, u = rolling_straight(vehicle, 15.0)
    found = simulate_full_car(
        vehicle, lambda t, q, u: np.zeros(5), 8.0, step=0.002, keep_every=10, q=q, u=u, surface=hills
    )
    rows = slice(50, None)
    assert found.disturbances is not None
    grade, bend = found.disturbances[rows, GRADE], found.disturbances[rows, GRADE_CHANGE]
    speed = found.u[rows, SPEED_X]
    expected = vehicle.physics.chassis.mass * (9.80665 * np.cos(grade) + speed**2 * bend)
    error = found.wheels[rows, FORCE_Z].sum(axis=1) - expected
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.std(expected) + 1.0
    # The road below it is the surface where it is.
    heights = [hills.under(x, y, 0.0)[4] for x, y in found.q[rows][:, [X, Y]]]
    np.testing.assert_allclose(found.disturbances[rows, ROAD_HEIGHT], heights, atol=0.02)
