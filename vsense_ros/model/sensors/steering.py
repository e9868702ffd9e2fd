"""Steering angle sensor: an input of the model, whose offset the observer estimates."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Names, SensorBase, Values, Vector

INPUT = slice(0, 1)


class Steering(SensorBase):
    """Road-wheel angle [rad]; where only the steering wheel is measured, the vehicle's ratio converts it."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"
    is_input: ClassVar[bool] = True

    kind: Literal["steering"] = "steering"
    topic: str = "vehicle/steering"
    ratio: float | None = parameter("-", "steering-wheel over road-wheel angle; default: the vehicle's", default=None)
    gain: float = parameter("-", "true road-wheel angle over the reported one", gt=0, lt=10, default=1.0)
    limit: float = parameter("rad", "road-wheel angles beyond this are refused", gt=0, default=0.9)

    def deviations(self) -> Vector:
        return np.zeros(1)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[0] = np.nan
        position = values.get("position")
        if position is None or len(position) != len(names):
            return
        if "road_wheel_front" in names:
            out[0] = self.gain * position[names.index("road_wheel_front")]
        elif "steering_wheel" in names and self.ratio is not None:
            out[0] = self.gain * position[names.index("steering_wheel")] / self.ratio
        if abs(out[0]) > self.limit:
            out[0] = np.nan
