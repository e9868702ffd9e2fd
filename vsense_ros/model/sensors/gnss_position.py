"""GNSS position of an antenna, horizontal: the car's model lives on the road surface and knows no height."""

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


class GnssPosition(SensorBase):
    """East and north of the map's origin [m].

    The observer adds `east` and `north` to the fields of the message, which carries latitude and longitude.
    """

    message: ClassVar[str] = "sensor_msgs/msg/NavSatFix"

    kind: Literal["gnss_position"] = "gnss_position"
    topic: str = "gps/fix"
    frame_id: str = "gnss_link"
    position: Position = parameter("m", "antenna in the axes of cog", default=(0.0, 0.0, 0.0))
    noise: float = parameter("m", "standard deviation of east and north", gt=0, default=1.5)
    noise_from_message: NoiseFromMessage = True
    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=2.5)

    def mounting(self) -> Vector:
        return np.array(self.position)

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[0], out[1] = values["east"][0], values["north"][0]
        if len(values.get("status", ())) and values["status"][0] < 0:
            out[:] = np.nan
        diagonal = covariance_diagonal(values.get("position_covariance"), 2)
        if self.noise_from_message and diagonal is not None:
            variance[:] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return (motion.q[0:3] + motion.attitude @ mounting)[0:2]
