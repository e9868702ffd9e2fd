"""What filters know of a car, against what the full car does."""

from __future__ import annotations

import numpy as np
import pytest

from marks import exam_except
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import ROLL, SPEED_X, YAW_RATE
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.navigation.car_numbers import car_numbers, roll_numbers

CARS = ("jaguar_saloon", "prototype_model")


@pytest.mark.parametrize("name", exam_except(CARS, "prototype_model"))
def test_the_body_rolls_in_a_circle_as_far_as_the_number_says(name):
    car, circle = load_vehicle(vehicle_path(name)), MANOEUVRES["steady_state_circle"]
    q, u = rolling_straight(car, circle.speed)
    s = simulate(car, circle.driver(car), circle.duration, step=1e-3, keep_every=20, q=q, u=u)
    across = s.u[:, YAW_RATE] * s.u[:, SPEED_X]
    turning = (s.t > 5) & (np.abs(across) > 0.5) & (np.abs(across) < 4.0)
    assert turning.sum() > 50
    gain = GRAVITY * np.sum(s.q[turning, ROLL] * across[turning]) / np.sum(across[turning] ** 2)
    assert roll_numbers(car)["roll_gain"] == pytest.approx(gain, rel=0.08)


@pytest.mark.parametrize("name", CARS)
def test_a_body_let_go_swings_as_fast_as_the_number_says(name):
    car = load_vehicle(vehicle_path(name))
    axles = {key: getattr(car.physics, key) for key in ("front", "rear")}
    # With weak dampers, so that there is something to count.
    weak = {key: axle.model_copy(update={"suspension_damping": 300.0}) for key, axle in axles.items()}
    car = car.model_copy(update={"physics": car.physics.model_copy(update=weak)})
    q, u = rolling_straight(car, 20.0)
    q[ROLL] += 0.02
    driver = MANOEUVRES["coast_down"].driver(car)
    s = simulate(car, driver, 3.0, step=1e-3, keep_every=1, q=q, u=u)
    roll = s.q[:, ROLL] - s.q[-500:, ROLL].mean()
    crossings = s.t[:-1][np.diff(np.sign(roll)) != 0]
    assert len(crossings) >= 4
    frequency = np.pi / np.mean(np.diff(crossings[:6]))
    assert roll_numbers(car)["roll_frequency"] == pytest.approx(frequency, rel=0.15)


def test_numbers_of_all_cars_are_finite_and_those_of_a_stiffer_car_roll_less():
    car = load_vehicle(vehicle_path("jaguar_saloon"))
    numbers = car_numbers(car, ())
    assert all(np.isfinite(value) for value in numbers.values())
    front = car.physics.front.model_copy(update={"antiroll_stiffness": 2 * car.physics.front.antiroll_stiffness})
    stiff = car.model_copy(update={"physics": car.physics.model_copy(update={"front": front})})
    assert roll_numbers(stiff)["roll_gain"] < numbers["roll_gain"]
    assert roll_numbers(stiff)["roll_frequency"] > numbers["roll_frequency"]
