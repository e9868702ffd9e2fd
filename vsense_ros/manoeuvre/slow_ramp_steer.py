"""ISO 4138 at constant speed: the steering wheel is turned slowly until the tyres give way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SlowRampSteerSettings:
    """Course of the manoeuvre."""

    speed: float = 80 / 3.6  # [m/s]
    lateral_acceleration: float = 6.5  # [m/s²] at the end, if the tyres stayed linear
    start: float = 1.0  # [s]
    duration: float = 16.0  # [s]


SETTINGS = SlowRampSteerSettings()


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)
    return lambda t, q, u: np.array([angle * ramp(t, SETTINGS.start, SETTINGS.duration - SETTINGS.start), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "slow_ramp_steer",
    "Slow ramp steer",
    "ISO 4138, constant speed of 80 km/h, slowly increasing to the angle of 6.5 m/s² within 15 s",
    duration=SETTINGS.duration,
    speed=SETTINGS.speed,
    driver=driver,
)
