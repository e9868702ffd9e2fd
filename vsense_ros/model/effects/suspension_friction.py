"""Dry friction in the suspension."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import TRAVEL
from vsense_ros.model.effects.base import Effect, of_axle, size
from vsense_ros.model.moving_car import Corner, MovingCar

SMALLEST_RATE = 0.01  # [m/s] below it the friction fades, so that the suspension creeps instead of sticking


class SuspensionFriction(Effect):
    """A constant force against the motion of the suspension, beyond that of the dampers."""

    id: ClassVar[str] = "suspension_friction"
    sentence: ClassVar[str] = "dry friction in the suspension"
    mistaken_for: ClassVar[tuple[str, ...]] = ("sloshing_load",)
    abrupt: ClassVar[bool] = True

    front: float = size("N", "friction of one front suspension at the wheel", typical=100.0, low=0.0, high=3000.0)
    rear: float = size("N", "friction of one rear suspension at the wheel", typical=100.0, low=0.0, high=3000.0)

    def suspension_force(self, force: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        return force + of_axle(self, corner) * ca.tanh(car.u[TRAVEL][corner.index] / SMALLEST_RATE)
