"""A steering angle that reads zero where the wheels do not point ahead."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, VehicleFile, size
from vsense_ros.model.moving_car import MovingCar


class SteeringOffset(Effect):
    """A constant added to the measured road-wheel angle."""

    id: ClassVar[str] = "steering_offset"
    sentence: ClassVar[str] = "an offset of the steering angle"
    changes_sides: ClassVar[tuple[str, ...]] = ("angle",)
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_conicity", "road_bank", "crosswind", "gyro_bias")

    angle: float = size("rad", "true road-wheel angle minus the measured one", typical=0.005, high=0.2)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        return {"angle": vehicle.observer.surroundings.steering_offset}

    def front_angle(self, angle: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        return angle + self.angle
