"""Vertical velocity from GNSS: over the speed, the slope of the road."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    MeasuredQuantity,
    Names,
    NoiseFromMessage,
    Quantity,
    Values,
    Vector,
    covariance_diagonal,
)
from vsense_ros.model.sensors.gnss import Antenna


class GnssVerticalVelocity(Antenna):
    """Upward velocity of an antenna in the map [m/s], from the same messages as the horizontal velocity.

    It is a sensor of its own because many receivers, and most recordings, give a horizontal velocity alone and leave
    the vertical one at zero: what is exactly zero is taken as absent.
    """

    message: ClassVar[str] = "geometry_msgs/msg/TwistWithCovarianceStamped"
    place: ClassVar[int] = 9
    words: ClassVar[str] = "a vertical GNSS velocity"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"height"})
    quantities: ClassVar[tuple[Quantity, ...]] = (Quantity("velocity.up", "m/s", "of the antenna"),)

    kind: Literal["gnss_vertical_velocity"] = "gnss_vertical_velocity"
    topic: str = "gps/velocity"
    frame_id: str = "map"
    noise: float = parameter("m/s", "standard deviation", gt=0, default=0.2)
    noise_from_message: NoiseFromMessage = True

    def deviations(self) -> Vector:
        return np.array([self.noise])

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        up = values["linear"][2]
        out[0] = up if up != 0.0 else np.nan
        diagonal = covariance_diagonal(values.get("covariance"), 3)
        if self.noise_from_message and diagonal is not None:
            variance[0] = diagonal[2]

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return (motion.attitude @ (motion.velocity + ca.cross(motion.rates, mounting)))[2]
