"""The signals of a drive that a car is characterised by, on one clock: from a recording, or from a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import find_channel, read_signals
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.coordinates import ROLL, SPEED_X, SPEED_Y, SPIN, STEERING, WHEELS, YAW_RATE
from vsense_ros.model.sensors import Imu, Steering
from vsense_ros.model.simulation.closed_loop import Trajectory
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriveSignalSettings:
    """Settings of the common clock of a drive."""

    step: float = 0.01  # [s] of the clock
    longest_gap: float = 0.3  # [s] between two messages, to interpolate between them


DRIVE_SIGNALS = DriveSignalSettings()


@dataclass(frozen=True)
class DriveSignals:
    """n instants; what a drive does not have is None. `valid` (n,) is where all that is there is known."""

    name: str
    valid: NDArray[np.bool_]
    speed: Array  # [m/s]
    yaw_rate: Array  # [rad/s]
    steering: Array  # [rad] as it was read
    at_steering_wheel: bool  # where that was; else at the road wheels
    spin: Array | None = None  # (n, 4) [rad/s]
    roll: Array | None = None  # of the body [rad]
    lateral_force: Array | None = None  # lateral specific force at cog [m/s²]
    side_slip: Array | None = None  # at cog [rad]
    wheels: Array | None = None  # (n, 7, 4) as model.coordinates.WHEEL_OUTPUTS

    def __len__(self) -> int:
        return len(self.speed)


def reading_over_angle(vehicle: Vehicle, *, at_steering_wheel: bool) -> float:
    """What a steering sensor reads over the mean angle of the front wheels, by the vehicle file."""
    gains = [sensor.gain for sensor in vehicle.sensors.values() if isinstance(sensor, Steering)]
    return (vehicle.physics.steering.ratio if at_steering_wheel else 1.0) / (gains[0] if gains else 1.0)


def of_trajectory(name: str, drive: Trajectory, vehicle: Vehicle) -> DriveSignals:
    """Signals of a simulated drive, whose instants are `DRIVE_SIGNALS.step` apart, without any error."""
    return DriveSignals(
        name,
        np.ones(len(drive.t), dtype=bool),
        drive.u[:, SPEED_X],
        drive.u[:, YAW_RATE],
        reading_over_angle(vehicle, at_steering_wheel=True) * drive.inputs[:, STEERING],
        True,
        drive.u[:, SPIN],
        drive.q[:, ROLL],
        None,
        np.arctan2(drive.u[:, SPEED_Y], drive.u[:, SPEED_X]),
        drive.wheels,
    )


def of_recording(recording: Recording, vehicle: Vehicle | None) -> DriveSignals:
    """Signals of a recording: sensors as they are, speed and side slip from the reference where it has one, else the
    speed by GNSS. The vehicle file gives the mounting of the IMU and the place of the reference.

    Raises `InputError` for a recording without steering, without a speed over ground or without a yaw rate.
    """
    channels: dict[str, tuple[NDArray[np.int64], Array]] = {}
    steering = find_channel(recording, "vehicle/steering")
    if steering is None:
        raise InputError(f"{recording.name}: no topic vehicle/steering; a car is characterised by how it answers that")
    wheel = "steering_wheel" in steering.names
    if not wheel and "road_wheel_front" not in steering.names:
        raise InputError(
            f"{recording.name}: vehicle/steering names {', '.join(steering.names) or 'nothing'}; expected "
            "steering_wheel or road_wheel_front"
        )
    column = steering.names.index("steering_wheel" if wheel else "road_wheel_front")
    channels["steering"] = (steering.stamp, steering.columns["position"][:, column])
    imu = find_channel(recording, "imu/data")
    if imu is not None:
        rates, forces = _in_axes_of_car(imu, vehicle)
        channels["yaw_rate"], channels["lateral_force"] = (imu.stamp, rates[:, 2]), (imu.stamp, forces[:, 1])
    _reference(recording, vehicle, channels)
    if "speed" not in channels:
        gnss = find_channel(recording, "gps/velocity")
        if gnss is None:
            raise InputError(f"{recording.name}: no speed over ground; expected reference/odometry or gps/velocity")
        channels["speed"] = (gnss.stamp, np.hypot(*gnss.columns["linear"][:, :2].T))
    if "yaw_rate" not in channels:
        raise InputError(f"{recording.name}: no yaw rate; expected imu/data or reference/odometry")
    spins = find_channel(recording, "vehicle/wheel_speeds")
    if spins is not None and all(f"wheel_{w}" in spins.names for w in WHEELS):
        for place in WHEELS:
            channels[f"spin_{place}"] = (spins.stamp, spins.columns["velocity"][:, spins.names.index(f"wheel_{place}")])
    start, end = max(s[0] for s, _ in channels.values()), min(s[-1] for s, _ in channels.values())
    clock = np.arange(start, end, round(DRIVE_SIGNALS.step * 1e9), dtype=np.int64)
    if len(clock) < 10 / DRIVE_SIGNALS.step:
        raise InputError(f"{recording.name}: less than 10 s in which steering, speed and yaw rate are all there")
    valid, on_clock = np.ones(len(clock), dtype=bool), {}
    for key, (stamp, value) in channels.items():
        on_clock[key], covered = _resampled(stamp, value, clock)
        valid &= covered
    spin = np.column_stack([on_clock[f"spin_{w}"] for w in WHEELS]) if "spin_fl" in on_clock else None
    return DriveSignals(
        recording.name,
        valid,
        on_clock["speed"],
        on_clock["yaw_rate"],
        on_clock["steering"],
        wheel,
        spin,
        on_clock.get("roll"),
        on_clock.get("lateral_force"),
        on_clock.get("side_slip"),
    )


def _in_axes_of_car(imu: Channel, vehicle: Vehicle | None) -> tuple[Array, Array]:
    """Rates and forces (n, 3) of an IMU, without the known errors where the vehicle file has its mounting."""
    columns = dict(imu.measured)
    mounted = [s for s in vehicle.sensors.values() if isinstance(s, Imu)] if vehicle is not None else []
    if mounted:
        columns |= mounted[0].message_in_axes_of_car(columns)
    return columns["angular_velocity"], columns["linear_acceleration"]


def _reference(
    recording: Recording, vehicle: Vehicle | None, channels: dict[str, tuple[NDArray[np.int64], Array]]
) -> None:
    """Add what the reference knows: speed, yaw rate if there is no gyro, roll, and the side slip at cog."""
    signals = read_signals(recording, "reference")
    if "speed" not in signals:
        return
    stamp = signals["speed"].stamp
    channels["speed"] = (stamp, signals["speed"].value[:, 0])
    if "yaw_rate" not in channels and "yaw_rate" in signals:
        channels["yaw_rate"] = (signals["yaw_rate"].stamp, signals["yaw_rate"].value[:, 0])
    if "roll" in signals and np.ptp(signals["roll"].value) > 0:
        channels["roll"] = (signals["roll"].stamp, signals["roll"].value[:, 0])
    if (
        vehicle is None
        or not {"lateral_velocity", "longitudinal_velocity"} <= set(signals)
        or "yaw_rate" not in channels
    ):
        return
    longitudinal, lateral = (signals[f"{direction}_velocity"] for direction in ("longitudinal", "lateral"))
    if not np.array_equal(longitudinal.stamp, lateral.stamp):
        return
    mounting = vehicle.reference
    turning, value = channels["yaw_rate"]
    finite = np.isfinite(value)
    if not finite.any():
        return
    rate = np.interp(longitudinal.stamp, turning[finite], value[finite])
    cos, sin = np.cos(mounting.yaw), np.sin(mounting.yaw)
    x = cos * longitudinal.value[:, 0] - sin * lateral.value[:, 0] + rate * mounting.position[1]
    y = sin * longitudinal.value[:, 0] + cos * lateral.value[:, 0] - rate * mounting.position[0]
    channels["side_slip"] = (longitudinal.stamp, np.arctan2(y, np.maximum(x, 0.1)))


def _resampled(stamp: NDArray[np.int64], value: Array, clock: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
    """A signal on the clock, and where it is known."""
    good = np.isfinite(value)
    stamp, value = stamp[good], value[good]
    order = np.argsort(stamp, kind="stable")
    stamp, value = stamp[order], value[order]
    if len(stamp) < 2:
        return np.zeros(len(clock)), np.zeros(len(clock), dtype=bool)
    after = np.clip(np.searchsorted(stamp, clock), 1, len(stamp) - 1)
    covered = (stamp[after] - stamp[after - 1]) <= DRIVE_SIGNALS.longest_gap * 1e9
    return np.interp(clock, stamp, value), covered
