"""smartLoc (Reisdorf et al. 2016): positions of a u-blox receiver in a city beside a reference, `NAV-POSLLH.csv`.

The heading of the reference counts from east to the left [rad], as its column says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build, text_table
from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.mapping import Ref
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "smartloc"
DESCRIPTION = "receiver and reference of smartLoc (NAV-POSLLH.csv)"

_FORM = {
    "time": {"column": "GPSSecondsOfWeek [s]", "unit": "gps", "week": "GPSWeek [weeks]"},
    "delimiter": ";",
    "topics": {},
}
# What the columns that are used begin with, and end with.
_COLUMNS = {
    "longitude": ("Longitude", "(lon) [deg]"),
    "latitude": ("Latitude", "(lat) [deg]"),
    "height": ("Height above ellipsoid", "(height) [m]"),
    "horizontal": ("Horizontal accuracy", "(hAcc) [m]"),
    "vertical": ("Vertical accuracy", "(vAcc) [m]"),
    "true longitude": ("Longitude", "(GT Lon) [deg]"),
    "true latitude": ("Latitude", "(GT Lat) [deg]"),
    "true height": ("Height", "(GT Height) [m]"),
    "true heading": ("Heading (", "(GT Heading) [rad]"),
    "true speed": ("Velocity", "(GT Velocity) [m/s]"),
    "true yaw rate": ("Yaw-Rate", "(GT Yaw-rate) [rad/s]"),
}


def matches(path: Path) -> bool:
    """True if `path` is the table of positions, or a folder with it."""
    file = _file(path)
    if not file.is_file():
        return False
    with file.open("rb") as head:
        first = head.readline(1 << 14)
    return b"GPSSecondsOfWeek [s]" in first and b"(GT Lat) [deg]" in first and b"(lat) [deg]" in first


def read(path: Path) -> Recording:
    """Positions of the receiver, and the reference."""
    file = _file(path)
    wanted = mapping_file.load(_FORM, file)
    header, _ = text_table.read_header(file, wanted)
    names = {key: _named(file, header, *pattern) for key, pattern in _COLUMNS.items()}
    table = text_table.read_table(file, wanted, list(names.values()))
    values: dict[str, Array] = {key: table.column(Ref(name)).values for key, name in names.items()}
    stamp = build.nanoseconds(table.time, table.base or 0)
    variances = np.column_stack([values["horizontal"], values["horizontal"], values["vertical"]]) ** 2
    around = np.zeros((len(stamp), 9))
    around[:, [0, 4, 8]] = variances
    fix = build.fix(stamp, values["latitude"], values["longitude"], values["height"], covariance=around)
    heading, rate = values["true heading"], values["true yaw rate"]
    absent = np.full(len(stamp), np.nan)
    forward = np.column_stack([np.cos(heading), np.sin(heading), 0 * heading]) * values["true speed"][:, None]
    reference, origin = build.navigated(
        stamp,
        (values["true latitude"], values["true longitude"], values["true height"]),
        Rotation.from_euler("Z", heading[:, None]),
        forward,
        np.column_stack([absent, absent, rate]),
    )
    notes = (*table.notes, "reference/odometry: level, and moving forward alone, as the data set states no more")
    metadata = {"source": NAME} | build.origin_metadata(origin)
    return Recording({c.topic: c for c in (fix, reference)}, path.resolve().stem, notes, 0, metadata)


def _file(path: Path) -> Path:
    return path / "NAV-POSLLH.csv" if path.is_dir() else path


def _named(path: Path, header: list[str], beginning: str, end: str) -> str:
    """The one column whose name begins and ends so."""
    columns = [name for name in header if name.startswith(beginning) and name.endswith(end) and " Cov " not in name]
    if len(columns) != 1:
        raise InputError(
            f"{path}: expected one column {beginning} … {end}, found {len(columns)}: {', '.join(header)[:400]}"
        )
    return columns[0]
