"""Heading from two GNSS antennas."""

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
from vsense_ros.model.sensors.gnss import Receiver, orientation_in, orientation_message
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive


class GnssAttitude(Receiver):
    """Yaw in the map [rad], as cosine and sine so that no wrap is needed.

    Cosine and sine mean nothing one by one, so it has no components.
    """

    message: ClassVar[str] = "sensor_msgs/msg/Imu"
    place: ClassVar[int] = 7
    words: ClassVar[str] = "a GNSS heading"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"heading"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("heading.cos", "-", "cosine of the heading, counterclockwise from east"),
        Quantity("heading.sin", "-", "sine of the heading, counterclockwise from east"),
    )

    sampling: ClassVar[Sampling | None] = Sampling(100, 0, 100, (2**-20,), own_clock=True)

    kind: Literal["gnss_attitude"] = "gnss_attitude"
    topic: str = "gps/attitude"
    frame_id: str = "gnss_link"
    yaw: float = parameter("rad", "direction of the base line in the axes of cog", default=0.0)
    noise: float = parameter("rad", "standard deviation of the heading", gt=0, default=0.005)
    noise_from_message: NoiseFromMessage = True

    def mounting(self) -> Vector:
        return np.array([self.yaw])

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        orientation = orientation_in(values)
        if orientation is None:
            out[:] = np.nan
        else:
            x, y, z, w = orientation
            heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            out[0], out[1] = np.cos(heading), np.sin(heading)
        diagonal = covariance_diagonal(values.get("orientation_covariance"), 3)
        if self.noise_from_message and diagonal is not None:
            variance[:] = diagonal[2]

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        heading = motion.yaw + mounting[0]
        return ca.vertcat(ca.cos(heading), ca.sin(heading))

    def simulated(self, drive: SimulatedDrive) -> Content:
        true = np.arctan2(drive.truth[:, 1], drive.truth[:, 0])
        half = (true + self.noise * drive.rng.standard_normal(len(drive)))[:, None] / 2
        # Two antennas one behind the other see no roll, and their pitch is not used.
        return orientation_message(
            drive, np.hstack([0 * half, 0 * half, np.sin(half), np.cos(half)]), (1, 1, self.noise**2)
        )

    def heading(self, value: Vector, variance: Vector) -> tuple[float, float] | None:
        cosine, sine = value
        return float(np.arctan2(sine, cosine) - self.yaw), float(np.sqrt(variance.max()))
