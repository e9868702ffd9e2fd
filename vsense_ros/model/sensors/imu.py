"""Inertial measurement unit: body rates and specific force at a mounting point and attitude."""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar, Literal

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.model import spatial
from vsense_ros.model.coordinates import YAW_RATE
from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import Triple, parameter
from vsense_ros.model.sensors.base import (
    Attitude,
    Bias,
    ComparedSignal,
    Component,
    Deviations,
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
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive

RATES, FORCES = slice(0, 3), slice(3, 6)  # of the components


class Imu(SensorBase):
    """Three gyros [rad/s] and three accelerometers [m/s²]; any of the six may be absent (NaN)."""

    message: ClassVar[str] = "sensor_msgs/msg/Imu"
    place: ClassVar[int] = 1
    words: ClassVar[str] = "inertial measurements"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"rates and forces"})
    quantities: ClassVar[tuple[Quantity, ...]] = (
        *(Quantity(f"angular_velocity.{a}", "rad/s", f"about the sensor's {a} axis") for a in "xyz"),
        *(Quantity(f"linear_acceleration.{a}", "m/s2", f"specific force along the sensor's {a} axis") for a in "xyz"),
    )
    components: ClassVar[tuple[Component, ...]] = (
        *(Component(name, name, "rad/s") for name in ("roll rate", "pitch rate", "yaw rate")),
        *(Component(name, f"{name} acceleration", "m/s²") for name in ("longitudinal", "lateral", "vertical")),
    )
    signals: ClassVar[tuple[ComparedSignal, ...]] = (
        ComparedSignal("longitudinal_acceleration", "m/s²", component(3), 0.05),
        ComparedSignal("lateral_acceleration", "m/s²", component(4), 0.05),
        ComparedSignal("vertical_acceleration", "m/s²", component(5), 0.1, shaken=True),
        ComparedSignal("roll_rate", "rad/s", component(0), 0.004, shaken=True),
        ComparedSignal("pitch_rate", "rad/s", component(1), 0.004, shaken=True),
        ComparedSignal("yaw_rate", "rad/s", component(2), 0.002),
    )
    uses_acceleration: ClassVar[bool] = True
    sampling: ClassVar[Sampling | None] = Sampling(4, 0, 1, (2**-12,) * 3 + (2**-9,) * 3)
    noisy: ClassVar[bool] = True
    longest_still: ClassVar[float] = 1.0
    saturates: ClassVar[bool] = True
    noise_fields: ClassVar[Names] = ("rate_noise", "force_noise")
    # What a driver states is the sensor's own noise; on a car it is shaken besides.
    least_stated: ClassVar[float] = 1.0

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
        "1/(m/s²)", "additional reading of each accelerometer per square of the specific force along it",
        default=(0.0, 0.0, 0.0),
    )  # fmt: skip
    force_odd_square: Triple = parameter(
        "1/(m/s²)", "the same per square with the sign of the force: less than 0 where its range is compressed",
        default=(0.0, 0.0, 0.0),
    )  # fmt: skip
    rate_by_force: tuple[Triple, Triple, Triple] = parameter(
        "rad/s/(m/s²)", "reading of each gyro (row) per specific force along x, y and z",
        default=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    )  # fmt: skip
    roll_gain: float = parameter(
        "-", "roll of the sensor beyond the body's, per roll of the body; -1: its values are corrected for roll",
        default=0.0,
    )  # fmt: skip
    rate_latency: float = parameter(
        "s", "how much older the gyros' values are than `latency` says; for comparisons alone", ge=-5, le=5, default=0.0
    )
    force_latency: float = parameter(
        "s",
        "how much older the values of the accelerometers are than `latency` states; for comparisons only",
        ge=-5,
        le=5,
        default=0.0,
    )
    rate_bias: float = parameter(
        "rad/s", "standard deviation of the rest of the gyro bias at start", ge=0, default=0.01
    )
    rate_bias_drift: float = parameter("rad/s", "change of the gyro bias in one second", ge=0, default=1e-5)
    force_bias: float = parameter("m/s²", "standard deviation of the rest of the bias at start", ge=0, default=0.1)
    force_bias_drift: float = parameter("m/s²", "change of the bias in one second", ge=0, default=1e-4)

    def biases(self) -> tuple[Bias, ...]:
        rate, force = (self.rate_bias, self.rate_bias_drift), (self.force_bias, self.force_bias_drift)
        rates = tuple(Bias(f"gyro_bias_{axis}", *rate, unit="rad/s") for axis in "xyz")
        forces = tuple(Bias(f"accelerometer_bias_{axis}", *force, unit="m/s²") for axis in "xyz")
        return rates + forces

    def mounting(self) -> Vector:
        lever = [*self.position, *self.attitude, *self.rate_scale, self.roll_gain]
        force = [*self.force_scale, *self.force_square, *self.force_odd_square]
        return np.array([*lever, *force, *np.ravel(self.rate_by_force)])

    def deviations(self) -> Vector:
        return np.array([*self.rate_noise, *self.force_noise])

    def offsets(self) -> Vector:
        return np.array([*self.rate_offset, *self.force_offset])

    def ages(self) -> Vector:
        return np.repeat([self.latency + self.rate_latency, self.latency + self.force_latency], 3)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[RATES] = values["angular_velocity"]
        out[FORCES] = values["linear_acceleration"]
        for part, field in _COVARIANCES:
            flat = values.get(field)
            if flat is None:
                continue
            diagonal = covariance_diagonal(flat, 3)
            if diagonal is None:
                if len(flat) and flat[0] == -1:
                    out[part] = np.nan
            elif self.noise_from_message:
                variance[part] = diagonal

    def read_rows(self, names: Names, columns: Values, out: Vector, variance: Vector) -> None:
        covariances = [(part, columns[field]) for part, field in _COVARIANCES if field in columns]
        if not all((stated == stated[0]).all() for _, stated in covariances):
            super().read_rows(names, columns, out, variance)
            return
        self.read(names, {field: column[0] for field, column in columns.items()}, out[0], variance[0])
        variance[:] = variance[0]
        out[:, RATES], out[:, FORCES] = columns["angular_velocity"], columns["linear_acceleration"]
        for part, stated in covariances:
            if stated.shape[1] and stated[0, 0] == -1:
                out[:, part] = np.nan

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return equation(motion, biases, mounting)

    def simulated(self, drive: SimulatedDrive) -> Content:
        value = drive.digitized(disturbed(self, drive))
        rate, force = np.diag(np.square(self.rate_noise)).ravel(), np.diag(np.square(self.force_noise)).ravel()
        return Content(
            {
                "orientation": drive.repeated([0, 0, 0, 1]),
                "orientation_covariance": drive.repeated([-1, *[0] * 8]),  # there is no orientation
                "angular_velocity": value[:, RATES],
                "angular_velocity_covariance": drive.repeated(rate),
                "linear_acceleration": value[:, FORCES],
                "linear_acceleration_covariance": drive.repeated(force),
            }
        )

    def first_velocities(self, value: Vector) -> dict[int, float]:
        return {YAW_RATE: float(value[2])} if np.isfinite(value[2]) else {}

    def in_axes_of_car(self, value: Vector) -> Vector:
        if not any(self.attitude):
            return value
        return np.hstack([self._turned(value[:, part]) for part in (RATES, FORCES)])

    def message_in_axes_of_car(self, columns: Values) -> dict[str, Vector]:
        if not any(self.attitude):
            return {}
        return {field: self._turned(columns[field]) for field in ("angular_velocity", "linear_acceleration")}

    def _turned(self, vectors: Vector) -> Vector:
        """Vectors (n, 3) in the axes of the sensor in those of the car. Of a component that is absent (NaN) the car's
        component of which it is the largest part is absent as well; to the others it adds nothing."""
        turn, largest = _to_axes_of_car(*self.attitude)
        absent = np.isnan(vectors)
        turned = np.where(absent, 0.0, vectors) @ turn.T
        turned[absent[:, largest]] = np.nan
        return np.asarray(turned)


@lru_cache(maxsize=64)
def _to_axes_of_car(roll: float, pitch: float, yaw: float) -> tuple[Vector, list[int]]:
    """What turns vectors (3) in the axes of a sensor with this attitude [rad] into those of the car, (3, 3); and of
    which of these each of the car's is for the most part."""
    turn = np.asarray(Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix())
    return turn, np.argmax(np.abs(turn), axis=1).tolist()


_COVARIANCES = (
    (RATES, "angular_velocity_covariance"),
    (FORCES, "linear_acceleration_covariance"),
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
    rates, turning = motion.rates, motion.angular_acceleration
    acceleration = motion.acceleration + ca.cross(turning, arm) + ca.cross(rates, ca.cross(rates, arm))
    leaning = spatial.rotation_x(roll_gain * motion.roll).T
    force = to_sensor @ leaning @ (acceleration - motion.gravity)
    gyro_reading = (1 + scale) * (to_sensor @ rates) + by_force @ force
    return ca.vertcat(gyro_reading, (1 + force_scale + square * force + odd_square * ca.fabs(force)) * force) + biases
