"""ISO 7401: a step of the steering wheel at constant speed, to a lateral acceleration of 4 m/s²."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import STEERING_RATE, SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

SPEED = 80 / 3.6
LATERAL_ACCELERATION = 4.0  # [m/s²]
START = 2.0  # [s]


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SPEED, LATERAL_ACCELERATION)
    feet = SpeedKeeper(vehicle, lambda t: SPEED)
    return lambda t, q, u: np.array([angle * ramp(t, START, angle / STEERING_RATE), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "step_steer",
    "Step steer",
    "ISO 7401, step input, 80 km/h, 4 m/s² to the left",
    duration=10.0,
    speed=SPEED,
    driver=driver,
)
