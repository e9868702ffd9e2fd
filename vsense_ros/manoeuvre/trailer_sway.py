"""ISO 9815: a short turn of the steering wheel, after which a trailer sways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper, steady_steering, within
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class TrailerSwaySettings:
    """Course of the manoeuvre after ISO 9815."""

    speed: float = 25.0  # [m/s]
    lateral_acceleration: float = 4.0  # [m/s²] of the car in a steady turn with the largest angle
    start: float = 2.0  # [s]
    duration: float = 0.6  # [s] of a whole sine: to the left and back, then as far to the right


SETTINGS = TrailerSwaySettings()


def driver(vehicle: Vehicle) -> Driver:
    """Raises `InputError` for a car that tows nothing."""
    if vehicle.physics.trailer is None:
        raise InputError(f"{vehicle.name} tows no trailer: give the section physics.trailer, of which mass is enough")
    angle = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)

    def command(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        share = within((t - SETTINGS.start) / SETTINGS.duration, 1.0)
        return np.array([angle * np.sin(2 * np.pi * max(share, 0.0)), *feet(t, u)])

    return command


MANOEUVRE = Manoeuvre(
    "trailer_sway",
    "Sway of a trailer",
    "ISO 9815, one period of steering at 90 km/h, with a trailer; the speed is kept",
    duration=12.0,
    speed=SETTINGS.speed,
    driver=driver,
)
