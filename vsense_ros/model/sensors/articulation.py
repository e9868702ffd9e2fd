"""Articulation angle between a car and its trailer, as a sensor at the hitch or a rear camera measures it."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Bias, JointSensor, MeasuredQuantity, Names, Quantity, Vector
from vsense_ros.model.sensors.simulated import Sampling


class Articulation(JointSensor):
    """Angle from the car's heading to the trailer's, positive to the left [rad]; the car must have `physics.trailer`.
    The observer of the car has no use for it; the filter of the trailer has."""

    joints: ClassVar[Names] = ("hitch",)
    field: ClassVar[str] = "position"
    place: ClassVar[int] = 90
    words: ClassVar[str] = "an articulation angle of the trailer"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"articulation"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("angle", "rad", "from the car's heading to the trailer's, positive to the left"),
    )
    of_trailer: ClassVar[bool] = True
    sampling: ClassVar[Sampling | None] = Sampling(20, 4, 10, (2**-12,))

    kind: Literal["articulation"] = "articulation"
    topic: str = "vehicle/articulation"
    noise: float = parameter("rad", "standard deviation", gt=0, default=0.003)
    offset: float = parameter("rad", "standard deviation of the constant error", ge=0, default=0.01)

    def deviations(self) -> Vector:
        return np.array([self.noise])

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return motion.articulation + biases[0]

    def biases(self) -> tuple[Bias, ...]:
        return (Bias("articulation_offset", self.offset, 0.0, unit="rad"),)
