"""NCLT (Carlevaris-Bianco et al. 2016): the sensors of one session on the campus of Michigan, tables without headers.

The Microstrain IMU has axes forward, right, down; angles of positions are in radians; the ground truth is in metres
north, east, down of a place of the campus. Times are Unix microseconds. The vehicle has two driven wheels, of which the
mean speed is published.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array, Stamps
from vsense_ros.bag.importers.numbers_table import numbers
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

NAME = "nclt"
DESCRIPTION = "session of NCLT (ms25.csv, gps.csv, wheels.csv, groundtruth_*.csv)"

ORIGIN = (
    42.293227,
    -83.709657,
    270.0,
)  # latitude, longitude [deg], height [m] of the ground truth's origin (its paper)
_DOWN = np.array([1.0, -1.0, -1.0])  # forward, right, down ↔ forward, left, up
_FIXED = 2  # modes of gps.csv from which on there is a position
_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # north, east, down to east, north, up


def matches(path: Path) -> bool:
    """True if `path` is a folder with the IMU of a session."""
    return path.is_dir() and (path / "ms25.csv").is_file()


def read(path: Path) -> Recording:
    """IMU, GNSS position and velocity, speed by the wheels, and the ground truth as reference."""
    channels: list[Channel] = []
    imu = numbers(path / "ms25.csv", 10)
    channels.append(build.imu(_stamps(imu), imu[:, 7:10] * _DOWN, imu[:, 4:7] * _DOWN))
    if (path / "gps.csv").is_file():
        channels += _gnss(numbers(path / "gps.csv", 8))
    if (path / "wheels.csv").is_file():
        wheels = numbers(path / "wheels.csv", 3)
        forward = wheels[:, 1:3].mean(axis=1)
        absent = np.full(len(wheels), np.nan)
        channels.append(build.body_velocity(_stamps(wheels), np.column_stack([forward, absent, absent])))
    metadata = {"source": NAME}
    truths = sorted([*path.glob("groundtruth*.csv"), *path.parent.parent.glob(f"ground_truth/*{path.name}.csv")])
    if truths:
        channels.append(_truth(numbers(truths[0], 7)))
        metadata |= build.origin_metadata(ORIGIN)
    notes = ("reference/odometry: positions and angles alone, as of the data set's own mapping",) if truths else ()
    return Recording({c.topic: c for c in channels}, path.resolve().name, notes, 0, metadata)


def _stamps(rows: Array) -> Stamps:
    return np.rint(rows[:, 0]).astype(np.int64) * 1000


def _gnss(rows: Array) -> list[Channel]:
    rows = rows[(rows[:, 1] >= _FIXED) & np.isfinite(rows[:, 3:5]).all(axis=1)]
    if not len(rows):
        raise InputError("gps.csv: no row has a position")
    stamp = _stamps(rows)
    channels = [build.fix(stamp, np.degrees(rows[:, 3]), np.degrees(rows[:, 4]), rows[:, 5])]
    if np.isfinite(rows[:, 6:8]).all(axis=1).any():
        channels.append(build.velocity(stamp, build.course_velocity(rows[:, 7], rows[:, 6])))
    return channels


def _truth(rows: Array) -> Channel:
    """Poses in the map east, north, up; velocities are absent."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    down = Rotation.from_euler("ZYX", rows[:, [6, 5, 4]])  # north, east, down from forward, right, down
    turn = Rotation.from_matrix(_FROM_NED) * down * Rotation.from_matrix(np.diag(_DOWN))
    absent = np.full((len(rows), 3), np.nan)
    columns = {
        "position": rows[:, 1:4] @ _FROM_NED.T,
        "orientation": turn.as_quat(),
        "linear": absent,
        "angular": absent,
    }
    return build.channel("reference/odometry", _stamps(rows), columns)
