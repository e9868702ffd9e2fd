"""Bump stops that come into contact."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import TRAVEL
from vsense_ros.model.effects.base import Effect, of_axle, shape, size
from vsense_ros.model.moving_car import Corner, MovingCar

ROUNDING = 0.002  # [m] over which contact begins


class BumpStop(Effect):
    """A stiffness that begins where the suspension's compression exceeds a clearance."""

    id: ClassVar[str] = "bump_stop"
    sentence: ClassVar[str] = "bump stops that come into contact"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_load_sensitivity",)

    front: float = size("N/m", "stiffness of a front bump stop", typical=5e4, low=0.0, high=2e6)
    rear: float = size("N/m", "stiffness of a rear bump stop", typical=5e4, low=0.0, high=2e6)
    clearance: float = shape("m", "compression at which contact begins", default=0.03, typical=0.015, low=0.0, high=0.3)

    def suspension_force(self, force: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        depth = car.q[TRAVEL][corner.index] - self.clearance
        return force + of_axle(self, corner) * (depth + ca.sqrt(depth**2 + ROUNDING**2)) / 2
