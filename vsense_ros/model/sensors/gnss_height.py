"""Height from GNSS: its change is the slope of the road."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    Bias,
    MeasuredQuantity,
    Names,
    Quantity,
    Values,
    Vector,
)
from vsense_ros.model.sensors.gnss import Antenna


class GnssHeight(Antenna):
    """Height of an antenna over the map's origin [m], from the same messages as the position.

    A receiver's height is off by metres, but this error changes slowly: it is estimated, and what heights differ by
    within seconds is known to decimetres. So the deviation that a message states of the whole error is not used.
    """

    message: ClassVar[str] = "sensor_msgs/msg/NavSatFix"
    geodetic: ClassVar[bool] = True
    place: ClassVar[int] = 8
    words: ClassVar[str] = "a GNSS height"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"height"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("position.up", "m", "height of the antenna over the map's origin"),
    )

    kind: Literal["gnss_height"] = "gnss_height"
    topic: str = "gps/fix"
    frame_id: str = "gnss_link"
    noise: float = parameter("m", "standard deviation of the error that changes at once", gt=0, default=0.3)
    slow_error: float = parameter("m", "standard deviation of the error that stays", ge=0, default=5.0)
    slow_error_drift: float = parameter("m", "its change in one second", ge=0, default=0.1)

    def biases(self) -> tuple[Bias, ...]:
        return (Bias("slow_error", self.slow_error, self.slow_error_drift, unit="m"),)

    def deviations(self) -> Vector:
        return np.array([self.noise])

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[0] = values["up"][0]
        if len(values.get("status", ())) and values["status"][0] < 0:
            out[:] = np.nan

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return (motion.position + motion.attitude @ mounting)[2] + biases
