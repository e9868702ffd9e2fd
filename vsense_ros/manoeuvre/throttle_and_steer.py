"""The two manoeuvres of Rodríguez 2020: constant throttle from rest, a step of the steering at 5 s, 10 s in all.

He prints the masses and the friction alone. The throttle is chosen such that the rear tyres' longitudinal force is near
the 400 N that his percentages imply (165 N being 41 %), the angle such that the road of manoeuvre 2 is used up.
"""

from __future__ import annotations

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import STEERING_RATE, ramp
from vsense_ros.model.simulate import Driver
from vsense_ros.model.vehicle import Vehicle

TORQUE = 115.0  # [N m] at each rear wheel
ANGLE = 0.11  # [rad] of the road wheels
STEP = 5.0  # [s]
_PEDAL = 0.3  # [s] until the throttle is where it stays


def driver(vehicle: Vehicle) -> Driver:
    def drive(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = TORQUE * ramp(t, 0.0, _PEDAL)
        return np.array([ANGLE * ramp(t, STEP, ANGLE / STEERING_RATE), 0.0, 0.0, torque, torque])

    return drive


MANOEUVRES = tuple(
    Manoeuvre(
        f"rodriguez_{number}",
        f"Constant throttle, step of the steering at 5 s, friction {friction}",
        f"Rodríguez 2020, manoeuvre {number}",
        duration=10.0,
        speed=0.0,
        driver=driver,
        friction=friction,
    )
    for number, friction in ((1, 0.8), (2, 0.6))
)
