"""Channels from plain arrays: what all importers share.

A component that a source does not have is NaN; a whole field that it does not have is marked absent by
`covariance[0] = -1` where the message has a covariance for it, and left out otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.messages.recording import FIELDS, Channel
from vsense_ros.messages.topics import TOPICS

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

GPS_EPOCH = 315_964_800  # 1980-01-06 in Unix time [s]
WEEK = 604_800  # [s]

# Unix time from which on GPS is ahead of UTC by so many seconds (IERS Bulletin C).
_LEAP_SECONDS = (
    (1_483_228_800, 18),
    (1_435_708_800, 17),
    (1_341_100_800, 16),
    (1_230_768_000, 15),
    (1_136_073_600, 14),
)


def gps_minus_utc(unix: float) -> int:
    """Leap seconds between GPS time and UTC at a Unix time, from 2006 on [s]."""
    return next((leap for since, leap in _LEAP_SECONDS if unix >= since), 13)


def nanoseconds(seconds: Array, base: int = 0) -> Stamps:
    """Times [s] relative to `base` [ns] as integer nanoseconds.

    Whole seconds are converted apart, because a float64 of the size of Unix time resolves 0.2 µs only.
    """
    part = np.floor(seconds)
    stamps = part.astype(np.int64)
    stamps *= 1_000_000_000
    np.subtract(seconds, part, out=part)
    part *= 1e9
    np.rint(part, out=part)
    stamps += part.astype(np.int64)
    stamps += base
    return stamps


def same(rows: int, width: int, first: float = 0.0) -> Array:
    """Rows of zeros, or with another `first` value, that take no memory and cannot be written."""
    row = np.zeros((1, width))
    row[:, :1] = first
    return np.broadcast_to(row, (rows, width))


def channel(
    topic: str,
    stamp: Stamps,
    columns: Mapping[str, Array],
    *,
    received: Stamps | None = None,
    names: Sequence[str] = (),
) -> Channel:
    """A channel of a known topic, with its type and frames. Number fields that `columns` lacks are zero."""
    spec = TOPICS[topic]
    rows = len(stamp)
    widths = FIELDS[spec.kind]
    filled = {
        field: np.asarray(columns[field], np.float64).reshape(rows, -1) if field in columns else same(rows, width)
        for field, width in widths.items()
    }
    return Channel(
        topic,
        spec.kind,
        stamp,
        stamp if received is None else received,
        filled,
        spec.frame_id,
        tuple(names),
        spec.child_frame_id,
    )


def imu(stamp: Stamps, rates: Array, specific_force: Array, *, received: Stamps | None = None) -> Channel:
    """`imu/data` from body rates (n, 3) [rad/s] and specific force (n, 3) [m/s²]; the orientation is absent."""
    absent = same(len(stamp), 9, -1.0)
    columns: dict[str, Array] = {"orientation_covariance": absent}
    for field, values in (("angular_velocity", rates), ("linear_acceleration", specific_force)):
        columns[field] = values
        if np.isnan(values).all():
            columns[field] = same(len(stamp), 3)
            columns[f"{field}_covariance"] = absent
    return channel("imu/data", stamp, columns, received=received)


def fix(
    stamp: Stamps,
    latitude: Array,
    longitude: Array,
    altitude: Array,
    *,
    covariance: Array | None = None,
    received: Stamps | None = None,
) -> Channel:
    """`gps/fix` from degrees and ellipsoidal height [m]; ENU covariance (n, 9) [m²] if known."""
    rows = len(stamp)
    columns = {
        "service": np.ones((rows, 1)),
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
        "status": np.where(np.isnan(latitude), -1.0, 0.0),
    }
    if covariance is not None:
        columns |= {"position_covariance": covariance, "position_covariance_type": np.full((rows, 1), 3.0)}
    return channel("gps/fix", stamp, columns, received=received)


def velocity(stamp: Stamps, enu: Array, *, covariance: Array | None = None, received: Stamps | None = None) -> Channel:
    """`gps/velocity` from ENU velocity (n, 3) [m/s] and its covariance (n, 3, 3) [m²/s²] if known."""
    columns = {"linear": enu}
    if covariance is not None:
        full = np.zeros((len(stamp), 6, 6))
        full[:, :3, :3] = covariance
        columns["covariance"] = full
    return channel("gps/velocity", stamp, columns, received=received)


def body_velocity(stamp: Stamps, velocity: Array, *, received: Stamps | None = None) -> Channel:
    """`vehicle/velocity` from a velocity (n, 3) in the axes of the car [m/s]."""
    return channel("vehicle/velocity", stamp, {"linear": velocity}, received=received)


def joints(topic: str, stamp: Stamps, field: str, values: Mapping[str, Array]) -> Channel:
    """A JointState topic with one of `position`, `velocity`, `effort`, by joint name."""
    return channel(topic, stamp, {field: np.column_stack(list(values.values()))}, names=tuple(values))


def course_velocity(speed: Array, course: Array, up: Array | None = None) -> Array:
    """ENU velocity (n, 3) [m/s] from speed over ground [m/s] and course [rad, clockwise from north]."""
    velocity = np.empty((len(speed), 3))
    np.sin(course, out=velocity[:, 0])
    np.cos(course, out=velocity[:, 1])
    velocity[:, :2] *= np.asarray(speed)[:, None]
    velocity[:, 2] = np.nan if up is None else up
    return velocity


def enu_from_geodetic(latitude: Array, longitude: Array, altitude: Array, origin: tuple[float, float, float]) -> Array:
    """Position (n, 3) [m] east, north, up of `origin` (latitude [deg], longitude [deg], ellipsoidal height [m])."""
    return np.column_stack(pymap3d.geodetic2enu(latitude, longitude, altitude, *origin))


def geodetic_from_enu(
    east: Array, north: Array, up: Array, origin: tuple[float, float, float]
) -> tuple[Array, Array, Array]:
    """Latitude, longitude [deg] and ellipsoidal height [m] of positions east, north, up of `origin` [m]."""
    latitude, longitude, altitude = pymap3d.enu2geodetic(east, north, up, *origin)
    return np.asarray(latitude), np.asarray(longitude), np.asarray(altitude)


def navigated(
    stamp: Stamps, place: tuple[Array, Array, Array], turn: Rotation, enu: Array, rates: Array | None = None
) -> tuple[Channel, tuple[float, float, float]]:
    """`reference/odometry` of an inertial navigation system, and the origin of its map, which is its first position.

    `place` is latitude, longitude [deg] and ellipsoidal height [m]; `turn` takes axes forward, left, up to east, north,
    up; `enu` is the velocity (n, 3) [m/s], and `rates` those of the body (n, 3) [rad/s], absent if None.
    """
    latitude, longitude, altitude = place
    origin = (float(latitude[0]), float(longitude[0]), float(altitude[0]))
    columns = {
        "position": enu_from_geodetic(latitude, longitude, altitude, origin),
        "orientation": turn.as_quat(),
        "linear": turn.inv().apply(enu),
        "angular": np.full((len(stamp), 3), np.nan) if rates is None else rates,
    }
    return channel("reference/odometry", stamp, columns), origin


def origin_metadata(origin: tuple[float, float, float]) -> dict[str, str]:
    """The origin of `map` as recording metadata, with all digits."""
    names = ("origin_latitude_deg", "origin_longitude_deg", "origin_altitude_m")
    return {name: repr(float(value)) for name, value in zip(names, origin, strict=True)}
