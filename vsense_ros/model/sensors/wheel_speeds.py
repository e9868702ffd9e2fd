"""Wheel speed sensors: spin of each wheel relative to its hub."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import SensorBase, by_name

NAMES = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")


class WheelSpeeds(SensorBase):
    """Spin speeds [rad/s]; any wheel may be absent."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"

    kind: Literal["wheel_speeds"] = "wheel_speeds"
    topic: str = "vehicle/wheel_speeds"
    noise: float = parameter("rad/s", "standard deviation", gt=0, default=0.05)

    def deviations(self):
        return np.full(4, self.noise)

    def read(self, names, values, out, variance):
        by_name(names, NAMES, values.get("velocity"), out)

    def equation(self, motion, biases, mounting):
        return motion.u[10:14]
