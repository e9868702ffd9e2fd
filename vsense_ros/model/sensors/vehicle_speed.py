"""Plain forward speed of the car, as a bus, a tachograph or another stack reports it."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.schema.physics import NominalPhysics
from vsense_ros.model.sensors.base import (
    ComparedSignal,
    Component,
    MeasuredQuantity,
    Names,
    Position,
    Quantity,
    SensorBase,
    Values,
    Vector,
    component,
    disturbed,
)
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive, quantized


class VehicleSpeed(SensorBase):
    """Speed over ground of a point of the body, forward [m/s]; without a covariance in its message."""

    message: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    place: ClassVar[int] = 6
    words: ClassVar[str] = "a speed of the car"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"ground speed"})
    quantities: ClassVar[tuple[Quantity, ...]] = (Quantity("speed", "m/s", "of the car, forward"),)
    components: ClassVar[tuple[Component, ...]] = (Component("forward", "speed forward"),)
    signals: ClassVar[tuple[ComparedSignal, ...]] = (ComparedSignal("vehicle_speed", "m/s", component(0), 0.03),)
    sampling: ClassVar[Sampling | None] = Sampling(20, 10, 10, (0.01,))
    longest_still: ClassVar[float] = 3.0
    longest_still_if_coarse: ClassVar[float] = 10.0

    kind: Literal["vehicle_speed"] = "vehicle_speed"
    topic: str = "vehicle/speed"
    position: Position = parameter("m", "point in the axes of cog whose speed it is", default=(0.0, 0.0, 0.0))
    noise: float = parameter("m/s", "standard deviation", gt=0, default=0.1)

    def mounting(self) -> Vector:
        return np.array(self.position)

    def deviations(self) -> Vector:
        return np.array([self.noise])

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[0] = values["linear"][0]

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        # `motion.attitude` turns the body into the map; along the car's heading there is the speed on the road.
        on_map = motion.attitude @ (motion.velocity + ca.cross(motion.rates, mounting))
        heading = ca.atan2(motion.attitude[1, 0], motion.attitude[0, 0])
        return ca.cos(heading) * on_map[0] + ca.sin(heading) * on_map[1]

    def simulated(self, drive: SimulatedDrive) -> Content:
        forward = quantized(disturbed(self, drive), drive.quantum)
        linear = np.column_stack([forward, np.zeros((len(drive), 2))])
        return Content({"linear": linear, "angular": np.zeros((len(drive), 3))})

    def first_speed(self, value: Vector, physics: NominalPhysics) -> float | None:
        return float(value[0]) if np.isfinite(value[0]) else None

    def speeds(self, value: Vector, radii: Vector) -> Vector:
        return self.mean_speed(value, 0.0)

    def mean_speed(self, value: Vector, radius: float) -> Vector:
        return value[:, 0]
