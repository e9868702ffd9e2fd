"""Roll and pitch from GNSS antennas: how a base line between two of them slopes."""

from __future__ import annotations

from typing import ClassVar, Literal

import casadi as ca
import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    Bias,
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
from vsense_ros.model.sensors.gnss import Receiver, orientation_in, orientation_message
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive


class GnssTilt(Receiver):
    """Roll and pitch of the body over the horizon [rad], of body and road together (Leung 2010, section 4.5).

    A base line from the rear to the front slopes by the pitch, one from side to side by the roll. What the car does not
    have is absent, as is what a message states with a variance of `unmeasured` or more.

    It may listen to the same messages as a `gnss_attitude`. In a simulation it needs a topic of its own.
    """

    message: ClassVar[str] = "sensor_msgs/msg/Imu"
    place: ClassVar[int] = 9
    words: ClassVar[str] = "the slope of a GNSS base line"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"tilt"})
    components: ClassVar[tuple[Component, ...]] = (
        Component("roll", "roll of a base line", "rad"),
        Component("pitch", "pitch of a base line", "rad"),
    )
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("tilt.roll", "rad", "roll of body and road, positive to the right"),
        Quantity("tilt.pitch", "rad", "pitch of body and road, positive where the front goes down"),
    )
    unmeasured: ClassVar[float] = 1.0  # [rad²] of an angle that could be any
    sampling: ClassVar[Sampling | None] = Sampling(100, 0, 100, (2**-20,), own_clock=True)

    kind: Literal["gnss_tilt"] = "gnss_tilt"
    topic: str = "gps/attitude"
    frame_id: str = "gnss_link"
    base_lines: Literal["along", "across", "both"] = Field(
        default="both", description="how the antennas stand: one behind the other (pitch), side by side (roll), both"
    )
    noise: float = parameter("rad", "standard deviation of an angle", gt=0, default=0.005)
    noise_from_message: NoiseFromMessage = True
    slow_error: float = parameter(
        "rad", "standard deviation of an angle's constant error, of antennas at different heights", ge=0, default=0.01
    )

    def biases(self) -> tuple[Bias, ...]:
        return tuple(Bias(name, self.slow_error, 0.0, unit="rad") for name in ("roll", "pitch"))

    def deviations(self) -> Vector:
        return np.full(2, self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        orientation = orientation_in(values)
        if orientation is None:
            out[:] = np.nan
            return
        x, y, z, w = orientation
        out[0] = np.arcsin(np.clip(2 * (y * z + w * x), -1, 1))
        out[1] = np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))
        out[[self.base_lines == "along", self.base_lines == "across"]] = np.nan
        diagonal = covariance_diagonal(values.get("orientation_covariance"), 2)
        if diagonal is not None:
            out[diagonal >= self.unmeasured] = np.nan
            if self.noise_from_message:
                variance[:] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        """The slopes of the base lines: of the body's y axis upwards, and of its x axis downwards."""
        x, y, z = ca.horzsplit(motion.attitude[2, :])
        return ca.vertcat(ca.atan2(y, ca.sqrt(x**2 + z**2)), -ca.atan2(x, ca.sqrt(y**2 + z**2))) + biases

    def simulated(self, drive: SimulatedDrive) -> Content:
        roll, pitch = disturbed(self, drive).T
        turned = Rotation.from_euler("ZYX", np.column_stack([0 * roll, pitch, np.arcsin(np.sin(roll) / np.cos(pitch))]))
        return orientation_message(drive, turned.as_quat(), (self.noise**2, self.noise**2, 1e6))
