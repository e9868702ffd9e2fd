"""Wheel speed sensors: spin of each wheel relative to its hub."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Names, SensorBase, Values, Vector, by_name

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Motion

NAMES = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")


class WheelSpeeds(SensorBase):
    """Spin speeds [rad/s]; any wheel may be absent."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"

    kind: Literal["wheel_speeds"] = "wheel_speeds"
    topic: str = "vehicle/wheel_speeds"
    noise: float = parameter("rad/s", "standard deviation", gt=0, default=0.05)

    def deviations(self) -> Vector:
        return np.full(4, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        by_name(names, NAMES, values.get("velocity"), out)

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return motion.u[10:14]
