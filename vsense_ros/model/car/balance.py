"""The balance of forces and moments of a whole car: what the tyres carry against what the inertial sensor feels.

Newton's and Euler's laws hold whatever the model of the suspension and the tyres is. All is in the axes of the road
under the car (x forward, y left, z along its normal); moments are about the point of the road below cog.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import FORCE_X, FORCE_Y, FORCE_Z, MOMENT
from vsense_ros.model.vehicle import Physics

Array = NDArray[np.float64]

X, Y, Z, ABOUT_X, ABOUT_Y, ABOUT_Z = range(6)  # of a wrench
# What `CarBalance.shares` tells: forces as shares of the weight, loads of themselves at rest, the moment of the weight
# times the wheelbase.
SHARES = ("longitudinal force", "lateral force", "vertical force", "front load", "rear load", "yaw moment")


class CarBalance:
    """Of one car; `physics` is that of its vehicle file."""

    def __init__(self, physics: Physics) -> None:
        chassis, self._drag = physics.chassis, 0.5 * AIR_DENSITY * physics.aerodynamics.drag_area
        self.mass, self._height = chassis.mass, chassis.cog_height
        self._inertia = np.array([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        self._to_front, self._to_rear = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
        self._x = np.array([self._to_front] * 2 + [-self._to_rear] * 2)
        half = physics.front.track / 2, physics.rear.track / 2
        self._y = np.array([half[0], -half[0], half[1], -half[1]])
        weight, base = self.mass * GRAVITY, self._to_front + self._to_rear
        front, rear = weight * self._to_rear / base, weight * self._to_front / base
        self._at_rest = np.array([weight, weight, weight, front, rear, weight * base])

    def of_tyres(self, wheels: Array, steering: Array | float) -> Array:
        """Force [N] and moment [N m] of the tyres, (…, 6), from `Car.wheel_outputs` (…, 7, 4) and the steering angle of
        the front wheels [rad] (…)."""
        turn = np.zeros((*wheels.shape[:-2], 4))
        turn[..., :2] = np.asarray(steering)[..., None]
        c, s = np.cos(turn), np.sin(turn)
        along, across = wheels[..., FORCE_X, :], wheels[..., FORCE_Y, :]
        x, y, z = c * along - s * across, s * along + c * across, wheels[..., FORCE_Z, :]
        about_z = self._x * y - self._y * x + wheels[..., MOMENT, :]
        parts = (x, y, z, self._y * z, -self._x * z, about_z)
        return np.stack([part.sum(axis=-1) for part in parts], axis=-1)

    def of_motion(self, force: Array, turning: Array, roll: Array | float, pitch: Array | float, speed: Array) -> Array:
        """What these must be, (…, 6), from the specific force at cog in the axes of the body (…, 3) [m/s²], the change
        of its rates (…, 3) [rad/s²], its angles over the road [rad] and the speed [m/s], with the vehicle file's drag.
        To first order in roll; the moments of inertia are those of the whole car about its axes."""
        x, y, z = (force[..., i] for i in range(3))
        y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
        x, z = np.cos(pitch) * x + np.sin(pitch) * z, np.cos(pitch) * z - np.sin(pitch) * x
        drag = self._drag * speed * np.abs(speed)
        found = np.empty((*np.shape(x), 6))
        found[..., X], found[..., Y], found[..., Z] = self.mass * x + drag, self.mass * y, self.mass * z
        found[..., ABOUT_X] = -self._height * self.mass * y
        # The drag acts at cog's height in the model.
        found[..., ABOUT_Y] = self._height * found[..., X]
        found[..., ABOUT_Z] = 0.0
        found[..., ABOUT_X:] += self._inertia * turning
        return found

    def axle_loads(self, wrench: Array) -> tuple[Array, Array]:
        """Vertical forces of the front and of the rear axle [N] with this force and moment (…, 6)."""
        front = (wrench[..., Z] * self._to_rear - wrench[..., ABOUT_Y]) / (self._to_front + self._to_rear)
        return front, wrench[..., Z] - front

    def shares(self, residual: Array) -> Array:
        """A difference of two such (…, 6), as `SHARES`, (…, 6)."""
        parts = (
            residual[..., X],
            residual[..., Y],
            residual[..., Z],
            *self.axle_loads(residual),
            residual[..., ABOUT_Z],
        )
        return np.stack(parts, axis=-1) / self._at_rest
