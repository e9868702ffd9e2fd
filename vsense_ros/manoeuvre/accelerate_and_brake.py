"""Straight ahead: up to speed, then braked as in ISO 21994 but not to the limit."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Pedals, ramp
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

SPEED = 36 / 3.6
DRIVE, COAST, BRAKE, END = 1.0, 9.0, 11.0, 16.0  # [s]
ACCELERATION, DECELERATION = 2.5, 4.5  # [m/s²]


def wanted(t: float) -> float:
    """Acceleration [m/s²]."""
    driven = ramp(t, DRIVE, 0.3) - ramp(t, COAST, 0.3)
    return ACCELERATION * driven - DECELERATION * (ramp(t, BRAKE, 0.3) - ramp(t, END - 0.5, 0.3))


def driver(vehicle: Vehicle) -> Driver:
    pedals = Pedals(vehicle)
    return lambda t, q, u: np.array([0.0, *pedals.torques(wanted(t), u)])


MANOEUVRE = Manoeuvre(
    "accelerate_and_brake",
    "Accelerate and brake",
    "straight ahead from 36 km/h: 2.5 m/s² for 8 s, 2 s without, braked by 4.5 m/s² for 4.5 s",
    duration=END,
    speed=SPEED,
    driver=driver,
)
