"""The simulated car against what can be worked out on paper."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from marks import exam_except
from vsense_ros.manoeuvre import TESTS, drive
from vsense_ros.manoeuvre.driver import SpeedKeeper, ramp, steady_steering, understeer_gradient
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle


@pytest.fixture(scope="module")
def bicycle(plant) -> Vehicle:
    """The car without what the linear bicycle model leaves out: aligning moments, suspensions that steer as the car
    rolls, and resistances, against which the rear wheels would drive and load themselves."""
    changes = {"aerodynamics.drag_area": 0.0}
    for axle in ("front", "rear"):
        changes |= {f"{axle}.tyre.pneumatic_trail": 0.0, f"{axle}.rolling_resistance": 0.0}
    return plant.with_parameters(changes).model_copy(update={"suspension": None})


def steered(vehicle: Vehicle, speed: float, angle: float, duration: float):
    """A car that keeps its speed with a constant road-wheel angle, from a straight run."""
    feet = SpeedKeeper(vehicle, lambda t: speed)
    q, u = rolling_straight(vehicle, speed)
    return simulate(
        vehicle,
        lambda t, q, u: np.array([angle * ramp(t, 0.5, 0.5), *feet(t, u)]),
        duration,
        step=2e-3,
        keep_every=5,
        q=q,
        u=u,
    )


def test_a_standing_car_stays_where_it_is(plant):
    still = simulate(plant, lambda t, q, u: np.zeros(5), 2.0, step=2e-3)
    assert np.abs(still.q - still.q[0]).max() < 1e-6
    assert np.abs(still.u).max() < 1e-6


def test_halving_the_step_does_not_move_the_result(plant):
    coarse, fine = drive("double_lane_change", plant), drive("double_lane_change", plant, step=5e-4)
    assert np.abs(coarse.q[:, :2] - fine.q[:, :2]).max() < 2e-3
    assert np.abs(coarse.side_slip - fine.side_slip).max() < np.radians(0.005)
    assert np.abs(coarse.wheels[:, :3] - fine.wheels[:, :3]).max() < 5.0


def test_the_step_is_of_second_order(plant):
    """Each halving divides the error by four."""

    def at_the_end(step: float) -> np.ndarray:
        q, u = rolling_straight(plant, 15.0)
        angle = 0.03
        return simulate(
            plant, lambda t, q, u: np.array([angle * np.sin(6 * t), 0, 0, 0, 0]), 2.0,
            step=step, keep_every=round(2.0 / step), q=q, u=u,
        ).q[-1, :6]  # fmt: skip

    results = [at_the_end(s) for s in (8e-3, 4e-3, 2e-3)]
    first, second = (np.linalg.norm(b - a) for a, b in pairwise(results))
    assert first / second == pytest.approx(4.0, rel=0.15)


def test_in_a_steady_turn_the_lateral_acceleration_is_speed_squared_over_radius(plant):
    motion = steered(plant, 15.0, 0.05, 8.0)
    late = motion.t > 6.0
    centre, radius = _circle(motion.q[late, :2])
    speed = np.hypot(motion.u[late, 0], motion.u[late, 1])
    to_centre = np.mean(np.linalg.norm(motion.acceleration[late, :2], axis=1))
    assert to_centre == pytest.approx(np.mean(speed**2) / radius, rel=2e-3)
    assert np.linalg.norm(motion.q[-1, :2] - centre) == pytest.approx(radius, rel=1e-4)


def _circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Least-squares circle: x² + y² = 2 a x + 2 b y + c."""
    left = np.column_stack([2 * points, np.ones(len(points))])
    (a, b, c), *_ = np.linalg.lstsq(left, (points**2).sum(axis=1), rcond=None)
    return np.array([a, b]), float(np.sqrt(c + a * a + b * b))


@pytest.mark.parametrize("speed", [10.0, 20.0])
def test_the_yaw_rate_at_small_angles_is_that_of_the_linear_bicycle(bicycle, speed):
    """Gain v / (l + EG v²), with the cornering stiffness that the vehicle file states for the static loads."""
    angle = steady_steering(bicycle, speed, 0.5)
    motion = steered(bicycle, speed, angle, 5.0)
    gain = motion.u[-1, 0] / (2.2 + understeer_gradient(bicycle) * motion.u[-1, 0] ** 2)
    assert motion.u[-1, 5] == pytest.approx(gain * angle, rel=0.02)


def test_the_understeer_gradient_is_the_slope_of_steering_over_lateral_acceleration(bicycle):
    """At one radius the angle beyond l/R rises with the lateral acceleration as the bicycle's gradient says."""
    excess, lateral = [], []
    for speed, wanted in ((8.0, 0.25), (16.0, 1.0)):  # both near a radius of 256 m
        angle = steady_steering(bicycle, speed, wanted)
        motion = steered(bicycle, speed, angle, 6.0)
        radius = np.hypot(*motion.u[-1, :2]) / motion.u[-1, 5]
        excess.append(angle - 2.2 / radius)
        lateral.append(motion.acceleration[-1, 1])
    slope = (excess[1] - excess[0]) / (lateral[1] - lateral[0])
    assert slope == pytest.approx(understeer_gradient(bicycle), rel=0.1)


def test_a_coasting_car_loses_speed_to_rolling_resistance_and_air(plant):
    """m_e v̇ = -c m g - ρ/2 A v², where the wheels' rotation adds to the mass."""
    q, u = rolling_straight(plant, 25.0)
    motion = simulate(plant, lambda t, q, u: np.zeros(5), 10.0, step=2e-3, keep_every=5, q=q, u=u)
    p = plant.physics
    rolling = p.front.rolling_resistance * p.chassis.mass * 9.80665
    radius = p.front.unloaded_radius
    mass = p.chassis.mass + 2 * (p.front.wheel_spin_inertia + p.rear.wheel_spin_inertia) / radius**2
    speed, h = 25.0, 1e-3
    for _ in range(10_000):
        speed -= h * (rolling + 0.5 * 1.204 * p.aerodynamics.drag_area * speed**2) / mass
    assert motion.u[-1, 0] == pytest.approx(speed, abs=0.02)


@pytest.mark.parametrize(("axle", "driven"), [("front", [0, 1]), ("rear", [2, 3]), ("all", [0, 1, 2, 3])])
def test_a_car_is_driven_at_the_axle_that_its_file_states(plant, axle, driven):
    """At a constant speed these wheels overcome the drag, and all others are dragged along."""
    car = plant.model_copy(update={"drivetrain": plant.drivetrain.model_copy(update={"driven": axle})})
    force = steered(car, 25.0, 0.0, 4.0).wheels[-1, 0]
    assert (force > 0).tolist() == [wheel in driven for wheel in range(4)]


def test_without_slip_damping_or_resistance_a_bouncing_car_keeps_its_energy(plant):
    """In the air nothing but gravity acts: the sum of potential and kinetic energy of the whole car stays."""
    q, u = rolling_straight(plant, 10.0)
    q[2] += 3.0
    car = plant.with_parameters(
        {"aerodynamics.drag_area": 0.0, "front.suspension_damping": 0.0, "rear.suspension_damping": 0.0}
    )
    motion = simulate(car, lambda t, q, u: np.zeros(5), 0.5, step=5e-4, q=q, u=u)
    assert motion.wheels[:, 2].max() == 0.0
    assert np.allclose(motion.u[:, 0], motion.u[0, 0], atol=1e-6) or motion.q[-1, 4] != 0.0
    # The hubs spring out, so the chassis does not fall freely; the centre of gravity of all does.
    p = car.physics
    unsprung = [a.hub_mass + a.wheel_mass for a in (p.front, p.front, p.rear, p.rear)]
    guides = [1 / np.hypot(1, 2 * a.roll_centre_height / a.track) for a in (p.front, p.front, p.rear, p.rear)]
    height = motion.q[:, 2] + motion.q[:, 6:10] @ (np.array(unsprung) * guides) / p.chassis.mass
    assert np.allclose(height, height[0] - 0.5 * 9.80665 * motion.t**2, atol=2e-3)


@pytest.mark.parametrize("name", exam_except([m.name for m in TESTS], "double_lane_change", "brake_in_turn"))
def test_tyre_forces_and_accelerations_belong_together(plant, name):
    """Newton for the whole car in a manoeuvre: the tyres' forces, and air and slope, make its acceleration."""
    motion = drive(name, plant)
    vertical = motion.wheels[:, 2].sum(axis=1)
    weight = plant.physics.chassis.mass * 9.80665
    assert np.mean(vertical[-2000:]) == pytest.approx(weight, rel=0.01)
    steering = motion.inputs[:, 0]
    across = motion.wheels[:, 1]
    along = motion.wheels[:, 0]
    front = across[:, :2].sum(axis=1) * np.cos(steering) + along[:, :2].sum(axis=1) * np.sin(steering)
    lateral = (front + across[:, 2:].sum(axis=1)) / plant.physics.chassis.mass
    assert np.sqrt(np.mean((lateral - motion.acceleration[:, 1]) ** 2)) < 0.15
    # No tyre gives more than its grip.
    grip = np.hypot(along, across) / np.maximum(motion.wheels[:, 2], 100.0)
    assert grip.max() < 0.8 * 1.1


def test_the_double_lane_change_stays_between_the_cones(plant):
    from vsense_ros.manoeuvre.double_lane_change import lanes, vehicle_width

    motion = drive("double_lane_change", plant)
    half = vehicle_width(plant) / 2
    for begin, end, right, left in lanes(plant):
        inside = (motion.q[:, 0] > begin) & (motion.q[:, 0] < end)
        for ahead in (1.2, 0.0, -1.0):
            middle = motion.q[inside, 1] + ahead * np.sin(motion.q[inside, 5])
            assert middle.max() + half < left
            assert middle.min() - half > right


def test_the_sine_with_dwell_pauses_half_a_second_at_its_second_extreme():
    from vsense_ros.manoeuvre.sine_with_dwell import SETTINGS, steering

    t = np.arange(0, 8, 1e-3)
    angle = np.array([steering(x) for x in t])
    assert np.sum(angle == -1.0) * 1e-3 == pytest.approx(0.5, abs=0.01)
    assert angle.max() == pytest.approx(1.0, abs=1e-4)
    duration = t[np.flatnonzero(angle)[-1]] - SETTINGS.start
    assert duration == pytest.approx(1 / 0.7 + 0.5, abs=0.01)
