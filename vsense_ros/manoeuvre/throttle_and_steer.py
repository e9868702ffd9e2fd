"""The two manoeuvres of Rodríguez 2020: constant throttle from rest, a step of the steering at 5 s, 10 s in all.

He prints the masses, the friction and the accelerometers' noise, which is equal on the three axes and so has no bias.
The percentages of his tyre forces imply what he divides by: 400 N along, 530 N across and 1000 N under the rear right
tyre. So the throttle gives 400 N, and the turn is to the right, where that tyre is the lightly loaded one; it is as
sharp as the road of manoeuvre 2 allows at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import DRIVER, ramp
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class ThrottleAndSteerSettings:
    """Course of the manoeuvres of Rodríguez 2020."""

    torque: float = 115.0  # [N m] at each rear wheel
    angle: float = -0.11  # [rad] of the road wheels
    step: float = 5.0  # [s]
    pedal_time: float = 0.3  # [s] until the throttle is where it stays


COURSE = ThrottleAndSteerSettings()


def driver(vehicle: Vehicle) -> Driver:
    def drive(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = COURSE.torque * ramp(t, 0.0, COURSE.pedal_time)
        return np.array(
            [COURSE.angle * ramp(t, COURSE.step, abs(COURSE.angle) / DRIVER.steering_rate), 0.0, 0.0, torque, torque]
        )

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
        biased=False,
    )
    for number, friction in ((1, 0.8), (2, 0.6))
)
