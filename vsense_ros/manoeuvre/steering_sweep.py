"""ISO 7401, continuous sinusoidal input: faster and faster at constant speed and constant amplitude."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import SpeedKeeper, ramp, steady_steering
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

SPEED = 80 / 3.6
LATERAL_ACCELERATION = 3.0  # [m/s²] of the amplitude in a steady turn
START = 1.0  # [s]
DURATION = 21.0  # [s]
LOWEST, HIGHEST = 0.2, 2.5  # [Hz]


def steering(t: float) -> float:
    """Between -1 and 1; the frequency rises in proportion to time."""
    since = max(t - START, 0.0)
    rise = (HIGHEST - LOWEST) / (DURATION - START)
    return float(np.sin(2 * np.pi * (LOWEST * since + 0.5 * rise * since**2))) * ramp(t, START, 0.5)


def driver(vehicle: Vehicle) -> Driver:
    amplitude = steady_steering(vehicle, SPEED, LATERAL_ACCELERATION)
    feet = SpeedKeeper(vehicle, lambda t: SPEED)
    return lambda t, q, u: np.array([amplitude * steering(t), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "steering_sweep",
    "Steering sweep",
    "ISO 7401, sinusoidal input from 0.2 to 2.5 Hz within 20 s, 80 km/h, the angle of 3 m/s²",
    duration=DURATION,
    speed=SPEED,
    driver=driver,
)
