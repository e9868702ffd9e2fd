"""A brake that does not release."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import SPIN
from vsense_ros.model.effects.base import Effect, of_wheel, size
from vsense_ros.model.moving_car import Corner, MovingCar

SMALLEST_SPIN = 1.0  # [rad/s] below it the torque fades, so that a wheel may rest


class BrakeDrag(Effect):
    """A constant torque against the rotation of a wheel."""

    id: ClassVar[str] = "brake_drag"
    sentence: ClassVar[str] = "a brake that does not release"
    mistaken_for: ClassVar[tuple[str, ...]] = ("rolling_resistance", "aero_drag", "road_grade")

    fl: float = size("N m", "torque against the rotation, front left", typical=40.0, low=0.0, high=2000.0)
    fr: float = size("N m", "torque against the rotation, front right", typical=40.0, low=0.0, high=2000.0)
    rl: float = size("N m", "torque against the rotation, rear left", typical=40.0, low=0.0, high=2000.0)
    rr: float = size("N m", "torque against the rotation, rear right", typical=40.0, low=0.0, high=2000.0)

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        return torque - of_wheel(self, corner) * ca.tanh(car.u[SPIN][corner.index] / SMALLEST_SPIN)
