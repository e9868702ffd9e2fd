"""A steering system that yields to the lateral force of the front tyres."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import FORCE_Y
from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.moving_car import MovingCar


class SteeringCompliance(Effect):
    """The front wheels turn back in proportion to the lateral force of their axle, after a lag.

    The trail of caster and tyre turns the lateral force into a moment, to which column, rack and mounts yield
    (Milliken & Milliken 1995, section 19.4).
    """

    LAG: ClassVar[float] = 0.03  # [s] inertia of the steering system against its compliance

    id: ClassVar[str] = "steering_compliance"
    sentence: ClassVar[str] = "a steering system that yields to the lateral force of the front tyres"
    mistaken_for: ClassVar[tuple[str, ...]] = ("toe_compliance", "roll_steer", "aero_downforce", "steering_ratio")
    internal_state: ClassVar[tuple[str, ...]] = ("front_lateral_force",)

    compliance: float = size("rad/N", "angle per lateral force of the front axle", typical=1e-6, low=-2e-6, high=2e-5)

    def front_angle(self, angle: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        return angle - self.compliance * internal_state[0]

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        force = car.wheel_outputs[FORCE_Y, 0] + car.wheel_outputs[FORCE_Y, 1]
        return internal_state + (1 - ca.exp(-h / self.LAG)) * (force - internal_state)
