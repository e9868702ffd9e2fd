"""Hills one after the other, over which a car weaves gently at a steady speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.simulation.surface import Waves
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HillsSettings:
    """The road and the weaving on it: decisions of this project."""

    speed: float = 20.0  # [m/s]
    lateral_acceleration: float = 1.0  # [m/s²] of the weaving, about
    period: float = 8.0  # [s] of the weaving


SETTINGS = HillsSettings()

HILLS = Waves(((2.5, 0.0, 250.0), (0.3, 1.25, 60.0)))  # ± 3.6° along the way, and a bank that changes


def weaving(speed: float, vehicle: Vehicle) -> Driver:
    """Keeps a speed [m/s] and steers gently from side to side."""
    feet, angle = SpeedKeeper(vehicle, lambda t: speed), 4.0 * SETTINGS.lateral_acceleration / speed**2

    def driver(t: float, q: Array, u: Array) -> Array:
        return np.concatenate([[angle * np.sin(2 * np.pi * t / SETTINGS.period) * min(t, 1.0)], feet(t, u)])

    return driver


MANOEUVRE = Manoeuvre(
    "hills",
    "Weaving over hills",
    "hills of 2.5 m every 250 m and a bank that changes, at 72 km/h",
    24.0,
    SETTINGS.speed,
    partial(weaving, SETTINGS.speed),
    surface=lambda: HILLS,
)
