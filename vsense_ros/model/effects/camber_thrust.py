"""Lateral force of tyres that lean."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, of_axle, size
from vsense_ros.model.moving_car import Corner


class CamberThrust(Effect):
    """A lateral force towards the side to which a wheel leans, in proportion to inclination and load."""

    id: ClassVar[str] = "camber_thrust"
    sentence: ClassVar[str] = "the lateral force of tyres that lean with the body"
    mistaken_for: ClassVar[tuple[str, ...]] = ("roll_steer", "toe_compliance", "imu_lever_arm")

    front: float = size("1/rad", "force over load per inclination, front", typical=0.5, low=-2.0, high=5.0)
    rear: float = size("1/rad", "force over load per inclination, rear", typical=0.5, low=-2.0, high=5.0)

    def thrust(self, thrust: ca.SX, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        return thrust - of_axle(self, corner) * load * inclination
