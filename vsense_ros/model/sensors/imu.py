"""Inertial measurement unit: body rates and specific force at a mounting point and attitude."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model import spatial
from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import (
    Attitude,
    Bias,
    Deviations,
    Names,
    NoiseFromMessage,
    Position,
    SensorBase,
    Triple,
    Values,
    Vector,
    covariance_diagonal,
)

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Motion


class Imu(SensorBase):
    """Three gyros [rad/s] and three accelerometers [m/s²]; any of the six may be absent (NaN)."""

    message: ClassVar[str] = "sensor_msgs/msg/Imu"
    uses_acceleration: ClassVar[bool] = True

    kind: Literal["imu"] = "imu"
    topic: str = "imu/data"
    frame_id: str = "imu_link"
    position: Position = parameter("m", "mounting point in the axes of cog", default=(0.0, 0.0, 0.0))
    attitude: Attitude = parameter("rad", "roll, pitch and yaw of imu_link in cog", default=(0.0, 0.0, 0.0))
    rate_noise: Deviations = parameter("rad/s", "standard deviation of each gyro", default=(0.003, 0.003, 0.003))
    force_noise: Deviations = parameter("m/s²", "standard deviation of each accelerometer", default=(0.1, 0.1, 0.2))
    noise_from_message: NoiseFromMessage = True
    rate_offset: Triple = parameter("rad/s", "known bias of each gyro", default=(0.0, 0.0, 0.0))
    force_offset: Triple = parameter("m/s²", "known bias of each accelerometer", default=(0.0, 0.0, 0.0))
    rate_scale: Triple = parameter("-", "known relative error of each gyro's scale", default=(0.0, 0.0, 0.0))
    force_scale: Triple = parameter("-", "known relative error of each accelerometer's scale", default=(0.0, 0.0, 0.0))
    force_square: Triple = parameter(
        "1/(m/s²)", "what each accelerometer reads besides, per square of the specific force along it",
        default=(0.0, 0.0, 0.0),
    )  # fmt: skip
    force_odd_square: Triple = parameter(
        "1/(m/s²)", "the same per square with the sign of the force: less than 0 where its range is compressed",
        default=(0.0, 0.0, 0.0),
    )  # fmt: skip
    rate_by_force: tuple[Triple, Triple, Triple] = parameter(
        "rad/s/(m/s²)", "what each gyro, a row, reads per specific force along x, y and z",
        default=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    )  # fmt: skip
    roll_gain: float = parameter(
        "-", "roll of the sensor beyond the body's, per roll of the body; -1: its values are corrected for roll",
        default=0.0,
    )  # fmt: skip
    rate_bias: float = parameter(
        "rad/s", "standard deviation of the rest of the gyro bias at start", ge=0, default=0.01
    )
    rate_bias_drift: float = parameter("rad/s", "change of the gyro bias in one second", ge=0, default=1e-5)
    force_bias: float = parameter("m/s²", "standard deviation of the rest of the bias at start", ge=0, default=0.1)
    force_bias_drift: float = parameter("m/s²", "change of the bias in one second", ge=0, default=1e-4)

    def biases(self) -> tuple[Bias, ...]:
        rates = tuple(Bias(f"gyro_bias_{axis}", self.rate_bias, self.rate_bias_drift) for axis in "xyz")
        forces = tuple(Bias(f"accelerometer_bias_{axis}", self.force_bias, self.force_bias_drift) for axis in "xyz")
        return rates + forces

    def mounting(self) -> Vector:
        lever = [*self.position, *self.attitude, *self.rate_scale, self.roll_gain]
        force = [*self.force_scale, *self.force_square, *self.force_odd_square]
        return np.array([*lever, *force, *np.ravel(self.rate_by_force)])

    def deviations(self) -> Vector:
        return np.array([*self.rate_noise, *self.force_noise])

    def offsets(self) -> Vector:
        return np.array([*self.rate_offset, *self.force_offset])

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[:3] = values["angular_velocity"]
        out[3:] = values["linear_acceleration"]
        for part, field in _COVARIANCES:
            flat = values.get(field)
            if flat is None or not len(flat):
                continue
            if flat[0] == -1:
                out[part] = np.nan
            diagonal = covariance_diagonal(flat, 3)
            if self.noise_from_message and diagonal is not None:
                variance[part] = diagonal

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return equation(motion, biases, mounting)


_COVARIANCES = (
    (slice(0, 3), "angular_velocity_covariance"),
    (slice(3, 6), "linear_acceleration_covariance"),
)


def equation(motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
    """Rates and specific force in `imu_link`, 6×1: the lever arm adds the tangential and centripetal parts; what the
    sensor leans beyond the body is about the body's x axis, whatever its own. Scale and squares of accelerometers are
    K1, K2 and Kqq of the model equation in IEEE Std 1293; what a gyro feels of forces is the acceleration-sensitive
    drift of IEEE Std 528."""
    arm, scale, roll_gain = mounting[0:3], mounting[6:9], mounting[9]
    force_scale, square, odd_square = mounting[10:13], mounting[13:16], mounting[16:19]
    by_force = ca.reshape(mounting[19:28], 3, 3).T
    to_sensor = spatial.rotation_rpy(mounting[3], mounting[4], mounting[5]).T
    velocity, rates = motion.u[0:3], motion.u[3:6]
    acceleration = motion.udot[0:3] + ca.cross(rates, velocity)
    acceleration = acceleration + ca.cross(motion.udot[3:6], arm) + ca.cross(rates, ca.cross(rates, arm))
    leaning = spatial.rotation_x(roll_gain * motion.roll).T
    force = to_sensor @ leaning @ (acceleration - motion.gravity)
    read = (1 + scale) * (to_sensor @ rates) + by_force @ force
    return ca.vertcat(read, (1 + force_scale + square * force + odd_square * ca.fabs(force)) * force) + biases
