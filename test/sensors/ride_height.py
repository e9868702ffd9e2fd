"""A kind of sensor that the package does not have, in one file, as its author would write it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import ComparedSignal, Component, JointSensor, Names, Vector, component
from vsense_ros.model.sensors.simulated import Sampling

if TYPE_CHECKING:
    from vsense_ros.model.motion import Motion


class RideHeight(JointSensor):
    """Height of the body above the road at two points, one behind the other [m]."""

    joints: ClassVar[Names] = ("height_front", "height_rear")
    field: ClassVar[str] = "position"
    words: ClassVar[str] = "ride heights"
    components: ClassVar[tuple[Component, ...]] = (
        Component("front", "ride height in front"),
        Component("rear", "ride height at the rear"),
    )
    signals: ClassVar[tuple[ComparedSignal, ...]] = (
        ComparedSignal("ride_height_front", "m", component(0), 0.001, shaken=True),
        ComparedSignal("ride_height_rear", "m", component(1), 0.001, shaken=True),
    )
    sampling: ClassVar[Sampling | None] = Sampling(10, 4, 2, (2**-16,))
    longest_still: ClassVar[float] = 2.0

    kind: Literal["ride_height"] = "ride_height"
    topic: str = "vehicle/ride_height"
    ahead: float = parameter("m", "of cog: the point in front", default=1.0)
    behind: float = parameter("m", "of cog: the point at the rear", default=1.0)
    noise: float = parameter("m", "standard deviation", gt=0, default=0.002)

    def mounting(self) -> Vector:
        return np.array([self.ahead, self.behind])

    def deviations(self) -> Vector:
        return np.full(len(self.joints), self.noise)

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        up = motion.over_road[2, 0]  # how far one metre ahead on the body is higher
        return ca.vertcat(motion.height + up * mounting[0], motion.height - up * mounting[1])
