"""A steering ratio other than that of the vehicle file."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.moving_car import MovingCar


class SteeringRatio(Effect):
    """Road wheels that turn by more or less than the measured angle says, in proportion."""

    id: ClassVar[str] = "steering_ratio"
    sentence: ClassVar[str] = "road wheels that turn by a multiple of the angle that is measured"
    mistaken_for: ClassVar[tuple[str, ...]] = ("gyro_scale", "roll_steer", "steering_compliance")

    relative: float = size(
        "-", "true road-wheel angle over the measured one, minus 1", typical=0.05, low=-0.5, high=1.0
    )

    def front_angle(self, angle: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        return angle * (1 + self.relative)
