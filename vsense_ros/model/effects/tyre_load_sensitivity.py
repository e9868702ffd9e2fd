"""Grip that falls as the wheel load grows."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, VehicleFile, of_axle, size
from vsense_ros.model.moving_car import Corner

LEAST = 0.2  # of the grip that is left at any load


class TyreLoadSensitivity(Effect):
    """Friction falls in proportion to the load above that at rest, beyond what the tyre model knows."""

    id: ClassVar[str] = "tyre_load_sensitivity"
    sentence: ClassVar[str] = "grip that falls with the wheel load"
    mistaken_for: ClassVar[tuple[str, ...]] = ("toe_compliance", "roll_steer", "steering_compliance")

    front: float = size("-", "relative loss of grip at twice the load at rest, front", typical=0.15, low=-0.3, high=0.8)
    rear: float = size("-", "relative loss of grip at twice the load at rest, rear", typical=0.15, low=-0.3, high=0.8)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        return {"front": 0.1, "rear": 0.1}  # by which formulas differ that were fitted to the same tyre

    def friction(self, friction: ca.SX, corner: Corner, load: ca.SX, internal_state: ca.SX) -> ca.SX:
        excess = load / corner.static_load - 1
        return friction * ca.fmax(1 - of_axle(self, corner) * excess, LEAST)
