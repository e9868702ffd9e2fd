"""GNSS velocity of an antenna, east and north."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    Names,
    NoiseFromMessage,
    Position,
    SensorBase,
    Values,
    Vector,
    covariance_diagonal,
)

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Motion


class GnssVelocity(SensorBase):
    """Horizontal velocity in the map [m/s]."""

    message: ClassVar[str] = "geometry_msgs/msg/TwistWithCovarianceStamped"

    kind: Literal["gnss_velocity"] = "gnss_velocity"
    topic: str = "gps/velocity"
    frame_id: str = "map"
    position: Position = parameter("m", "antenna in the axes of cog", default=(0.0, 0.0, 0.0))
    noise: float = parameter("m/s", "standard deviation of east and north", gt=0, default=0.1)
    noise_from_message: NoiseFromMessage = True
    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=2.5)

    def mounting(self) -> Vector:
        return np.array(self.position)

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[:] = values["linear"][:2]
        diagonal = covariance_diagonal(values.get("covariance"), 2)
        if self.noise_from_message and diagonal is not None:
            variance[:] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        on_road = motion.attitude @ (motion.u[0:3] + ca.cross(motion.u[3:6], mounting))
        # Of the way along a sloping road only the cosine is seen on the map.
        return on_road[0:2] * ca.cos(motion.disturbances[0])
