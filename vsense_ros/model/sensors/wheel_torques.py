"""Wheel torques, where the car tells them: inputs of the model."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Names, SensorBase, Values, Vector, by_name
from vsense_ros.model.sensors.wheel_speeds import NAMES

INPUT = slice(1, 5)


class WheelTorques(SensorBase):
    """Drive minus brake torque at each wheel [N m]; without this sensor the torques are estimated."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"
    is_input: ClassVar[bool] = True

    kind: Literal["wheel_torques"] = "wheel_torques"
    topic: str = "vehicle/wheel_torques"
    noise: float = parameter("N m", "standard deviation of the slowly varying error of each torque", gt=0, default=20.0)

    def deviations(self) -> Vector:
        return np.zeros(4)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        by_name(names, NAMES, values.get("effort"), out)
