"""Wind over the ground."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.constants import AIR_DENSITY
from vsense_ros.model.coordinates import SPEED_X, SPEED_Y, YAW
from vsense_ros.model.effects.base import Effect, shape, size
from vsense_ros.model.moving_car import MovingCar

CALM = 0.1  # [m/s] keeps the direction of the air flow defined at rest


class Crosswind(Effect):
    """A steady wind: side force and yaw moment in proportion to the angle of attack, and a change of the drag.

    The side force acts a little ahead of the middle of the body, where slender bodies have their centre of pressure
    (Hucho 2005, chapter 5).
    """

    id: ClassVar[str] = "crosswind"
    sentence: ClassVar[str] = "wind over the ground, with its side force and yaw moment"
    mistaken_for: ClassVar[tuple[str, ...]] = ("road_bank", "tyre_conicity", "steering_offset", "accelerometer_bias")
    on_map: ClassVar[bool] = True

    east: float = size("m/s", "velocity of the air to the east", typical=4.0, high=40.0)
    north: float = size("m/s", "velocity of the air to the north", typical=4.0, high=40.0)
    side_area: float = shape(
        "m²/rad", "slope of the side-force coefficient times area", default=5.0, typical=1.0, low=1.0, high=40.0
    )
    ahead: float = shape("m", "centre of pressure ahead of cog", default=0.4, typical=0.2, low=-2.0, high=3.0)

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        yaw = car.q[YAW]
        along = self.east * ca.cos(yaw) + self.north * ca.sin(yaw)
        across = self.north * ca.cos(yaw) - self.east * ca.sin(yaw)
        # Against the air, and what of it the calm air has already done to the car.
        speed_x, speed_y = car.u[SPEED_X], car.u[SPEED_Y]
        x, y = speed_x - along, speed_y - across
        side = (
            -0.5
            * AIR_DENSITY
            * self.side_area
            * (ca.sqrt(x**2 + y**2 + CALM**2) * y - ca.sqrt(speed_x**2 + speed_y**2 + CALM**2) * speed_y)
        )
        area = car.parameters.aerodynamics.drag_area
        drag = 0.5 * AIR_DENSITY * area * (x * ca.fabs(x) - speed_x * ca.fabs(speed_x))
        return force + ca.vertcat(0, 0, self.ahead * side, -drag, side, 0)
