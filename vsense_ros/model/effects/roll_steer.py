"""Wheels that steer as the body rolls."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, of_axle, size

FRONT_RIGHT, REAR_RIGHT = 7, 9  # their compressions among the coordinates

if TYPE_CHECKING:
    from vsense_ros.model.car import Car


class RollSteer(Effect):
    """Toe of both wheels of an axle in proportion to the roll of the body over it."""

    id: ClassVar[str] = "roll_steer"
    sentence: ClassVar[str] = "wheels that steer as the body rolls"
    excited_by: ClassVar[tuple[str, ...]] = ("steering sweep", "slalom")
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_compliance", "toe_compliance", "gyro_scale", "steering_ratio")

    front: float = size(
        "rad/rad", "steer of the front wheels to the left per roll to the right", typical=0.05, high=0.6
    )
    rear: float = size("rad/rad", "steer of the rear wheels to the left per roll to the right", typical=0.05, high=0.6)

    def steer(self, angles: list[ca.SX], car: Car, memory: ca.SX) -> list[ca.SX]:
        turned = list(angles)
        for wheel, angle in enumerate(angles):
            axle = car.parameters.front if wheel < 2 else car.parameters.rear
            right = FRONT_RIGHT if wheel < 2 else REAR_RIGHT
            roll = (car.q[right] - car.q[right - 1]) / axle.track
            turned[wheel] = angle + of_axle(self, wheel) * roll
        return turned
