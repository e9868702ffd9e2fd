"""Vertical air forces on the axles."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.constants import AIR_DENSITY
from vsense_ros.model.coordinates import SPEED_X
from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.moving_car import MovingCar


class AeroDownforce(Effect):
    """Vertical forces above the axles growing with the square of the speed: of wings and splitters, or lift."""

    id: ClassVar[str] = "aero_downforce"
    sentence: ClassVar[str] = "vertical air forces that grow with the square of the speed"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_compliance", "tyre_heating", "tyre_load_sensitivity")

    front: float = size("m²", "downforce coefficient of the front axle times area", typical=0.3, low=-3.0, high=8.0)
    rear: float = size("m²", "downforce coefficient of the rear axle times area", typical=0.3, low=-3.0, high=8.0)

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        pressure = 0.5 * AIR_DENSITY * car.u[SPEED_X] ** 2
        chassis = car.parameters.chassis
        front, rear = pressure * self.front, pressure * self.rear
        pitch = front * chassis.cog_to_front_axle - rear * chassis.cog_to_rear_axle
        return force + ca.vertcat(0, pitch, 0, 0, 0, -front - rear)
