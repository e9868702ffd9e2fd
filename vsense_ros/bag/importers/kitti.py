"""KITTI raw data (Geiger et al. 2013): the OXTS unit of a drive, one text file of thirty numbers for each moment.

Axes of the unit are those of ISO 8855, yaw counts from east to the left, as `dataformat.txt` of the data set says. All
quantities are one filtered solution: what stands in `gps/*` is as smooth as the reference. Times have no zone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array, Stamps
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "kitti"
DESCRIPTION = "drive of KITTI raw data (oxts/timestamps.txt, oxts/data/*.txt)"

_WIDTH = 30  # numbers of a file
_LAT, _ALT, _ROLL, _NORTH, _EAST, _UP = 0, 2, 3, 6, 7, 10
_FORCE, _RATES, _POSITION_ERROR, _VELOCITY_ERROR = slice(11, 14), slice(17, 20), 23, 24


def matches(path: Path) -> bool:
    """True if `path` is a drive with an OXTS unit, or the unit's folder."""
    return path.is_dir() and _folder(path) is not None


def read(path: Path) -> Recording:
    """IMU, GNSS position and velocity, and the unit's pose and motion as reference."""
    folder = _folder(path)
    if folder is None:
        raise InputError(f"{path}: expected oxts/timestamps.txt and oxts/data in it")
    stamp, rows, notes = _rows(folder)
    place = (rows[:, _LAT], rows[:, _LAT + 1], rows[:, _ALT])
    enu = rows[:, [_EAST, _NORTH, _UP]]
    turn = Rotation.from_euler("ZYX", rows[:, [_ROLL + 2, _ROLL + 1, _ROLL]])
    reference, origin = build.navigated(stamp, place, turn, enu, rows[:, _RATES])
    square = np.eye(3) * (rows[:, _VELOCITY_ERROR, None, None] ** 2)
    around = (np.eye(3) * rows[:, _POSITION_ERROR, None, None] ** 2).reshape(-1, 9)
    channels = [
        build.imu(stamp, rows[:, _RATES], rows[:, _FORCE]),
        build.fix(stamp, *place, covariance=around),
        build.velocity(stamp, enu, covariance=square),
        reference,
    ]
    notes += [
        "times have no zone; taken for UTC",
        "gps/*, imu/data and reference/odometry are one filtered solution of the OXTS unit: the reference is not "
        "independent of them",
    ]
    metadata = {"source": NAME} | build.origin_metadata(origin)
    name = path.resolve().parent.name if path.name == "oxts" else path.resolve().name
    return Recording({c.topic: c for c in channels}, name, tuple(notes), 0, metadata)


def _folder(path: Path) -> Path | None:
    for folder in (path, path / "oxts"):
        if (folder / "timestamps.txt").is_file() and any((folder / "data").glob("*.txt")):
            return folder
    return None


def _rows(folder: Path) -> tuple[Stamps, Array, list[str]]:
    """Stamps and numbers (n, 30) of the moments that have both; those whose file is missing or cut are left out."""
    lines = (folder / "timestamps.txt").read_text(encoding="utf-8", errors="replace").splitlines()
    stamps, rows, lost = [], [], 0
    for index, line in enumerate(line for line in lines if line.strip()):
        file = folder / "data" / f"{index:010d}.txt"
        try:
            numbers = [float(word) for word in file.read_text(encoding="utf-8").split()] if file.exists() else []
            if len(numbers) != _WIDTH or not np.isfinite(numbers).all():
                raise ValueError("numbers")
            stamps.append(_stamp(line))
            rows.append(numbers)
        except ValueError:
            lost += 1
    if not rows:
        raise InputError(f"{folder}: no file in data has {_WIDTH} numbers and a time in timestamps.txt")
    notes = [f"{lost} moments without a file of {_WIDTH} numbers and a time are left out"] if lost else []
    return np.array(stamps, np.int64), np.array(rows), notes


def _stamp(line: str) -> int:
    """Unix time [ns] of a time such as `2011-09-26 13:02:25.964389445`."""
    whole, _, part = line.strip().partition(".")
    seconds = int(np.datetime64(whole.replace(" ", "T"), "s").astype(np.int64))
    return seconds * 1_000_000_000 + int(part.ljust(9, "0")[:9])
