"""Velocity over ground in the axes of the car: an optical sensor, or the speed and side slip of an INS."""

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
    NoiseFromMessage,
    Position,
    Quantity,
    SensorBase,
    Values,
    Vector,
    component,
    covariance_diagonal,
    disturbed,
)
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive, quantized


class BodyVelocity(SensorBase):
    """Velocity of a point of the body, forward and to the left, in the plane of the road [m/s]; one may be absent."""

    message: ClassVar[str] = "geometry_msgs/msg/TwistWithCovarianceStamped"
    place: ClassVar[int] = 5
    words: ClassVar[str] = "a velocity in the axes of the car"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"ground speed"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("velocity.x", "m/s", "along the sensor's x axis, forward"),
        Quantity("velocity.y", "m/s", "along the sensor's y axis, to the left"),
    )
    components: ClassVar[tuple[Component, ...]] = (
        Component("forward", "velocity forward"),
        Component("left", "velocity to the left"),
    )
    signals: ClassVar[tuple[ComparedSignal, ...]] = (
        ComparedSignal("forward_velocity", "m/s", component(0), 0.03),
        ComparedSignal("lateral_velocity", "m/s", component(1), 0.03),
    )
    sampling: ClassVar[Sampling | None] = Sampling(10, 4, 5, (2**-10,))
    longest_still: ClassVar[float] = 3.0
    longest_still_if_coarse: ClassVar[float] = 10.0

    kind: Literal["body_velocity"] = "body_velocity"
    topic: str = "vehicle/velocity"
    frame_id: str = "velocity_link"
    position: Position = parameter("m", "sensor in the axes of cog", default=(0.0, 0.0, 0.0))
    yaw: float = parameter(
        "rad", "angle by which the sensor points to the left of forward", ge=-3.2, le=3.2, default=0.0
    )
    noise: float = parameter("m/s", "standard deviation of each component", gt=0, default=0.05)
    noise_from_message: NoiseFromMessage = True

    def mounting(self) -> Vector:
        return np.array([*self.position, self.yaw])

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[:] = values["linear"][:2]
        diagonal = covariance_diagonal(values.get("covariance"), 2)
        if self.noise_from_message and diagonal is not None:
            variance[:] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        # `motion.attitude` turns the body into the map; what the car is turned by on the map is taken off again.
        on_map = motion.attitude @ (motion.velocity + ca.cross(motion.rates, mounting[0:3]))
        heading = ca.atan2(motion.attitude[1, 0], motion.attitude[0, 0]) + mounting[3]
        along = ca.cos(heading) * on_map[0] + ca.sin(heading) * on_map[1]
        across = -ca.sin(heading) * on_map[0] + ca.cos(heading) * on_map[1]
        return ca.vertcat(along, across)

    def simulated(self, drive: SimulatedDrive) -> Content:
        horizontal = quantized(disturbed(self, drive), drive.quantum)
        covariance = np.zeros(36)
        covariance[[0, 7]] = self.noise**2
        return Content(
            {
                "linear": np.column_stack([horizontal, np.full(len(drive), np.nan)]),
                "angular": np.zeros((len(drive), 3)),
                "covariance": drive.repeated(covariance),
            }
        )

    def first_speed(self, value: Vector, physics: NominalPhysics) -> float | None:
        return float(value[0]) if np.isfinite(value[0]) else None

    def speeds(self, value: Vector, radii: Vector) -> Vector:
        return self.mean_speed(value, 0.0)

    def mean_speed(self, value: Vector, radius: float) -> Vector:
        across = np.nan_to_num(value[:, 1])
        return np.copysign(np.hypot(value[:, 0], across), value[:, 0])

    def in_axes_of_car(self, value: Vector) -> Vector:
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        forward, left = value[:, 0], value[:, 1]
        if self.yaw == 0.0:
            return value
        return np.column_stack([cos * forward - sin * left, sin * forward + cos * left])
