"""ISO 19365: one period of 0.7 Hz at the steering wheel, with a pause of 0.5 s in its second extreme."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import steady_steering
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SineWithDwellSettings:
    """Course of the manoeuvre after ISO 19365."""

    speed: float = 80 / 3.6  # [m/s]
    frequency: float = 0.7  # [Hz]
    dwell: float = 0.5  # [s]
    start: float = 2.0  # [s]
    amplitude: float = 3.0  # [-] times the angle of 0.3 g; the standard goes from 1.5 up to 6.5 in steps of 0.5


SETTINGS = SineWithDwellSettings()


def steering(t: float) -> float:
    """The steering angle as a share of its amplitude, between -1 and 1."""
    phase = (t - SETTINGS.start) * SETTINGS.frequency
    if phase > 0.75:
        phase = max(0.75, phase - SETTINGS.dwell * SETTINGS.frequency)
    return float(np.sin(2 * np.pi * phase)) if 0 < phase < 1 else 0.0


def driver(vehicle: Vehicle) -> Driver:
    amplitude = SETTINGS.amplitude * steady_steering(vehicle, SETTINGS.speed, 0.3 * GRAVITY)
    return lambda t, q, u: np.array([amplitude * steering(t), 0.0, 0.0, 0.0, 0.0])


MANOEUVRE = Manoeuvre(
    "sine_with_dwell",
    "Sine with dwell",
    "ISO 19365 (the manoeuvre of FMVSS 126), 80 km/h, throttle closed, 3 times the angle of 0.3 g",
    duration=8.0,
    speed=SETTINGS.speed,
    driver=driver,
)
