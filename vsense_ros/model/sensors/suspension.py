"""Suspension travel sensors: compression of each corner."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Names, SensorBase, Values, Vector, by_name

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Motion

NAMES = ("suspension_fl", "suspension_fr", "suspension_rl", "suspension_rr")


class Suspension(SensorBase):
    """Compression from the design position [m]; any corner may be absent."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"

    kind: Literal["suspension"] = "suspension"
    topic: str = "vehicle/suspension"
    noise: float = parameter("m", "standard deviation", gt=0, default=0.001)

    def deviations(self) -> Vector:
        return np.full(4, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        by_name(names, NAMES, values.get("position"), out)

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return motion.q[6:10]
