"""Straight ahead: up to speed, then braked as in ISO 21994 but not to the limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Pedals, ramp
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class AccelerateAndBrakeSettings:
    """Course of the manoeuvre: a decision of this project."""

    speed: float = 36 / 3.6  # [m/s] at the beginning
    drive: float = 1.0  # [s] from which the car is driven
    coast: float = 9.0  # [s] from which it coasts
    brake: float = 11.0  # [s] from which it brakes
    end: float = 16.0  # [s]
    acceleration: float = 2.5  # [m/s²]
    deceleration: float = 4.5  # [m/s²]


SETTINGS = AccelerateAndBrakeSettings()


def wanted(t: float) -> float:
    """Acceleration [m/s²]."""
    driven = ramp(t, SETTINGS.drive, 0.3) - ramp(t, SETTINGS.coast, 0.3)
    return SETTINGS.acceleration * driven - SETTINGS.deceleration * (
        ramp(t, SETTINGS.brake, 0.3) - ramp(t, SETTINGS.end - 0.5, 0.3)
    )


def driver(vehicle: Vehicle) -> Driver:
    pedals = Pedals(vehicle)
    return lambda t, q, u: np.array([0.0, *pedals.torques(wanted(t), u)])


MANOEUVRE = Manoeuvre(
    "accelerate_and_brake",
    "Accelerate and brake",
    "straight ahead from 36 km/h: 2.5 m/s² for 8 s, 2 s without, braked by 4.5 m/s² for 4.5 s",
    duration=SETTINGS.end,
    speed=SETTINGS.speed,
    driver=driver,
)
