"""Tyres that push to one side while they roll straight."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, of_axle, size

if TYPE_CHECKING:
    from vsense_ros.model.car import Corner


class TyreConicity(Effect):
    """A lateral force in proportion to the load, without slip: conicity and ply steer of both tyres of an axle."""

    id: ClassVar[str] = "tyre_conicity"
    sentence: ClassVar[str] = "tyres that push to one side while they roll straight"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_offset", "road_bank", "gyro_bias", "crosswind")

    front: float = size("-", "force to the left over load, front axle", typical=0.01, high=0.3)
    rear: float = size("-", "force to the left over load, rear axle", typical=0.01, high=0.3)

    def thrust(self, thrust: ca.SX, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        return thrust + of_axle(self, corner) * load
