"""Braked to rest in a wide bend, and off again: what a car does at every traffic light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Circle, PathFollower, SpeedKeeper
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class StopAndGoSettings:
    """Course of the manoeuvre: a decision of this project."""

    radius: float = 30.0  # [m]
    speed: float = 10.0  # [m/s] at the beginning
    brake: float = 3.0  # [s] from which it brakes
    rest: float = 6.0  # [s] at which it is to stand; the last bit takes a second
    go: float = 9.0  # [s] from which it is driven again
    gone: float = 14.5  # [s] at which it has its new speed
    new_speed: float = 11.0  # [m/s]
    duration: float = 18.0  # [s]


SETTINGS = StopAndGoSettings()


def wanted_speed(t: float) -> float:
    """Speed [m/s] at a time [s]."""
    s = SETTINGS
    times, speeds = (0.0, s.brake, s.rest, s.go, s.gone), (s.speed, s.speed, 0.0, 0.0, s.new_speed)
    return float(np.interp(t, times, speeds))


def driver(vehicle: Vehicle) -> Driver:
    """Hands that keep to the circle, and feet that keep the speed."""
    hands, feet = PathFollower(vehicle, Circle(SETTINGS.radius)), SpeedKeeper(vehicle, wanted_speed)
    return lambda t, q, u: np.array([hands(t, q, u), *feet(t, u)])


MANOEUVRE = Manoeuvre(
    "stop_and_go",
    "Stop and go",
    "a circle of 30 m: braked from 36 km/h to rest by 3.3 m/s², 3 s at rest, up to 40 km/h within 5.5 s",
    duration=SETTINGS.duration,
    speed=SETTINGS.speed,
    driver=driver,
)
