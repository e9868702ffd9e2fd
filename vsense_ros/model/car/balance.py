"""The balance of forces and moments of a whole car: what the tyres carry against what the inertial sensor feels.

Newton's and Euler's laws hold whatever the model of the suspension and the tyres is. All is in the axes of the road
under the car (x forward, y left, z along its normal); moments are about the point of the road below cog.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import FORCE_X, FORCE_Y, MOMENT
from vsense_ros.model.vehicle import Physics

Array = NDArray[np.float64]

X, Y, Z, ABOUT_X, ABOUT_Y, ABOUT_Z = range(6)  # of a wrench
# What `CarBalance.shares` gives: forces as shares of the weight, loads of themselves at rest, the moment of the weight
# times the wheelbase.
SHARES = ("longitudinal force", "lateral force", "vertical force", "front load", "rear load", "yaw moment")


class CarBalance:
    """Balance of forces and moments on one car with the parameters `physics` of its vehicle file."""

    def __init__(self, physics: Physics) -> None:
        chassis, self._drag = physics.chassis, 0.5 * AIR_DENSITY * physics.aerodynamics.drag_area
        self.mass, self._height = chassis.mass, chassis.cog_height
        self._inertia = np.array([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        self._to_front, self._to_rear = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
        x = np.array([self._to_front] * 2 + [-self._to_rear] * 2)
        half = physics.front.track / 2, physics.rear.track / 2
        y = np.array([half[0], -half[0], half[1], -half[1]])
        # What forces at the contacts along, across and up (4 each) and moments about the vertical add up to.
        self._sums = np.zeros((16, 6))
        for i, (force, lever) in enumerate(((X, -y), (Y, x))):
            self._sums[4 * i : 4 * i + 4, [force, ABOUT_Z]] = np.column_stack([np.ones(4), lever])
        self._sums[8:12, [Z, ABOUT_X, ABOUT_Y]] = np.column_stack([np.ones(4), y, -x])
        self._sums[12:, ABOUT_Z] = 1.0
        weight, base = self.mass * GRAVITY, self._to_front + self._to_rear
        front, rear = weight * self._to_rear / base, weight * self._to_front / base
        self._at_rest = np.array([weight, weight, weight, front, rear, weight * base])

    def of_tyres(self, wheels: Array, steering: Array | float) -> Array:
        """Force [N] and moment [N m] of the tyres, (…, 6), from `Car.wheel_outputs` (…, 7, 4) and the mean steering
        angle of the front wheels (…) [rad]."""
        forces = wheels[..., : MOMENT + 1, :].copy()
        along, across = wheels[..., FORCE_X, :2], wheels[..., FORCE_Y, :2]
        c, s = np.cos(steering)[..., None], np.sin(steering)[..., None]
        forces[..., FORCE_X, :2] = c * along - s * across
        forces[..., FORCE_Y, :2] = s * along + c * across
        return np.asarray(forces.reshape(*wheels.shape[:-2], 16) @ self._sums)

    def of_motion(self, force: Array, turning: Array, roll: Array | float, pitch: Array | float, speed: Array) -> Array:
        """What these must be, (…, 6), from the specific force at cog in the axes of the body (…, 3) [m/s²], the change
        of its rates (…, 3) [rad/s²], its angles over the road (…) [rad] and the speed (…) [m/s], with the drag of the
        vehicle file. A body that leans is taken to turn about the axes of the road, at the height of cog at rest."""
        x, y, z = force.T
        c, s = np.cos(roll), np.sin(roll)
        y, z = c * y - s * z, s * y + c * z
        c, s = np.cos(pitch), np.sin(pitch)
        x, z = c * x + s * z, c * z - s * x
        drag = self._drag * speed * np.abs(speed)
        wrench = np.empty((*np.shape(x), 6))
        wrench[..., X], wrench[..., Y], wrench[..., Z] = self.mass * x + drag, self.mass * y, self.mass * z
        wrench[..., ABOUT_X] = -self._height * self.mass * y
        # The drag acts at cog's height in the model.
        wrench[..., ABOUT_Y] = self._height * wrench[..., X]
        wrench[..., ABOUT_Z] = 0.0
        wrench[..., ABOUT_X:] += self._inertia * turning
        return wrench

    def deviations(self, covariance: Array) -> Array:
        """Standard deviations (6,) of `shares`, from the covariance (6, 6) of the specific force [m/s²] and the change
        of the rates [rad/s²] that `of_motion` takes, for a body that hardly leans."""
        level = np.zeros(6)
        by_motion = self.shares(self.of_motion(np.eye(6)[:, :3], np.eye(6)[:, 3:], level, level, level))
        return np.sqrt(np.diag(by_motion.T @ covariance @ by_motion))

    def axle_loads(self, wrench: Array) -> tuple[Array, Array]:
        """Vertical forces of the front and of the rear axle [N] with this force and moment (…, 6)."""
        front = (wrench[..., Z] * self._to_rear - wrench[..., ABOUT_Y]) / (self._to_front + self._to_rear)
        return front, wrench[..., Z] - front

    def shares(self, residual: Array) -> Array:
        """A difference of two such (…, 6), as `SHARES`, (…, 6)."""
        shares = np.empty_like(residual)
        shares[..., :3], shares[..., 5] = residual[..., :3], residual[..., ABOUT_Z]
        shares[..., 3], shares[..., 4] = self.axle_loads(residual)
        shares /= self._at_rest
        return shares
