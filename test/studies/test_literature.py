"""Filters of the literature beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from studies.literature import liu_odometry, ryu_bank
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
