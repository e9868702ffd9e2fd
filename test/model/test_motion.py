"""What mechanics says of any car: energy, momentum, rest, and who carries how much of the weight."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pinocchio_car import PIN_ORDER, G, Twin, pin
from stepping import Stepper
from vsense_ros.model.coordinates import TORQUES
from vsense_ros.model.vehicle import Vehicle

LOSSLESS = {
    **{f"{axle}.{name}": 0.0 for axle in ("front", "rear") for name in ("suspension_damping", "rolling_resistance")},
    **{f"{axle}.tyre_damping": 0.0 for axle in ("front", "rear")},
    "aerodynamics.drag_area": 0.0,
    "road.friction": 1e-12,
}


@pytest.fixture(scope="module")
def lossless(vehicle: Vehicle) -> Vehicle:
    """No dampers, no drag, and a road without friction."""
    return vehicle.with_parameters(LOSSLESS)


def thrown() -> tuple[np.ndarray, np.ndarray]:
    """High up, turning about all axes, with oscillating suspension and spinning wheels."""
    q = np.array([1.0, 2.0, 50.0, 0.3, -0.2, 0.7, 0.02, -0.03, 0.01, 0.04, 0, 0, 0, 0])
    u = np.array([15.0, -3.0, 4.0, 1.5, -0.4, 1.0, 0.5, -0.4, 0.3, -0.2, 60.0, 40.0, 50.0, -30.0])
    return q, u


def energy(vehicle: Vehicle, q: np.ndarray, u: np.ndarray) -> float:
    """Kinetic, gravitational and elastic energy [J], without use of the model."""
    twin = Twin.of(vehicle, 0.0)
    coordinates = twin.coordinates(q)
    total = pin.computeKineticEnergy(twin.model, twin.data, coordinates, u[PIN_ORDER])
    twin.model.gravity = pin.Motion(np.array([0, 0, -G]), np.zeros(3))
    total += pin.computePotentialEnergy(twin.model, twin.data, coordinates)
    pin.forwardKinematics(twin.model, twin.data, coordinates)
    for i, axle in enumerate(twin.axles):
        unsprung = (axle.hub_mass + axle.wheel_mass) * G
        total += (twin.static_loads[i] - unsprung) * twin.guides[i][2] * q[6 + i]
        total += axle.suspension_stiffness * q[6 + i] ** 2 / 2
        wheel = twin.data.oMi[3 + 2 * i]
        inclination = np.arcsin(wheel.rotation[2, 1])
        loaded = wheel.translation[2] / np.cos(inclination)
        total += axle.tyre_stiffness * max(axle.unloaded_radius - loaded, 0) ** 2 / 2
    for left, axle in ((0, twin.axles[0]), (2, twin.axles[2])):
        total += axle.antiroll_stiffness * (q[6 + left] - q[7 + left]) ** 2 / 2
    return float(total)


def momentum(vehicle: Vehicle, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Linear momentum, and angular momentum about the common centre of gravity, in the map."""
    twin = Twin.of(vehicle, 0.0)
    return pin.computeCentroidalMomentum(twin.model, twin.data, twin.coordinates(q), u[PIN_ORDER]).vector


def test_energy_in_free_flight_is_kept_to_second_order_of_the_step(lossless):
    start = energy(lossless, *thrown())
    drift = []
    for h in (4e-3, 2e-3, 1e-3):
        end = Stepper(lossless, *thrown()).run(0.4, h)
        drift.append(abs(energy(lossless, end.q, end.u) - start))
    assert drift[-1] < 1e-5 * start
    assert drift[0] / drift[1] > 3.6
    assert drift[1] / drift[2] > 3.6


def test_a_car_that_bounces_on_ice_keeps_its_energy(lossless):
    q = np.zeros(14)
    q[:6] = 0, 0, lossless.physics.chassis.cog_height - 0.01, 0.002, 0.003, 0.4
    start = energy(lossless, q, np.zeros(14))
    least = energy(lossless, np.array([0, 0, lossless.physics.chassis.cog_height, *[0] * 11]), np.zeros(14))
    drift = []
    for h in (1e-3, 5e-4):
        end = Stepper(lossless, q).run(0.5, h)
        assert end.wheels[2].min() > 500  # no wheel leaves the ice
        drift.append(abs(energy(lossless, end.q, end.u) - start) / (start - least))
    assert drift[1] < 5e-3
    assert drift[0] / drift[1] > 3.6


def test_momentum_in_free_flight_changes_by_the_weight_alone(lossless):
    q, u = thrown()
    before = momentum(lossless, q, u)
    weight = np.array([0, 0, -lossless.physics.chassis.mass * G * 0.4, 0, 0, 0])
    errors = []
    for h in (2e-3, 1e-3):
        end = Stepper(lossless, q, u).run(0.4, h)
        errors.append(np.abs(momentum(lossless, end.q, end.u) - before - weight))
    assert errors[1][:3].max() < 1e-5 * np.linalg.norm(before[:3])
    assert errors[1][3:].max() < 1e-4 * np.linalg.norm(before[3:])
    assert errors[0].max() / errors[1].max() > 3.6


@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_a_car_that_stands_keeps_standing(vehicle, h):
    stand = Stepper(vehicle)
    start = stand.q.copy()
    stand.run(10.0 if h == 1e-2 else 2.0, h)
    assert np.abs(stand.q - start).max() < 1e-6
    assert np.abs(stand.u).max() < 1e-6
    assert np.abs(stand.acceleration).max() < 1e-6


def test_a_pushed_car_comes_to_rest_at_its_design_height(vehicle):
    random = np.random.default_rng(3)
    u = random.normal(size=14) * np.array([0.2] * 3 + [0.1] * 3 + [0.05] * 4 + [0.5] * 4)
    car = Stepper(vehicle, u=u).run(60.0, 1e-2)
    assert np.abs(car.u).max() < 1e-6
    assert np.abs(car.acceleration).max() < 1e-6
    assert_allclose(car.q[2], vehicle.physics.chassis.cog_height, atol=1e-6)
    assert_allclose(car.q[[3, 4, 6, 7, 8, 9]], 0, atol=1e-6)


def test_wheel_loads_at_rest_follow_from_the_centre_of_gravity(vehicle):
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    front = chassis.mass * G * chassis.cog_to_rear_axle / wheelbase / 2
    rear = chassis.mass * G * chassis.cog_to_front_axle / wheelbase / 2
    car = Stepper(vehicle)
    assert_allclose(car.wheels[2], [front, front, rear, rear], rtol=1e-9)
    assert_allclose(car.acceleration, 0, atol=1e-9)


@pytest.mark.parametrize("h", [1e-3, 5e-3, 1e-2])
@pytest.mark.parametrize("speed", [0.0, 0.5, 2.0, 5.0, 10.0, 30.0])
def test_slipping_wheels_return_to_rolling_at_every_step_length_and_speed(vehicle, speed, h):
    for seed in range(3):
        random = np.random.default_rng(seed)
        car = Stepper(vehicle)
        car.u[:2] = speed, 0.1 * random.normal()
        car.u[10:] = speed / 0.334 * (1 + 0.15 * random.normal(size=4)) + 3 * random.normal(size=4)
        car.run(1.0, h)
        assert np.abs(car.u[10:] * 0.334 - car.u[0]).max() < 0.015 * np.hypot(car.u[0], 0.3)


def test_pushed_cars_roll_alike_at_short_and_long_steps(vehicle):
    random = np.random.default_rng(3)
    u = random.normal(size=14) * np.array([0.2] * 3 + [0.1] * 3 + [0.05] * 4 + [0.5] * 4)
    speeds = [Stepper(vehicle, u=u).run(1.0, h).u[0] for h in (1e-3, 1e-2)]
    assert speeds[1] == pytest.approx(speeds[0], rel=0.1)


def level_and_lossless(vehicle: Vehicle, **more: float) -> Vehicle:
    """No drag and no rolling resistance; `more` with two underscores for each dot."""
    zeros = ("aerodynamics.drag_area", "front.rolling_resistance", "rear.rolling_resistance")
    return vehicle.with_parameters(
        dict.fromkeys(zeros, 0.0) | {name.replace("__", "."): value for name, value in more.items()}
    )


def test_braking_moves_load_forward_by_mass_times_deceleration_times_height_over_wheelbase(vehicle):
    vehicle = level_and_lossless(vehicle)
    car = Stepper(vehicle)
    car.u[0] = 30.0
    car.u[10:] = 30.0 / 0.335
    before = car.wheels[2]
    car.inputs[TORQUES] = -900, -900, -500, -500
    car.run(3.0, 2e-3)
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    rates = car.acceleration
    deceleration = -(rates[0] + car.u[4] * car.u[2] - car.u[5] * car.u[1])
    spins = sum(axle.wheel_spin_inertia * r for axle, r in zip(Twin.of(vehicle, 0).axles, -rates[10:], strict=True))
    assert deceleration > 3
    # The body that dives carries the wheels' centres, which are below cog, backwards.
    shift = (chassis.cog_height - 0.325) * np.sin(car.q[4])
    expected = (chassis.mass * (deceleration * car.q[2] + G * shift) + spins) / wheelbase
    moved = car.wheels[2] - before
    assert moved[:2].sum() == pytest.approx(expected, rel=5e-3)
    assert moved[2:].sum() == pytest.approx(-expected, rel=5e-3)
    assert moved[0] == pytest.approx(moved[1], abs=1e-6)


def test_load_transfer_of_each_axle_in_a_steady_bend_follows_from_roll_stiffness_and_roll_centres(vehicle):
    # The textbook formula knows no soft tyres, heavy wheels, gyroscopic or aligning moments.
    light = {f"{axle}__{part}_mass": 2.0 for axle in ("front", "rear") for part in ("hub", "wheel")}
    light |= {f"{axle}__wheel_spin_inertia": 0.01 for axle in ("front", "rear")}
    stiff = {f"{axle}__tyre_stiffness": 1e8 for axle in ("front", "rear")}
    centres = {"front__roll_centre_height": 0.08, "rear__roll_centre_height": 0.2}
    trails = {f"{axle}__tyre__pneumatic_trail": 0.0 for axle in ("front", "rear")}
    vehicle = level_and_lossless(vehicle, **light, **stiff, **centres, **trails)
    car = Stepper(vehicle)
    car.u[0] = 20.0
    car.u[10:] = 20.0 / 0.34
    car.inputs[0] = 0.02

    def hold_speed(car: Stepper) -> None:
        car.inputs[3:5] = 500 * (20.0 - car.u[0])

    car.run(6.0, 2e-3, hold_speed)
    assert np.abs(car.acceleration).max() < 1e-3
    lateral = car.u[5] * car.u[0] - car.u[3] * car.u[2]
    assert lateral > 1.4
    physics, chassis = vehicle.physics, vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    share = np.array([chassis.cog_to_rear_axle, chassis.cog_to_front_axle]) / wheelbase
    axles = (physics.front, physics.rear)
    centre = np.array([axle.roll_centre_height for axle in axles])
    track = np.array([axle.track for axle in axles])
    rate = np.array([axle.suspension_stiffness + 2 * axle.antiroll_stiffness for axle in axles])
    lever = track**2 / 4 + centre**2  # squared distance from contact point to roll centre
    roll_stiffness = 2 * rate * lever  # [N m/rad]
    arm = chassis.cog_height - share @ centre
    roll = chassis.mass * lateral * arm / (roll_stiffness.sum() - chassis.mass * G * arm)
    transfer = (chassis.mass * lateral * share * centre + roll_stiffness * roll) / track
    loads = car.wheels[2]
    assert car.q[3] == pytest.approx(roll, rel=0.02)
    assert_allclose([(loads[1] - loads[0]) / 2, (loads[3] - loads[2]) / 2], transfer, rtol=0.01)
