"""Suspension travel sensors: compression of each corner."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import ComparedSignal, Component, JointSensor, Names, Quantity, Vector, component
from vsense_ros.model.sensors.simulated import Sampling


class Suspension(JointSensor):
    """Compression from the design position [m]; any corner may be absent."""

    joints: ClassVar[Names] = tuple(f"suspension_{wheel}" for wheel in WHEELS)
    field: ClassVar[str] = "position"
    place: ClassVar[int] = 8
    words: ClassVar[str] = "suspension travels"
    quantities: ClassVar[tuple[Quantity, ...]] = tuple(
        Quantity(f"travel.{w}", "m", f"compression of the suspension {w}") for w in WHEELS
    )
    components: ClassVar[tuple[Component, ...]] = tuple(Component(w, f"suspension travel {w}") for w in WHEELS)
    signals: ClassVar[tuple[ComparedSignal, ...]] = tuple(
        ComparedSignal(f"travel_{wheel}", "m", component(i), 0.001, shaken=True) for i, wheel in enumerate(WHEELS)
    )
    sampling: ClassVar[Sampling | None] = Sampling(10, 3, 2, (2**-13,))
    longest_still: ClassVar[float] = 3.0

    kind: Literal["suspension"] = "suspension"
    topic: str = "vehicle/suspension"
    noise: float = parameter("m", "standard deviation", gt=0, default=0.001)

    def deviations(self) -> Vector:
        return np.full(len(self.joints), self.noise)

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return motion.travel
