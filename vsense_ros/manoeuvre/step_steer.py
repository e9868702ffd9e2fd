"""ISO 7401: a step of the steering wheel at constant speed, to a lateral acceleration of 4 m/s²."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import DRIVER, SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class StepSteerSettings:
    """Course of the manoeuvre after ISO 7401."""

    speed: float = 80 / 3.6  # [m/s]
    lateral_acceleration: float = 4.0  # [m/s²]
    start: float = 2.0  # [s]


SETTINGS = StepSteerSettings()


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)
    return lambda t, q, u: np.array([angle * ramp(t, SETTINGS.start, angle / DRIVER.steering_rate), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "step_steer",
    "Step steer",
    "ISO 7401, step input, 80 km/h, 4 m/s² to the left",
    duration=10.0,
    speed=SETTINGS.speed,
    driver=driver,
)
