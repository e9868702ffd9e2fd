"""From a simulated motion to what the sensors of the car would have recorded.

Sensors are those of the vehicle file: the same equations that the observer uses, plus white noise and constant biases
of the standard deviations that the file states, sampled, quantized and delayed as real ones are.

Reproducible bits. Noise comes from NumPy's `RandomState`, whose stream is frozen for good (NEP 19; the stream of its
successor may change between versions). Everything that is written is rounded to a multiple of a power of two that is
far above rounding errors and far below the noise, so that another compiler, processor or linear algebra, whose results
differ in the last bits, still gives the same file, except where a value comes to lie on the very edge of a step. That
is improbable for any one bag (about one in a hundred), and shows as one step of quantization.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import pi

import numpy as np
import pymap3d

from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import sensor_functions
from vsense_ros.model.coordinates import (
    ATTITUDE,
    DISTURBANCES,
    MOMENT,
    POSITION,
    RATES,
    STEERING,
    TORQUES,
    VELOCITY,
    WHEEL_FORCES,
    WHEELS,
    Z,
)
from vsense_ros.model.sensors import (
    GnssPosition,
    GnssVelocity,
    Imu,
    SensorBase,
    Steering,
    Suspension,
    WheelSpeeds,
    WheelTorques,
)
from vsense_ros.model.simulation.closed_loop import Array, Trajectory
from vsense_ros.model.vehicle import Vehicle

EPOCH = 1_593_043_200_000_000_000  # [ns] 2020-06-25 00:00 UTC: a recording is always made at the same time
ORIGIN = (43.5, -8.2, 50.0)  # latitude, longitude [deg], height [m] of the map's origin

# Steering wheel (Leung 2010, table B.1); as an input of the model the sensor has no noise in the vehicle file.
STEERING_NOISE = 1.0 * pi / 180
STEERING_BIAS = 5.0 * pi / 180

REFERENCE_PERIOD = 10  # [ms]


@dataclass(frozen=True)
class _Sampling:
    """When a sensor measures and when its message arrives, all in ms; steps of its values."""

    period: int
    phase: int  # of the first measurement
    delay: int  # until arrival
    quantum: tuple[float, ...]  # of each component; one for all if single


_SAMPLING: Mapping[str, _Sampling] = {
    "imu": _Sampling(4, 0, 1, (2**-12,) * 3 + (2**-9,) * 3),
    "wheel_speeds": _Sampling(10, 1, 2, (2**-6,)),
    "steering": _Sampling(10, 2, 2, (2**-10,)),
    "suspension": _Sampling(10, 3, 2, (2**-13,)),
    "wheel_torques": _Sampling(10, 2, 2, (2**-4,)),
    "gnss_position": _Sampling(100, 0, 100, (2**-27, 2**-27, 2**-10)),  # latitude, longitude [deg], height [m]
    "gnss_velocity": _Sampling(100, 0, 100, (2**-10,)),
}


def record(
    trajectory: Trajectory,
    vehicle: Vehicle,
    seed: int,
    *,
    name: str,
    about: str = "",
    biased: bool = True,
    every: int | None = None,
) -> Recording:
    """Messages of the vehicle's sensors on a trajectory with steps of 1 ms, and the truth below `reference/`.

    `biased=False` leaves the constant errors out. With `every` [ms] all sensors of the car itself measure at the same
    instants, instead of each at its own. A sensor of another kind (a second antenna) gives nothing; torques are told
    as they are.
    """
    rng = np.random.RandomState(seed)
    channels = []
    measuring = _Measuring(trajectory, vehicle, rng, float(biased), every)
    for sensor in vehicle.sensing().values():
        if sensor.kind in _MESSAGES:
            channels.append(_MESSAGES[sensor.kind](sensor, measuring))
    channels += _reference(trajectory)
    latitude, longitude, height = ORIGIN
    return Recording(
        {c.topic: c for c in channels},
        name=name,
        metadata={
            "origin_latitude_deg": f"{latitude}",
            "origin_longitude_deg": f"{longitude}",
            "origin_altitude_m": f"{height}",
            "vehicle": vehicle.name,
            "manoeuvre": about,
            "seed": f"{seed}",
        },
    )


def quantized(value: Array, quantum: Array | float) -> Array:
    """Nearest multiple of a power of two, exact in binary."""
    return np.rint(value / quantum) * quantum + 0.0  # no negative zeros


@dataclass(frozen=True)
class _Measuring:
    """A trajectory as the sensors of a car see it."""

    trajectory: Trajectory
    vehicle: Vehicle
    rng: np.random.RandomState
    bias: float  # 1, or 0 for sensors without biases
    every: int | None  # [ms] between measurements of all sensors but GNSS; None: each has its own times

    def sampling(self, sensor: SensorBase) -> _Sampling:
        """When a sensor measures."""
        usual = _SAMPLING[sensor.kind]
        if self.every is None or sensor.kind.startswith("gnss"):
            return usual
        return replace(usual, period=self.every, phase=0)

    def rows(self, sampling: _Sampling) -> np.ndarray:
        """Instants of the trajectory at which a sensor measures."""
        return np.arange(sampling.phase, len(self.trajectory.t), sampling.period)

    def truth(self, sensor: SensorBase, rows: np.ndarray) -> Array:
        """What a perfect sensor would measure, (rows, m)."""
        motion = self.trajectory
        function = sensor_functions(car_of(self.vehicle), (sensor,))[sensor.kind].map(len(rows))
        around = np.zeros((len(DISTURBANCES), 1)) if motion.disturbances is None else motion.disturbances[rows].T
        biases, mounting = np.zeros((len(sensor.biases()), 1)), np.asarray(sensor.mounting(), dtype=float)[:, None]
        arguments = [motion.q[rows].T, motion.u[rows].T, motion.udot[rows].T, around, motion.inputs[rows].T]
        result = function(*arguments, biases, mounting)[0]
        return np.array(result).reshape(-1, len(rows), order="F").T

    def noisy(self, sensor: SensorBase, rows: np.ndarray) -> Array:
        """With the bias and the noise that the vehicle file states, and the known errors that reading takes off."""
        value = self.truth(sensor, rows) + sensor.offsets()
        for i, bias in enumerate(sensor.biases()):
            value[:, i] += self.bias * bias.deviation * self.rng.standard_normal()
        return value + sensor.deviations() * self.rng.standard_normal(value.shape)


def _channel(sensor: SensorBase, rows: np.ndarray, columns: dict[str, Array], names: tuple[str, ...] = ()) -> Channel:
    delay = round((sensor.latency + _SAMPLING[sensor.kind].delay * 1e-3) * 1e9)
    stamp = EPOCH + rows.astype(np.int64) * 1_000_000
    # `latency` is the age of a measurement at its stamp: the stamp is late by as much.
    return Channel(
        sensor.topic,
        sensor.message,
        stamp + round(sensor.latency * 1e9),
        stamp + delay,
        columns,
        sensor.frame_id,
        names,
    )


def _repeated(row: list[float] | Array, count: int) -> Array:
    return np.tile(np.asarray(row, dtype=float), (count, 1))


def _imu(sensor: Imu, m: _Measuring) -> Channel:
    sampling = m.sampling(sensor)
    rows = m.rows(sampling)
    value = quantized(m.noisy(sensor, rows), np.array(sampling.quantum))
    rate, force = np.diag(np.square(sensor.rate_noise)).ravel(), np.diag(np.square(sensor.force_noise)).ravel()
    columns = {
        "orientation": _repeated([0, 0, 0, 1], len(rows)),
        "orientation_covariance": _repeated([-1, *[0] * 8], len(rows)),  # there is no orientation
        "angular_velocity": value[:, :3],
        "angular_velocity_covariance": _repeated(rate, len(rows)),
        "linear_acceleration": value[:, 3:],
        "linear_acceleration_covariance": _repeated(force, len(rows)),
    }
    return _channel(sensor, rows, columns)


def _joints(field: str, prefix: str) -> Callable[[SensorBase, _Measuring], Channel]:
    def messages(sensor: SensorBase, m: _Measuring) -> Channel:
        sampling = m.sampling(sensor)
        rows = m.rows(sampling)
        columns = {name: np.zeros((len(rows), 0)) for name in ("position", "velocity", "effort")}
        columns[field] = quantized(m.noisy(sensor, rows), sampling.quantum[0])
        return _channel(sensor, rows, columns, tuple(f"{prefix}_{wheel}" for wheel in WHEELS))

    return messages


def _steering(sensor: Steering, m: _Measuring) -> Channel:
    sampling = m.sampling(sensor)
    rows = m.rows(sampling)
    ratio = sensor.ratio or m.vehicle.physics.steering.ratio
    angle = ratio * m.trajectory.inputs[rows, STEERING, None] + m.bias * STEERING_BIAS * m.rng.standard_normal()
    angle = angle + STEERING_NOISE * m.rng.standard_normal(angle.shape)
    columns = {"position": quantized(angle, sampling.quantum[0])}
    columns |= {name: np.zeros((len(rows), 0)) for name in ("velocity", "effort")}
    return _channel(sensor, rows, columns, ("steering_wheel",))


def _torques(sensor: WheelTorques, m: _Measuring) -> Channel:
    sampling = m.sampling(sensor)
    rows = m.rows(sampling)
    columns = {"effort": quantized(m.trajectory.inputs[rows, TORQUES], sampling.quantum[0])}
    columns |= {name: np.zeros((len(rows), 0)) for name in ("position", "velocity")}
    return _channel(sensor, rows, columns, tuple(f"wheel_{wheel}" for wheel in WHEELS))


def _position(sensor: GnssPosition, m: _Measuring) -> Channel:
    sampling = m.sampling(sensor)
    rows = m.rows(sampling)
    east, north = m.noisy(sensor, rows).T
    height = m.trajectory.q[rows, Z] + sensor.position[2] + 2 * sensor.noise * m.rng.standard_normal(len(rows))
    geodetic = np.column_stack(pymap3d.enu2geodetic(east, north, height, *ORIGIN))
    latitude, longitude, altitude = (
        quantized(column, quantum)[:, None] for column, quantum in zip(geodetic.T, sampling.quantum, strict=True)
    )
    columns = {
        "status": np.zeros((len(rows), 1)),
        "service": np.ones((len(rows), 1)),
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
        "position_covariance": _repeated(np.diag(np.square([1, 1, 2]) * sensor.noise**2).ravel(), len(rows)),
        "position_covariance_type": _repeated([2], len(rows)),  # the diagonal is known
    }
    return _channel(sensor, rows, columns)


def _velocity(sensor: GnssVelocity, m: _Measuring) -> Channel:
    sampling = m.sampling(sensor)
    rows = m.rows(sampling)
    horizontal = quantized(m.noisy(sensor, rows), sampling.quantum[0])
    covariance = np.zeros(36)
    covariance[: 3 * 7 : 7] = sensor.noise**2 * np.array([1, 1, 4])
    up = quantized(2 * sensor.noise * m.rng.standard_normal((len(rows), 1)), sampling.quantum[0])
    columns = {
        "linear": np.column_stack([horizontal, up]),
        "angular": np.zeros((len(rows), 3)),
        "covariance": _repeated(covariance, len(rows)),
    }
    return _channel(sensor, rows, columns)


_MESSAGES: Mapping[str, Callable] = {
    Imu.model_fields["kind"].default: _imu,
    WheelSpeeds.model_fields["kind"].default: _joints("velocity", "wheel"),
    Suspension.model_fields["kind"].default: _joints("position", "suspension"),
    Steering.model_fields["kind"].default: _steering,
    WheelTorques.model_fields["kind"].default: _torques,
    GnssPosition.model_fields["kind"].default: _position,
    GnssVelocity.model_fields["kind"].default: _velocity,
}


def _quaternion(roll: Array, pitch: Array, yaw: Array) -> Array:
    """x, y, z, w of z-y-x angles, (n, 4)."""
    sr, cr = np.sin(roll / 2), np.cos(roll / 2)
    sp, cp = np.sin(pitch / 2), np.cos(pitch / 2)
    sy, cy = np.sin(yaw / 2), np.cos(yaw / 2)
    return np.column_stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def _reference(trajectory: Trajectory) -> list[Channel]:
    rows = np.arange(0, len(trajectory.t), REFERENCE_PERIOD)
    stamp = EPOCH + rows.astype(np.int64) * 1_000_000
    q, u = trajectory.q[rows], trajectory.u[rows]
    channels = [
        Channel(
            "reference/odometry",
            "nav_msgs/msg/Odometry",
            stamp,
            stamp,
            {
                "position": quantized(q[:, POSITION], 2**-13),
                "orientation": quantized(_quaternion(*q[:, ATTITUDE].T), 2**-20),
                "pose_covariance": np.zeros((len(rows), 36)),
                "linear": quantized(u[:, VELOCITY], 2**-14),
                "angular": quantized(u[:, RATES], 2**-16),
                "twist_covariance": np.zeros((len(rows), 36)),
            },
            "map",
            child_frame_id="cog",
        ),
        Channel(
            "reference/acceleration",
            "geometry_msgs/msg/AccelStamped",
            stamp,
            stamp,
            {
                "linear": quantized(trajectory.acceleration[rows], 2**-13),
                "angular": quantized(trajectory.udot[rows, RATES], 2**-13),
            },
            "cog",
        ),
    ]
    for i, wheel in enumerate(WHEELS):
        force, moment = (trajectory.wheels[rows, row, i] for row in (WHEEL_FORCES, MOMENT))
        torque = np.column_stack([np.zeros((len(rows), 2)), quantized(moment, 2**-9)])
        channels.append(
            Channel(
                f"reference/wheel_force/{wheel}",
                "geometry_msgs/msg/WrenchStamped",
                stamp,
                stamp,
                {"force": quantized(force, 2**-6), "torque": torque},
                f"contact_{wheel}",
            )
        )
    return channels
