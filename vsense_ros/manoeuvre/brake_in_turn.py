"""ISO 7975: into a turn of 100 m at 5 m/s², then the brake, the steering wheel held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Pedals, SpeedKeeper, ramp, steady_steering
from vsense_ros.model.coordinates import SPEED_X
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class BrakeInTurnSettings:
    """Course of the manoeuvre after ISO 7975."""

    radius: float = 100.0  # [m]
    lateral_acceleration: float = 5.0  # [m/s²]
    speed: float = (lateral_acceleration * radius) ** 0.5  # [m/s]
    turn: float = 1.5  # [s] from which the car turns
    brake: float = 6.0  # [s] from which it brakes
    deceleration: float = 4.0  # [m/s²]
    walking_speed: float = 3.0  # [m/s] below it the brake is eased off


SETTINGS = BrakeInTurnSettings()


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SETTINGS.speed, SETTINGS.lateral_acceleration)
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)
    pedals = Pedals(vehicle)

    def drive(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        steering = angle * ramp(t, SETTINGS.turn, 0.5)
        if t < SETTINGS.brake:
            return np.array([steering, *feet(t, u)])
        eased = min(max(float(u[SPEED_X]), 0.0) / SETTINGS.walking_speed, 1.0)
        return np.array([steering, *pedals.torques(-SETTINGS.deceleration * ramp(t, SETTINGS.brake, 0.2) * eased, u)])

    return drive


MANOEUVRE = Manoeuvre(
    "brake_in_turn",
    "Brake in turn",
    "ISO 7975, radius about 100 m at 5 m/s², braked by 4 m/s², steering wheel held",
    duration=12.0,
    speed=SETTINGS.speed,
    driver=driver,
)
