"""ISO 4138: a circle of constant radius at a speed that rises slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Circle, PathFollower, SpeedKeeper
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SteadyStateCircleSettings:
    """Course of the manoeuvre after ISO 4138."""

    radius: float = 40.0  # [m]; the standard asks for 30 at least and prefers 100
    speed: float = 5.0  # [m/s] at the beginning
    lateral_acceleration: float = 6.0  # [m/s²] at the end
    duration: float = 20.0  # [s]


SETTINGS = SteadyStateCircleSettings()


def wanted_speed(t: float) -> float:
    """Lateral acceleration rises in proportion to time."""
    return float(
        np.sqrt(
            SETTINGS.speed**2
            + (SETTINGS.lateral_acceleration * SETTINGS.radius - SETTINGS.speed**2) * min(t / SETTINGS.duration, 1)
        )
    )


def driver(vehicle: Vehicle) -> Driver:
    hands = PathFollower(vehicle, Circle(SETTINGS.radius))
    feet = SpeedKeeper(vehicle, wanted_speed)
    return lambda t, q, u: np.array([hands(t, q, u), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "steady_state_circle",
    "Steady-state circle",
    "ISO 4138, constant radius of 40 m, speed rising continuously up to 6 m/s² within 20 s",
    duration=SETTINGS.duration,
    speed=SETTINGS.speed,
    driver=driver,
)
