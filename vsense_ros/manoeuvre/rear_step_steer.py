"""ISO 7401 on a car that steers its rear wheels, too: a step of both axles at constant speed, to 4 m/s²."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import DRIVER, SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class RearStepSteerSettings:
    """Course of the manoeuvre after ISO 7401; the share is one of production cars at speed (Sano et al. 1986)."""

    speed: float = 80 / 3.6  # [m/s]
    lateral_acceleration: float = 4.0  # [m/s²]
    start: float = 2.0  # [s]
    share: float = 0.3  # [-] angle of the rear wheels over that of the front wheels, to the same side


SETTINGS = RearStepSteerSettings()


def driver(vehicle: Vehicle) -> Driver:
    """Raises `InputError` for a car whose rear wheels are not steered."""
    if not vehicle.physics.steering.rear:
        raise InputError(f"{vehicle.name} does not steer its rear wheels: physics.steering.rear is false")
    # In a steady turn what counts is by how much the front wheels are turned further than the rear ones.
    angle = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration) / (1 - SETTINGS.share)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)

    def command(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        front = angle * ramp(t, SETTINGS.start, angle / DRIVER.steering_rate)
        return np.array([front, *feet(t, u), SETTINGS.share * front])

    return command


MANOEUVRE = Manoeuvre(
    "rear_step_steer",
    "Step steer of both axles",
    "ISO 7401, step input, 80 km/h, 4 m/s² to the left, on a car with rear steering",
    duration=10.0,
    speed=SETTINGS.speed,
    driver=driver,
)
