"""Suspension travel sensors: compression of each corner."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import SensorBase, by_name

NAMES = ("suspension_fl", "suspension_fr", "suspension_rl", "suspension_rr")


class Suspension(SensorBase):
    """Compression from the design position [m]; any corner may be absent."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"

    kind: Literal["suspension"] = "suspension"
    topic: str = "vehicle/suspension"
    noise: float = parameter("m", "standard deviation", gt=0, default=0.001)

    def deviations(self):
        return np.full(4, self.noise)

    def read(self, names, values, out, variance):
        by_name(names, NAMES, values.get("position"), out)

    def equation(self, motion, biases, mounting):
        return motion.q[6:10]
