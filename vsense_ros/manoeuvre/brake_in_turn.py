"""ISO 7975: into a turn of 100 m at 5 m/s², then the brake, the steering wheel held."""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import Pedals, SpeedKeeper, ramp, steady_steering
from vsense_ros.model.coordinates import SPEED_X
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle

RADIUS = 100.0  # [m]
LATERAL_ACCELERATION = 5.0  # [m/s²]
SPEED = (LATERAL_ACCELERATION * RADIUS) ** 0.5
TURN = 1.5  # [s]
BRAKE = 6.0  # [s]
DECELERATION = 4.0  # [m/s²]
WALKING = 3.0  # [m/s] below it the brake is eased off


def driver(vehicle: Vehicle) -> Driver:
    angle = steady_steering(vehicle, SPEED, LATERAL_ACCELERATION)
    feet = SpeedKeeper(vehicle, lambda t: SPEED)
    pedals = Pedals(vehicle)

    def drive(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        steering = angle * ramp(t, TURN, 0.5)
        if t < BRAKE:
            return np.array([steering, *feet(t, u)])
        eased = min(max(float(u[SPEED_X]), 0.0) / WALKING, 1.0)
        return np.array([steering, *pedals.torques(-DECELERATION * ramp(t, BRAKE, 0.2) * eased, u)])

    return drive


MANOEUVRE = Manoeuvre(
    "brake_in_turn",
    "Brake in turn",
    "ISO 7975, radius about 100 m at 5 m/s², braked by 4 m/s², steering wheel held",
    duration=12.0,
    speed=SPEED,
    driver=driver,
)
