"""Wheel torques, where the car reports them: inputs of the model."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.coordinates import TORQUES
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import JointSensor, MeasuredQuantity, Names, Response, Vector
from vsense_ros.model.sensors.simulated import Sampling
from vsense_ros.model.sensors.wheel_speeds import NAMES


class WheelTorques(JointSensor):
    """Drive minus brake torque at each wheel [N m]; without this sensor the torques are estimated."""

    joints: ClassVar[Names] = NAMES
    field: ClassVar[str] = "effort"
    place: ClassVar[int] = 4
    words: ClassVar[str] = "wheel torques"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"torques"})
    inputs: ClassVar[slice | None] = TORQUES
    sampling: ClassVar[Sampling | None] = Sampling(10, 2, 2, (2**-4,))
    # More than this specific force along the car neither cornering nor a slope brings about.
    response: ClassVar[Response | None] = Response(3, by_speed=False, least=2.5, words="the wheel torques are")

    kind: Literal["wheel_torques"] = "wheel_torques"
    topic: str = "vehicle/wheel_torques"
    noise: float = parameter("N m", "standard deviation of the slowly varying error of each torque", gt=0, default=20.0)

    def deviations(self) -> Vector:
        return np.zeros(len(self.joints))
