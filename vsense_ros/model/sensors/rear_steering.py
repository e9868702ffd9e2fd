"""Angle of the rear wheels of a car that steers them: an input of the model."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.coordinates import REAR_STEERING
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import JointSensor, MeasuredQuantity, Names, Values, Vector
from vsense_ros.model.sensors.simulated import Sampling


class RearSteering(JointSensor):
    """Road-wheel angle at the rear, positive to the left [rad]; the car must have `physics.steering.rear`."""

    joints: ClassVar[Names] = ("road_wheel_rear",)
    field: ClassVar[str] = "position"
    place: ClassVar[int] = 3
    words: ClassVar[str] = "an angle of the rear wheels"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"rear steering"})
    inputs: ClassVar[slice | None] = slice(REAR_STEERING, REAR_STEERING + 1)
    awaited: ClassVar[float] = 5.0
    sampling: ClassVar[Sampling | None] = Sampling(10, 2, 2, (2**-14,))

    kind: Literal["rear_steering"] = "rear_steering"
    topic: str = "vehicle/rear_steering"
    limit: float = parameter("rad", "angles beyond this are refused", gt=0, default=0.6)

    def deviations(self) -> Vector:
        return np.zeros(1)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        super().read(names, values, out, variance)
        if abs(out[0]) > self.limit:
            out[0] = np.nan
