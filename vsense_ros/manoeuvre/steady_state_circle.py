"""ISO 4138: a circle of constant radius at a speed that rises slowly."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Circle, PathFollower, SpeedKeeper
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

RADIUS = 40.0  # [m]; the standard asks for 30 at least and prefers 100
SPEED = 5.0
LATERAL_ACCELERATION = 6.0  # [m/s²] at the end
DURATION = 20.0


def wanted_speed(t: float) -> float:
    """Lateral acceleration rises in proportion to time."""
    return float(np.sqrt(SPEED**2 + (LATERAL_ACCELERATION * RADIUS - SPEED**2) * min(t / DURATION, 1)))


def driver(vehicle: Vehicle) -> Driver:
    hands = PathFollower(vehicle, Circle(RADIUS))
    feet = SpeedKeeper(vehicle, wanted_speed)
    return lambda t, q, u: np.array([hands(t, q, u), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "steady_state_circle",
    "Steady-state circle",
    "ISO 4138, constant radius of 40 m, speed rising continuously up to 6 m/s² within 20 s",
    duration=DURATION,
    speed=SPEED,
    driver=driver,
)
