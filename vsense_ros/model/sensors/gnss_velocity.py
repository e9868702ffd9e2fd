"""GNSS velocity of an antenna, east and north."""

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
    Quantity,
    Values,
    Vector,
    covariance_diagonal,
    disturbed,
)
from vsense_ros.model.sensors.gnss import Antenna
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive


def _course(value: Vector, radius: float) -> Vector:
    return np.unwrap(np.arctan2(value[:, 1], value[:, 0]))


def _ground_speed(value: Vector, radius: float) -> Vector:
    return np.hypot(value[:, 0], value[:, 1])


class GnssVelocity(Antenna):
    """Horizontal velocity in the map [m/s]."""

    message: ClassVar[str] = "geometry_msgs/msg/TwistWithCovarianceStamped"
    place: ClassVar[int] = 6
    words: ClassVar[str] = "a GNSS velocity"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"ground speed", "course"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("velocity.east", "m/s", "of the antenna"),
        Quantity("velocity.north", "m/s", "of the antenna"),
    )
    components: ClassVar[tuple[Component, ...]] = (
        Component("east", "GNSS velocity to the east", "m/s"),
        Component("north", "GNSS velocity to the north", "m/s"),
    )
    signals: ClassVar[tuple[ComparedSignal, ...]] = (
        ComparedSignal("ground_speed", "m/s", _ground_speed, 0.03),
        ComparedSignal("course", "rad", _course, 0.003, drifting=True),
        # Side slip is lost in the course, which is a hundred times larger and of which a good model misses some
        # percent.
        ComparedSignal("side_slip", "rad", _course, 0.002, drifting=True, turning=True),
    )
    awaited: ClassVar[float] = 1.0
    sampling: ClassVar[Sampling | None] = Sampling(100, 0, 100, (2**-10,), own_clock=True)
    longest_still: ClassVar[float] = 3.0
    longest_still_if_coarse: ClassVar[float] = 3.0

    kind: Literal["gnss_velocity"] = "gnss_velocity"
    topic: str = "gps/velocity"
    frame_id: str = "map"
    noise: float = parameter("m/s", "standard deviation of east and north", gt=0, default=0.1)
    noise_from_message: NoiseFromMessage = True

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[:] = values["linear"][:2]
        diagonal = covariance_diagonal(values.get("covariance"), 2)
        if self.noise_from_message and diagonal is not None:
            variance[:] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return (motion.attitude @ (motion.velocity + ca.cross(motion.rates, mounting)))[0:2]

    def simulated(self, drive: SimulatedDrive) -> Content:
        horizontal = drive.digitized(disturbed(self, drive))
        covariance = np.zeros(36)
        covariance[: 3 * 7 : 7] = self.noise**2 * np.array([1, 1, 4])
        climb = drive.climb(self.mounting())[:, None]
        up = drive.digitized(climb + 2 * self.noise * drive.rng.standard_normal((len(drive), 1)))
        return Content(
            {
                "linear": np.column_stack([horizontal, up]),
                "angular": np.zeros((len(drive), 3)),
                "covariance": drive.repeated(covariance),
            }
        )

    def first_speed(self, value: Vector, physics: NominalPhysics) -> float | None:
        return float(np.hypot(*value)) if np.isfinite(value).all() else None

    def speeds(self, value: Vector, radii: Vector) -> Vector:
        return self.mean_speed(value, 0.0)

    def mean_speed(self, value: Vector, radius: float) -> Vector:
        return _ground_speed(value, radius)
