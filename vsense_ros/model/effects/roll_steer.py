"""Wheels that steer as the body rolls."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import TRAVEL
from vsense_ros.model.effects.base import Effect, of_axle, size
from vsense_ros.model.moving_car import Corner, MovingCar


class RollSteer(Effect):
    """Toe of both wheels of an axle in proportion to the roll of the body over it."""

    id: ClassVar[str] = "roll_steer"
    sentence: ClassVar[str] = "wheels that steer as the body rolls"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_compliance", "toe_compliance", "gyro_scale", "steering_ratio")

    front: float = size("rad/rad", "steer to the left per roll to the right, front", typical=0.05, high=0.6)
    rear: float = size("rad/rad", "steer to the left per roll to the right, rear", typical=0.05, high=0.6)

    def toe(self, angle: ca.SX, corner: Corner, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        travel, left = car.q[TRAVEL], min(corner.index, corner.opposite)
        roll = (travel[left + 1] - travel[left]) / corner.axle.track
        return angle + of_axle(self, corner) * roll
