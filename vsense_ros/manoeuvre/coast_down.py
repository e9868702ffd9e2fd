"""ISO 10521-1: rolling out in neutral gear on a straight road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class CoastDownSettings:
    """Course of the manoeuvre."""

    speed: float = 120 / 3.6  # [m/s] at the beginning
    duration: float = 30.0  # [s]; the standard goes on until 15 km/h


SETTINGS = CoastDownSettings()


def driver(vehicle: Vehicle) -> Driver:
    return lambda t, q, u: np.zeros(5)


MANOEUVRE = Manoeuvre(
    "coast_down",
    "Coast-down",
    "ISO 10521-1, straight ahead in neutral gear from 120 km/h, for 30 s",
    duration=SETTINGS.duration,
    speed=SETTINGS.speed,
    driver=driver,
)
