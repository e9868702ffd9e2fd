"""A load that swings from side to side."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import FORCE_Y, FORCE_Z, ROLL
from vsense_ros.model.effects.base import Effect, shape, size
from vsense_ros.model.moving_car import MovingCar

DAMPING = 0.05  # damping ratio of the swing
LEAST_REST = 0.2  # of the car's mass that does not swing: what a fit may try beyond has no meaning


class SloshingLoad(Effect):
    """Part of the car's mass hangs as a pendulum: fluid in a tank, hanging goods (Ibrahim 2005, chapter 1).

    It swings against lateral acceleration and leaves its share of the lateral force and of its weight elsewhere than
    the rigid body would have them.
    """

    id: ClassVar[str] = "sloshing_load"
    sentence: ClassVar[str] = "a load that swings from side to side"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_relaxation", "suspension_friction")
    internal_state: ClassVar[tuple[str, ...]] = ("displacement", "velocity")

    mass: float = size("kg", "mass that swings", typical=100.0, low=0.0, high=20000.0)
    frequency: float = shape("rad/s", "natural frequency of the swing", default=4.0, typical=1.5, low=1.0, high=20.0)

    def _acceleration(self, internal_state: ca.SX, car: MovingCar) -> ca.SX:
        """Acceleration of the load relative to the body [m/s²]: a pendulum on a cart, of whose mass it is part, so that
        it pushes the cart away from under itself. In a body that rolls it falls to the lower side as well."""
        mass = car.parameters.chassis.mass
        across = ca.sum2(car.wheel_outputs[FORCE_Y, :]) + ca.sin(car.q[ROLL]) * ca.sum2(car.wheel_outputs[FORCE_Z, :])
        restoring = 2 * DAMPING * self.frequency * internal_state[1] + self.frequency**2 * internal_state[0]
        return -(across / mass + restoring) / ca.fmax(1 - self.mass / mass, LEAST_REST)

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        side = -self.mass * self._acceleration(internal_state, car)
        return force + ca.vertcat(-self.mass * GRAVITY * internal_state[0], 0, 0, 0, side, 0)

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        velocity = internal_state[1] + h * self._acceleration(internal_state, car)
        return ca.vertcat(internal_state[0] + h * velocity, velocity)
