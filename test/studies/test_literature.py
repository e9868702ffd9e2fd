"""Filters of the literature beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from studies.literature import bevly_bias, decentralised, gao_aiding, he_four_wheel_steering, liu_odometry, ryu_bank
from vsense_ros.model.constants import GRAVITY


def test_wheel_odometry_closes_a_circle_around_its_centre() -> None:
    """The point is b_P ahead of the rear axle and b_Q to the left of its middle: all of it turns about one centre."""
    spins, rates = liu_odometry.wheels_on_circle(6.0, 30.0, 0.01)
    found = liu_odometry.follow(spins, rates, 0.01)
    at = found[:, :2]
    assert at[-1] == pytest.approx(at[0], abs=1e-3)
    centre = [-liu_odometry.CAR["ahead"], 30.0 - liu_odometry.CAR["beside"]]
    distance = np.hypot(*(at - centre).T)
    assert distance == pytest.approx(np.hypot(*centre), abs=0.05)
    assert found[-1, 6] == pytest.approx(2 * np.pi, abs=1e-9)


def test_a_smaller_outer_wheel_spoils_wheel_odometry_by_speed_and_by_yaw_rate() -> None:
    """A constant error e of a velocity in axes that turn by π at r leads 2 e / r away; the way is π 6 m/s / r long."""
    car, found = liu_odometry.CAR, liu_odometry.examine()[0]
    too_quick = 0.01 * 6.0 * (1 + car["track"] / 2 / 30.0)  # outer wheel [m/s]
    rate = too_quick / car["track"]
    error = np.hypot(too_quick / 2 - rate * car["beside"], rate * car["ahead"])
    assert found.reference == pytest.approx(100 * 2 * error / (np.pi * 6.0), rel=0.05)
    assert found.found < 0.05


def on_a_bank(angle: float, speed: float) -> tuple[float, float, float]:
    """Angle of the front wheels, side slip and roll of the body [rad], straight ahead: the axles carry m g φ as their
    distances to cog ask, and the springs hold m g h (φ + φ_v)."""
    car = ryu_bank.CAR
    force, length = car["mass"] * GRAVITY * angle, car["to_front"] + car["to_rear"]
    slip = force * car["to_front"] / length / car["rear_stiffness"]
    steer = slip - force * car["to_rear"] / length / car["front_stiffness"]
    lever = car["mass"] * GRAVITY * car["height"]
    return steer, slip, lever * angle / (car["roll_stiffness"] - lever)


def test_the_bank_observer_finds_a_bank_of_five_degrees_and_the_roll_of_the_body_on_it() -> None:
    angle = np.radians(5.0)
    steer, slip, roll = on_a_bank(angle, 20.0)
    n = 1000
    found = ryu_bank.follow(np.full(n, steer), 20.0, np.tile([0.0, 0.0, slip, roll + angle], (n, 1)), 0.01)
    assert np.degrees(found[-1, [4, 2, 0]]) == pytest.approx(np.degrees([angle, roll, slip]), abs=0.02)


def test_the_bank_observer_takes_the_roll_of_a_bend_for_no_bank() -> None:
    """On a level road: β and r of a steady bend by the understeer gradient, roll by m h V r."""
    car, speed, rate = ryu_bank.CAR, 20.0, 0.2
    length, across = car["to_front"] + car["to_rear"], speed * rate
    front, rear = (
        car["mass"] * across * car[other] / length / car[axle]
        for axle, other in (("front_stiffness", "to_rear"), ("rear_stiffness", "to_front"))
    )
    slip = rear + car["to_rear"] * rate / speed
    steer = length * rate / speed + rear - front
    lever = car["mass"] * car["height"]
    roll, n = lever * across / (car["roll_stiffness"] - lever * GRAVITY), 1000
    found = ryu_bank.follow(np.full(n, steer), speed, np.tile([rate, 0.0, slip, roll], (n, 1)), 0.01)
    assert np.degrees(roll) > 2.0
    assert np.degrees(found[-1, [4, 2]]) == pytest.approx([0.0, np.degrees(roll)], abs=0.02)


def test_the_markov_bias_forgets_by_its_time_constant_and_keeps_its_deviation() -> None:
    b = bevly_bias.biases(np.random.default_rng(1), 1_000_000, 1.0, 0.3, 50.0)
    assert np.std(b) == pytest.approx(0.3, rel=0.03)
    for late in (25, 50, 100):
        assert np.mean(b[late:] * b[:-late]) == pytest.approx(0.09 * np.exp(-late / 50.0), abs=0.004)


def test_without_fixes_the_markov_bias_states_the_deviation_of_an_integrated_ornstein_uhlenbeck_process() -> None:
    gyro = bevly_bias.GYRO | {"gyro_noise": 0.0}
    filter = bevly_bias.MARKOV_HEADING.make(gyro)
    start = bevly_bias.MARKOV_HEADING.start({})
    filter.start(start)
    for _ in range(12_000):
        filter.predict(0.01)
    t, tau = 120.0, gyro["time_constant"]
    wandered = 2 * gyro["bias"] ** 2 * tau**2 * (t / tau - 1 + np.exp(-t / tau))
    covariance = filter.belief().covariance
    assert covariance[0, 0] == pytest.approx(start.covariance[0, 0] + wandered, rel=1e-3)
    assert covariance[1, 1] == pytest.approx(gyro["bias"] ** 2, rel=1e-9)


def test_the_master_of_decentralised_filters_finds_what_one_filter_with_all_sensors_finds() -> None:
    master, independent, central, _ = decentralised.drive(np.random.default_rng(3), 60.0)
    assert master.mean == pytest.approx(central.mean, rel=1e-6, abs=1e-10)
    assert master.covariance == pytest.approx(central.covariance, rel=1e-6)
    assert independent.covariance[1, 1] < 0.8 * central.covariance[1, 1], "the gyro is counted twice"


def test_aiding_helps_in_an_outage_and_a_car_that_is_taken_not_to_slide_less_where_it_slides() -> None:
    straight, sliding = gao_aiding.errors(0.0, drives=3), gao_aiding.errors(np.radians(10.0), drives=3)
    assert max(straight[2], straight[3], straight[4]) < 0.5 * straight[1]
    assert straight[2] < 1.05 * min(straight[3], straight[4])
    assert min(sliding[3], sliding[4]) < sliding[2]


def test_the_winding_drive_of_the_outage_has_the_acceleration_of_its_own_velocity() -> None:
    true, readings = gao_aiding.winding_drive(np.radians(10.0))
    c, s = np.cos(true[:, 0]), np.sin(true[:, 0])
    ground = np.column_stack([c * true[:, 1] - s * true[:, 2], s * true[:, 1] + c * true[:, 2]])
    found = np.gradient(ground, gao_aiding.STEP, axis=0)[1:-1]
    along, across = readings[1:-1, 0], readings[1:-1, 1]
    felt = np.column_stack([c[1:-1] * along - s[1:-1] * across, s[1:-1] * along + c[1:-1] * across])
    assert found == pytest.approx(felt, abs=2e-3)


def test_wheels_that_all_point_aside_lead_a_car_aside_and_opposite_ones_around() -> None:
    car, angle, n = he_four_wheel_steering.CAR, 0.1, 500
    crab = he_four_wheel_steering.follow(np.full((n, 2), angle), np.full((n, 4), 5.0), 0.01)
    assert crab[-1] == pytest.approx([5.0, angle, 0.0], abs=1e-3)
    opposite = np.array([angle, -np.arctan(np.tan(angle) * car["to_rear"] / car["to_front"])])
    curvature = np.tan(angle) / car["to_front"]
    places = [(x, y) for x in (car["to_front"], -car["to_rear"]) for y in (car["half_track"], -car["half_track"])]
    wheels = [5.0 * np.hypot(1 - y * curvature, x * curvature) for x, y in places]
    around = he_four_wheel_steering.follow(np.tile(opposite, (n, 1)), np.tile(wheels, (n, 1)), 0.01)
    assert around[-1] == pytest.approx([5.0, 0.0, curvature], abs=1e-3)
