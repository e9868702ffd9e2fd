"""Laps of a Hyundai Genesis with OxTS GNSS/INS, from the path-following experiments of MPC Berkeley (.mat, version 5).

What was found in the recordings and is taken care of here:

- `psi` is counter-clockwise from east; the OxTS velocity turned by it is the derivative of the path to 0.02 m/s,
  about 10 ms ahead of it. The file's `x`, `y` come from a spherical earth and are 0.2 % off, so the path is made from
  latitude and longitude.
- `wz`, `a_long` and `a_lat` come from the car's own bus, positive to the left and forward. `wz` lags the derivative of
  `psi` by some 30 ms; `a_lat` has an offset of -0.6 m/s².
- `df` is the road-wheel angle, positive to the left, held between its updates.
- There is no height, no roll and no pitch, and no other axis of the car's inertial sensors: those are NaN.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "genesis"
DESCRIPTION = "lap of the MPC Berkeley Genesis (.mat)"

_SIGNALS = ("t", "lat", "lon", "psi", "vx", "vy", "wz", "a_long", "a_lat", "df")
_RATE_SPAN = 0.1  # the yaw rate of the reference is the slope of psi over so long [s]


def matches(path: Path) -> bool:
    """True if `path` is a .mat file with the signals of these laps."""
    if path.suffix.lower() != ".mat" or not path.is_file():
        return False
    try:
        return set(_SIGNALS) <= {name for name, *_ in scipy.io.whosmat(path)}
    except (ValueError, NotImplementedError, MatReadError, OSError):
        return False


def read(path: Path, *, gnss_rate_hz: float = 10.0, gnss_outage: tuple[float, float] | None = None) -> Recording:
    """The car's own sensors, GNSS and the OxTS reference of a lap.

    The lap holds the OxTS position and velocity at 100 Hz; a GNSS receiver is made of them that reports at
    `gnss_rate_hz` and is silent during `gnss_outage`, from and to [s] after the first row.
    """
    if not 0.0 < gnss_rate_hz <= 100.0:
        raise InputError(f"gnss_rate_hz is {gnss_rate_hz}, expected more than 0 and at most 100")
    data = _load(path)
    time = data["t"]
    stamp = build.nanoseconds(time)
    absent = np.full_like(time, np.nan)
    channels = {
        "imu/data": build.imu(
            stamp,
            np.column_stack([absent, absent, data["wz"]]),
            np.column_stack([data["a_long"], data["a_lat"], absent]),
        ),
        "vehicle/steering": build.joints("vehicle/steering", stamp, "position", {"road_wheel_front": data["df"]}),
    }

    cos, sin = np.cos(data["psi"]), np.sin(data["psi"])
    enu = np.column_stack([data["vx"] * cos - data["vy"] * sin, data["vx"] * sin + data["vy"] * cos, absent])
    rows = _gnss_rows(time - time[0], gnss_rate_hz, gnss_outage)
    channels["gps/fix"] = build.fix(stamp[rows], data["lat"][rows], data["lon"][rows], absent[rows])
    channels["gps/velocity"] = build.velocity(stamp[rows], enu[rows])

    origin = (float(data["lat"][0]), float(data["lon"][0]), 0.0)
    position = build.enu_from_geodetic(data["lat"], data["lon"], np.zeros_like(time), origin)
    position[:, 2] = np.nan
    half = _RATE_SPAN / 2
    heading = np.unwrap(data["psi"])
    earlier, later = np.maximum(time - half, time[0]), np.minimum(time + half, time[-1])
    yaw_rate = (np.interp(later, time, heading) - np.interp(earlier, time, heading)) / (later - earlier)
    flat = np.zeros_like(time)
    unknown = np.zeros((len(time), 36))
    unknown[:, [14, 21, 28]] = np.nan  # variances of height, roll, pitch
    channels["reference/odometry"] = build.channel(
        "reference/odometry",
        stamp,
        {
            "position": position,
            "orientation": np.column_stack([flat, flat, np.sin(heading / 2), np.cos(heading / 2)]),
            "pose_covariance": unknown,
            "linear": np.column_stack([data["vx"], data["vy"], absent]),
            "angular": np.column_stack([absent, absent, yaw_rate]),
        },
    )
    notes = [
        "reference/odometry: the reference point is that of the OxTS, not the centre of gravity; there is no height, "
        "roll or pitch (NaN, and NaN on the diagonal of the covariance); the yaw rate is the slope of the heading over "
        f"{_RATE_SPAN:g} s",
        f"gps/*: taken from the OxTS solution at {gnss_rate_hz:g} Hz"
        + (f", silent from {gnss_outage[0]:g} to {gnss_outage[1]:g} s" if gnss_outage else ""),
        "imu/data: the car's own yaw rate and accelerations; the other axes are NaN",
    ]
    metadata = {"source": NAME} | build.origin_metadata(origin)
    return Recording(channels, path.stem, tuple(notes), 0, metadata)


def _gnss_rows(since_start: Array, rate: float, outage: tuple[float, float] | None) -> np.ndarray:
    """Rows at which the receiver reports: the first at or behind each period."""
    due = np.arange(0.0, since_start[-1], 1.0 / rate)
    rows = np.unique(np.searchsorted(since_start, due - 0.001))
    if outage is not None:
        start, end = outage
        rows = rows[(since_start[rows] < start) | (since_start[rows] >= end)]
    return rows


def _load(path: Path) -> dict[str, Array]:
    try:
        content = scipy.io.loadmat(path)
    except (ValueError, NotImplementedError, MatReadError, OSError) as error:
        raise InputError(f"{path}: not a MATLAB file of version 5 that can be read: {error}") from None
    missing = [name for name in _SIGNALS if name not in content]
    if missing:
        raise InputError(f"{path}: the signals {', '.join(missing)} are missing; expected {', '.join(_SIGNALS)}")
    data = {name: np.asarray(content[name], np.float64).ravel() for name in _SIGNALS}
    lengths = {len(values) for values in data.values()}
    if len(lengths) != 1 or len(data["t"]) < 2:
        raise InputError(f"{path}: the signals have {sorted(lengths)} rows; expected the same number, at least 2")
    return data
