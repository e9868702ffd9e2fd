"""Air drag beyond that of the vehicle file."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.constants import AIR_DENSITY
from vsense_ros.model.coordinates import SPEED_X
from vsense_ros.model.effects.base import Effect, VehicleFile, size
from vsense_ros.model.moving_car import MovingCar


class AeroDrag(Effect):
    """A force against the motion that grows with the square of the speed: a roof box, open windows, a wake."""

    id: ClassVar[str] = "aero_drag"
    sentence: ClassVar[str] = "air drag that grows with the square of the speed"
    mistaken_for: ClassVar[tuple[str, ...]] = ("rolling_resistance", "road_grade", "brake_drag")
    needs: ClassVar[tuple[str, ...]] = ("wheel_torques",)

    area: float = size("m²", "drag coefficient times frontal area, added to the file's", typical=0.15, high=5.0)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        return {"area": 0.05 * vehicle.physics.aerodynamics.drag_area}

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        drag = 0.5 * AIR_DENSITY * self.area * car.u[SPEED_X] * ca.fabs(car.u[SPEED_X])
        return force - ca.vertcat(0, 0, 0, drag, 0, 0)
