"""Wheel suspensions that yield to lateral forces."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import FORCE_Y
from vsense_ros.model.effects.base import Effect, of_axle, size
from vsense_ros.model.moving_car import Corner, MovingCar


class ToeCompliance(Effect):
    """Each wheel turns away from its own lateral force, as bushings let it."""

    LAG: ClassVar[float] = 0.01  # [s] of a wheel on its bushings

    id: ClassVar[str] = "toe_compliance"
    sentence: ClassVar[str] = "wheels that turn on their bushings under lateral force"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_compliance", "roll_steer", "tyre_load_sensitivity")
    internal_state: ClassVar[tuple[str, ...]] = ("force_fl", "force_fr", "force_rl", "force_rr")

    front: float = size("rad/N", "angle of a front wheel against its lateral force", typical=1e-6, high=2e-5)
    rear: float = size("rad/N", "angle of a rear wheel against its lateral force", typical=1e-6, high=2e-5)

    def toe(self, angle: ca.SX, corner: Corner, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        return angle - of_axle(self, corner) * internal_state[corner.index]

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        return internal_state + (1 - ca.exp(-h / self.LAG)) * (car.wheel_outputs[FORCE_Y, :].T - internal_state)
