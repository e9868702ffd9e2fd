"""Tyres that push to one side while they roll straight."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, of_wheel, size
from vsense_ros.model.moving_car import Corner


class TyreConicity(Effect):
    """A lateral force of a tyre in proportion to the load, without slip: conicity and ply steer (Pacejka 2012,
    chapter 4). That of one wheel grows with the load on it, so that a turn to one side shows more of it than one to the
    other; that of both front wheels alike is a steering wheel that is not straight.
    """

    id: ClassVar[str] = "tyre_conicity"
    sentence: ClassVar[str] = "a tyre that pushes to one side while it rolls straight"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_offset", "road_bank", "gyro_bias", "crosswind")

    fl: float = size("-", "force to the left over load, front left", typical=0.04, high=0.3)
    fr: float = size("-", "force to the left over load, front right", typical=0.04, high=0.3)
    rl: float = size("-", "force to the left over load, rear left", typical=0.04, high=0.3)
    rr: float = size("-", "force to the left over load, rear right", typical=0.04, high=0.3)

    def thrust(self, thrust: ca.SX, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        return thrust + of_wheel(self, corner) * load
