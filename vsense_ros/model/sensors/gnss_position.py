"""GNSS position of an antenna, horizontal: the car's model lives on the road surface and knows no height."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np
import pymap3d

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    Component,
    MeasuredQuantity,
    Names,
    NoiseFromMessage,
    Quantity,
    Values,
    Vector,
    covariance_diagonal,
    disturbed,
)
from vsense_ros.model.sensors.gnss import Antenna
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive


class GnssPosition(Antenna):
    """East and north of the map's origin [m].

    Whoever reads its messages adds `east` and `north` to their fields, which are latitude and longitude.
    """

    message: ClassVar[str] = "sensor_msgs/msg/NavSatFix"
    geodetic: ClassVar[bool] = True
    place: ClassVar[int] = 5
    words: ClassVar[str] = "a GNSS position"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"position"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("position.east", "m", "of the antenna, from the map's origin"),
        Quantity("position.north", "m", "of the antenna, from the map's origin"),
    )
    components: ClassVar[tuple[Component, ...]] = (
        Component("east", "GNSS position to the east", "m"),
        Component("north", "GNSS position to the north", "m"),
    )
    # Steps of latitude, longitude [deg] and height [m].
    sampling: ClassVar[Sampling | None] = Sampling(100, 0, 100, (2**-27, 2**-27, 2**-10), own_clock=True)

    kind: Literal["gnss_position"] = "gnss_position"
    topic: str = "gps/fix"
    frame_id: str = "gnss_link"
    noise: float = parameter("m", "standard deviation of east and north", gt=0, default=1.5)
    noise_from_message: NoiseFromMessage = True

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
        return (motion.position + motion.attitude @ mounting)[0:2]

    def simulated(self, drive: SimulatedDrive) -> Content:
        east, north = disturbed(self, drive).T
        height = drive.position[:, 2] + self.position[2] + 2 * self.noise * drive.rng.standard_normal(len(drive))
        geodetic = np.column_stack(pymap3d.enu2geodetic(east, north, height, *drive.origin))
        latitude, longitude, altitude = (column[:, None] for column in drive.digitized(geodetic).T)
        return Content(
            {
                "status": np.zeros((len(drive), 1)),
                "service": np.ones((len(drive), 1)),
                "latitude": latitude,
                "longitude": longitude,
                "altitude": altitude,
                "position_covariance": drive.repeated(np.diag(np.square([1, 1, 2]) * self.noise**2).ravel()),
                "position_covariance_type": drive.repeated([2]),  # the diagonal is known
            }
        )
