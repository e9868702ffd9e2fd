"""ISO 4138 at constant speed: the steering wheel is turned slowly until the tyres give way."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

SPEED = 80 / 3.6
LATERAL_ACCELERATION = 6.5  # [m/s²] at the end, if the tyres stayed linear
START = 1.0  # [s]
DURATION = 16.0  # [s]


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SPEED, LATERAL_ACCELERATION)
    feet = SpeedKeeper(vehicle, lambda t: SPEED)
    return lambda t, q, u: np.array([angle * ramp(t, START, DURATION - START), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "slow_ramp_steer",
    "Slow ramp steer",
    "ISO 4138, constant speed of 80 km/h, slowly increasing to the angle of 6.5 m/s² within 15 s",
    duration=DURATION,
    speed=SPEED,
    driver=driver,
)
