"""comma2k19: one minute of highway from the data set of comma.ai (Schafer et al. 2018), a folder of numpy arrays.

What was found in the recordings and is taken care of here:

- `t` is the monotonic clock of the phone. `global_pose/frame_gps_times` has it in GPS time, constant to 1 µs.
- Phone and calibrated gyro have axes forward, right, down; the accelerometer gives specific force in them.
- The u-blox fixes carry their time of measurement as UTC; they arrive 0.18 to 0.24 s later. Their heights are
  ellipsoidal.
- Wheel speeds are in m/s, in the order fl, fr, rl, rr; steering is in degrees, positive left.
- `global_pose` orientations turn device axes into earth-centred axes and are in step with the gyro; its velocities
  are some 45 ms later than the wheel speeds and 70 ms later than the u-blox velocities.
- Of a car whose CAN has no wheel speeds, or a route without `global_pose`, the rest is read: the speed that the car
  states, and a clock by the UTC of the fixes.
- Raw CAN frames are stored as text of at most 8 bytes, which loses trailing zeros. Sources from 128 on are frames
  that the recording device sent itself to bus (source - 128).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array, Stamps
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import WHEELS

NAME = "comma2k19"
DESCRIPTION = "segment folder of comma2k19 (processed_log, global_pose)"

# Rolling circumference of a radial tyre is 3.05 times its diameter (ETRTO); 225/65 R17, the RAV4's size: 0.724 m.
ROLLING_RADIUS = 3.05 * 0.724 / (2 * np.pi)  # [m]

_FIXES = "GNSS/live_gnss_ublox"
_DELAY_OF_FIXES = 0.2  # [s] between measurement and arrival, as in the data set (0.18 to 0.24 s)
_FLIP = np.diag([1.0, -1.0, -1.0])  # forward, right, down ↔ forward, left, up


def matches(path: Path) -> bool:
    """True if `path` is a segment, or a folder with one named `segment`."""
    return any((folder / "processed_log").is_dir() for folder in (path, path / "segment"))


def read(path: Path, *, rolling_radius: float = ROLLING_RADIUS, calibrated_gyro: bool = True) -> Recording:
    """IMU, GNSS, wheel speeds, steering and the reference of a segment.

    `rolling_radius` [m] turns the car's wheel speeds in m/s back into rad/s. `calibrated_gyro=False` takes the gyro
    without the bias that the phone has estimated and removed.
    """
    segment = _segment(path)
    clock = _Clock(segment)
    notes = [*clock.notes]
    channels: dict[str, Channel] = {}

    gyro = "IMU/gyro" if calibrated_gyro else "IMU/gyro_uncalibrated"
    if _has(segment, "IMU/accelerometer") and _has(segment, gyro):
        time, rates = _signal(segment, gyro, 3)
        force_time, force = _signal(segment, "IMU/accelerometer", 3)
        if len(force_time) != len(time) or np.abs(force_time - time).max() > 1e-3:
            force = np.column_stack([np.interp(time, force_time, force[:, axis]) for axis in range(3)])
            notes.append("imu/data: the accelerometer is interpolated to the times of the gyro")
        channels["imu/data"] = build.imu(clock.unix(time), rates @ _FLIP, force @ _FLIP)

    origin: tuple[float, float, float] | None = None
    if _has(segment, _FIXES):
        time, gnss = _signal(segment, _FIXES, 6)
        received = clock.unix(time)
        stamp, stamp_notes = _measured(gnss[:, 3], received)
        notes += stamp_notes
        channels["gps/fix"] = build.fix(stamp, gnss[:, 0], gnss[:, 1], gnss[:, 4], received=received)
        enu = build.course_velocity(gnss[:, 2], np.radians(gnss[:, 5]))
        channels["gps/velocity"] = build.velocity(stamp, enu, received=received)
        origin = (float(gnss[0, 0]), float(gnss[0, 1]), float(gnss[0, 4]))

    if _has(segment, "CAN/wheel_speed"):
        time, speeds = _signal(segment, "CAN/wheel_speed", 4)
        wheels = {f"wheel_{wheel}": speeds[:, i] / rolling_radius for i, wheel in enumerate(WHEELS)}
        topic = "vehicle/wheel_speeds"
        channels[topic] = build.joints(topic, clock.unix(time), "velocity", wheels)
        notes.append(f"{topic}: the car gives m/s; divided by a rolling radius of {rolling_radius:.4f} m")
    elif _has(segment, "CAN/speed"):
        time, speed = _signal(segment, "CAN/speed", 1)
        absent = np.full(len(time), np.nan)
        velocity = np.column_stack([speed[:, 0], absent, absent])
        channels["vehicle/velocity"] = build.body_velocity(clock.unix(time), velocity)
    if _has(segment, "CAN/steering_angle"):
        time, angle = _signal(segment, "CAN/steering_angle", 1)
        topic = "vehicle/steering"
        steering = {"steering_wheel": np.radians(angle[:, 0])}
        channels[topic] = build.joints(topic, clock.unix(time), "position", steering)

    metadata: dict[str, str] = {"source": NAME, "wheel_rolling_radius_m": repr(float(rolling_radius))}
    if not channels:
        raise InputError(f"{segment / 'processed_log'}: none of IMU, GNSS and CAN in it that is read")
    if (segment / "global_pose" / "frame_positions").exists():
        reference, mounting, used_origin = _reference(segment, clock, origin)
        channels["reference/odometry"] = reference
        metadata |= build.origin_metadata(used_origin)
        metadata |= {
            "imu_mount_yaw_rad": repr(float(mounting[0])),
            "imu_mount_pitch_rad": repr(float(mounting[1])),
        }
        notes.append(
            "reference/odometry: the reference point is the phone behind the windscreen, not the centre of gravity; "
            "the angular velocity is the orientation differentiated over 0.1 s (central difference); the phone looks "
            f"{np.degrees(mounting[0]):.2f}° to the left of and {np.degrees(mounting[1]):.2f}° below the direction of "
            "travel on average, which is taken out of the reference but not of imu/data; its roll is unknown"
        )
    return Recording(channels, path.resolve().name, tuple(notes), 0, metadata)


def write_can_log(source: str | Path, path: str | Path, *, database: str | Path | None = None) -> int:
    """Write all raw CAN frames of a segment as a candump log; returns their number.

    Bus n is channel `can<n>`; frames that the recording device itself sent are marked as transmitted. Bytes that the
    recording has lost (trailing zeros) are restored to the length that `database` (default: a DBC file next to
    the segment) gives the frame on bus 0, and to 8 bytes otherwise.
    """
    import can
    import cantools

    segment = _segment(Path(source))
    address, data, bus = (_load(segment, f"processed_log/CAN/raw_can/{name}") for name in ("address", "data", "src"))
    stamp = _Clock(segment).unix(_load(segment, "processed_log/CAN/raw_can/t").astype(np.float64))
    if database is None:
        database = next(iter(sorted([*segment.glob("*.dbc"), *segment.parent.glob("*.dbc")])), None)
    lengths: dict[int, int] = {}
    if database is not None:
        known = cantools.database.load_file(database, strict=False)
        lengths = {message.frame_id: message.length for message in known.messages}
    with can.CanutilsLogWriter(str(path)) as writer:
        rows = zip(stamp.tolist(), address.tolist(), data.tolist(), bus.tolist(), strict=True)
        for time, identifier, payload, source_bus in rows:
            line = source_bus % 128
            length = max(lengths.get(identifier, 8) if line == 0 else 8, len(payload))
            writer.on_message_received(
                can.Message(
                    timestamp=time * 1e-9,
                    arbitration_id=identifier,
                    is_extended_id=identifier > 0x7FF,
                    data=payload.ljust(length, b"\0"),
                    channel=f"can{line}",
                    is_rx=source_bus < 128,
                )
            )
    return len(stamp)


class _Clock:
    """Phone time to Unix time."""

    def __init__(self, segment: Path) -> None:
        if not (segment / "global_pose").exists() and any((segment / "processed_log").iterdir()):
            self._by_fixes(segment)
            return
        phone = _load(segment, "global_pose/frame_times").astype(np.float64)
        gps = _load(segment, "global_pose/frame_gps_times").astype(np.float64)
        if len(phone) == 0 or gps.shape != (len(phone), 2):
            raise InputError(
                f"{segment / 'global_pose'}: frame_times has shape {phone.shape} and frame_gps_times {gps.shape}; "
                "expected (n,) and (n, 2), GPS week and seconds"
            )
        self._phone = float(np.floor(phone[0]))
        seconds = gps[:, 0] * build.WEEK + gps[:, 1]
        whole = float(np.floor(seconds[0]))
        differences = (seconds - whole) - (phone - self._phone)
        leap = build.gps_minus_utc(whole + build.GPS_EPOCH - 18)
        base = int(whole) + build.GPS_EPOCH - leap
        self._base = base * 1_000_000_000 + round(float(np.median(differences)) * 1e9)
        spread = float(np.ptp(differences))
        self.notes = [f"clock: phone time and GPS time drift apart by {spread:.4f} s"] if spread > 1e-3 else []

    def _by_fixes(self, segment: Path) -> None:
        """The clock by the UTC of the fixes, which arrive some time after their measurement."""
        if not _has(segment, _FIXES):
            self._phone, self._base = 0.0, 0
            self.notes = ["clock: neither global_pose nor fixes say the date; times count from 1970"]
            return
        phone, gnss = _signal(segment, _FIXES, 6)
        self._phone = float(np.floor(phone[0]))
        utc = np.rint(gnss[:, 3]).astype(np.int64) * 1_000_000
        ahead = np.median(utc - utc[0] - (phone - self._phone) * 1e9)
        self._base = int(utc[0]) + round(float(ahead) + _DELAY_OF_FIXES * 1e9)
        self.notes = [
            f"clock: no global_pose; by the UTC of the fixes, which are taken to arrive {_DELAY_OF_FIXES} s after it"
        ]

    def unix(self, phone: Array) -> Stamps:
        """Unix time [ns] of phone times [s]."""
        return build.nanoseconds(phone - self._phone, self._base)


def _measured(utc_ms: Array, received: Stamps) -> tuple[Stamps, list[str]]:
    """Time of measurement of GNSS fixes: their own UTC if it lies shortly before their arrival."""
    stamp = np.rint(utc_ms).astype(np.int64) * 1_000_000
    latency = (received - stamp) * 1e-9
    low, median, high = np.percentile(latency, [0, 50, 100])
    if low < -0.05 or high > 1.0:
        return received, [
            f"gps/*: the receiver's UTC is {low:.3f} to {high:.3f} s before arrival, expected 0 to 1 s; "
            "the time of arrival is used as time of measurement"
        ]
    return stamp, [f"gps/*: fixes arrive {low:.3f} to {high:.3f} s (median {median:.3f} s) after their measurement"]


def _reference(
    segment: Path, clock: _Clock, origin: tuple[float, float, float] | None
) -> tuple[Channel, tuple[float, float], tuple[float, float, float]]:
    """`reference/odometry`, the phone's mounting (yaw, pitch) [rad, ISO 8855], and the origin of `map`."""
    stamp = clock.unix(_load(segment, "global_pose/frame_times").astype(np.float64))
    position, velocity, quaternion = (
        _load(segment, f"global_pose/frame_{name}").astype(np.float64)
        for name in ("positions", "velocities", "orientations")
    )
    if origin is None:
        latitude, longitude, height = pymap3d.ecef2geodetic(*position[0])
        origin = (float(latitude), float(longitude), float(height))
    device = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]) * Rotation.from_matrix(_FLIP)  # earth from device, ISO
    seconds = (stamp - stamp[0]) * 1e-9
    mounting, yaw_pitch = _mounting(device.inv().apply(velocity), _body_rates(device, seconds))
    enu_from_earth = Rotation.from_matrix(_enu_from_ecef(origin[0], origin[1]))
    body = device * mounting
    twist_rates = _body_rates(body, seconds)
    columns = {
        "position": np.column_stack(pymap3d.ecef2enu(*position.T, *origin)),
        "orientation": (enu_from_earth * body).as_quat(),
        "linear": body.inv().apply(velocity),
        "angular": twist_rates,
    }
    return build.channel("reference/odometry", stamp, columns), yaw_pitch, origin


def _mounting(velocity: Array, rates: Array) -> tuple[Rotation, tuple[float, float]]:
    """Rotation from vehicle to device axes, from the mean direction of travel in device axes when driving straight.

    Yaw is the direction of travel; pitch likewise, which assumes that the car rides level on average. Roll shows in
    neither and is taken as zero.
    """
    straight = (velocity[:, 0] > 5.0) & (np.abs(rates[:, 2]) < np.radians(1.0))
    if not straight.any():
        return Rotation.identity(), (0.0, 0.0)
    forward = velocity[straight].mean(axis=0)
    yaw = -float(np.arctan2(forward[1], np.hypot(forward[0], forward[2])))  # of the device in the vehicle
    pitch = float(np.arctan2(forward[2], forward[0]))  # about y (left): positive is nose down
    return Rotation.from_euler("ZY", [yaw, pitch]).inv(), (yaw, pitch)


def _body_rates(orientation: Rotation, seconds: Array) -> Array:
    """Angular velocity (n, 3) [rad/s] in body axes by central differences (one-sided at both ends)."""
    index = np.arange(len(seconds))
    before, after = np.maximum(index - 1, 0), np.minimum(index + 1, len(seconds) - 1)
    turned = (orientation[before].inv() * orientation[after]).as_rotvec()
    return turned / (seconds[after] - seconds[before])[:, None]


def _enu_from_ecef(latitude: float, longitude: float) -> Array:
    return np.column_stack([pymap3d.ecef2enuv(*axis, latitude, longitude) for axis in np.eye(3)])


def _segment(path: Path) -> Path:
    for folder in (path, path / "segment"):
        if (folder / "processed_log").is_dir():
            return folder
    raise InputError(f"{path}: no comma2k19 segment: expected the folders processed_log and global_pose in it")


def _has(segment: Path, name: str) -> bool:
    return (segment / "processed_log" / name / "value").exists()


def _load(segment: Path, name: str) -> NDArray:
    file = segment / name
    try:
        return np.load(file, allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"{file}: missing; a comma2k19 segment has it") from None
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{file}: not a numpy array: {error}") from None


def _signal(segment: Path, name: str, width: int) -> tuple[Array, Array]:
    """Times (n,) [s] and values (n, width) of a signal of the processed log."""
    time = _load(segment, f"processed_log/{name}/t").astype(np.float64)
    value = _load(segment, f"processed_log/{name}/value").astype(np.float64).reshape(len(time), -1)
    if len(time) == 0 or value.shape[1] != width:
        raise InputError(f"{segment / 'processed_log' / name}: shape {value.shape}, expected (n > 0, {width})")
    return time, value
