"""What is known beforehand of the torques on the wheels of a car: which are driven, which are braked, and when.

A differential drives its two wheels alike, brakes act on all wheels in fixed shares, and neither happens to a wheel
that is not driven while the brakes are released. So errors of the wheels' torques are not independent of each other:
their covariance is that of one driving torque, one braking torque, and a small rest for each wheel. Without it, radii
of tyres that differ by a third of a percent look like axles that pull against each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sin

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import GRADE, SPEED_X, WHEELS
from vsense_ros.model.sensors import SensorBase, WheelTorques
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

RELEASED, BRAKING = 0, 1  # brakes
PAIRS = tuple((i, j) for i in range(len(WHEELS)) for j in range(i))  # of wheels, as C reads what they share
STANDING = 1.0  # [m/s] below it brakes may hold the car, whatever it does


@dataclass(frozen=True)
class TorqueErrors:
    """Errors of the torques on the wheels, as angular accelerations, with brakes that are released or may act."""

    covariance: Array  # (2, 4, 4) [rad²/s⁴] in the long run
    rate: Array  # (2, 4) [1/s] at which they decay
    # (2, 4) of each wheel in a longitudinal force that the model lacks; zero where no axle is known to be driven, and
    # where torques are measured
    shares: Array
    engine_braking: float  # [m/s²] deceleration from which on brakes act
    drag: float  # [1/m] deceleration by the air over the square of the speed
    measured: bool  # True if sensors measure wheel torques, or rolling speeds, from which the torques follow

    @classmethod
    def of(cls, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> TorqueErrors:
        """Torque errors of a vehicle with these sensors."""
        settings, train, physics = vehicle.observer.force_errors, vehicle.drivetrain, vehicle.physics
        inertia = np.array([axle.wheel_spin_inertia for axle in (physics.front, physics.rear) for _ in range(2)])
        rate = np.full((2, len(WHEELS)), 1 / settings.wheel_spin_time_constant)
        driving, braking = train.driving_shares, np.array(train.braking_shares)
        shares = np.zeros((2, 4)) if driving is None else np.array([driving, braking])
        rolling = any("rolling speed" in sensor.measures for sensor in sensors.values())
        noises = [sensor.noise for sensor in sensors.values() if isinstance(sensor, WheelTorques)]
        if noises:
            deviation = noises[-1] / inertia
            covariance = np.array([np.diag(deviation**2)] * 2)
            # A measured torque and the spin of its wheel determine the wheel's force: what the car's motion lacks
            # is then that of its mass, of wind or of the road.
            shares = np.zeros((2, 4))
        elif driving is None or not rolling:
            covariance = np.array([np.diag(np.full(4, settings.wheel_spin * rolling) ** 2)] * 2)
        else:
            common, own_deviation = settings.wheel_spin, train.uneven * settings.wheel_spin
            driven = np.array(driving) / max(driving)
            braked = braking / braking.max()
            free = driven == 0
            driven_alike = common**2 * np.outer(driven, driven)
            of_wheel = np.where(free, train.free_torque / inertia, own_deviation)
            released = driven_alike + np.diag(of_wheel**2)
            covariance = np.array(
                [released, driven_alike + common**2 * np.outer(braked, braked) + np.diag(np.full(4, own_deviation**2))]
            )
            rate[RELEASED, free] = 1 / train.release_time
        drag = 0.5 * AIR_DENSITY * physics.aerodynamics.drag_area / physics.chassis.mass
        return cls(covariance, rate, shares, train.engine_braking, drag, rolling or bool(noises))

    @cached_property
    def shares_known(self) -> bool:
        """True if a longitudinal force that the model lacks belongs to wheels that are known."""
        return bool(self.shares.any())

    @property
    def determine_forces(self) -> bool:
        """True if the share of each wheel in the longitudinal force is determined: by sensors, or by what is driven."""
        return self.measured or self.shares_known

    def mode(self, udot: Array, u: Array, disturbances: Array) -> int:
        """`RELEASED` or `BRAKING`, from the accelerations (14,), the velocities (14,) and the slope of the road."""
        speed = u.item(SPEED_X)
        if speed < STANDING:
            return BRAKING
        along = udot.item(0) - u.item(5) * u.item(1) + GRAVITY * sin(disturbances.item(GRADE))
        return RELEASED if along + self.drag * speed * speed > -self.engine_braking else BRAKING
