"""ISO 7401, continuous sinusoidal input: faster and faster at constant speed and constant amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SteeringSweepSettings:
    """Course of the manoeuvre after ISO 7401."""

    speed: float = 80 / 3.6  # [m/s]
    lateral_acceleration: float = 3.0  # [m/s²] of the amplitude in a steady turn
    start: float = 1.0  # [s]
    duration: float = 21.0  # [s]
    lowest_frequency: float = 0.2  # [Hz]
    highest_frequency: float = 2.5  # [Hz]


SETTINGS = SteeringSweepSettings()


def steering(t: float) -> float:
    """Between -1 and 1; the frequency rises in proportion to time."""
    since = max(t - SETTINGS.start, 0.0)
    rise = (SETTINGS.highest_frequency - SETTINGS.lowest_frequency) / (SETTINGS.duration - SETTINGS.start)
    return float(np.sin(2 * np.pi * (SETTINGS.lowest_frequency * since + 0.5 * rise * since**2))) * ramp(
        t, SETTINGS.start, 0.5
    )


def driver(vehicle: Vehicle) -> Driver:
    amplitude = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)
    return lambda t, q, u: np.array([amplitude * steering(t), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "steering_sweep",
    "Steering sweep",
    "ISO 7401, sinusoidal input from 0.2 to 2.5 Hz within 20 s, 80 km/h, the angle of 3 m/s²",
    duration=SETTINGS.duration,
    speed=SETTINGS.speed,
    driver=driver,
)
