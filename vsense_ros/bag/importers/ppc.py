"""Runs of the Precise Positioning Challenge 2024 (PPC) and of UrbanNav: the IMU and the reference as tables.

The IMU of PPC has axes forward, right, down (as its README says); times are GPS week and seconds.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build, csv, text_table
from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.mapping import Ref
from vsense_ros.messages.recording import Channel, Recording

NAME = "ppc"
DESCRIPTION = "run of the PPC data set (imu.csv, reference.csv)"

_TIME = {"column": "GPS TOW (s)", "unit": "gps", "week": "GPS Week"}
_ANGLES = ("Heading (deg)", "Pitch (deg)", "Roll (deg)")
_VELOCITY = ("East Velocity (m/s)", "North Velocity (m/s)", "Up Velocity (m/s)")
_PLACE = ("Latitude (deg)", "Longitude (deg)", "Ellipsoid Height (m)")


def matches(path: Path) -> bool:
    """True if `path` is a run with an IMU whose times are those of GPS."""
    return path.is_dir() and (path / "imu.csv").is_file() and _header(path / "imu.csv")[0] == _TIME["column"]


def read(path: Path) -> Recording:
    """The IMU, the speed of the wheels where there is one, and the reference."""
    names = _header(path / "imu.csv")
    topics: dict[str, Any] = {
        "imu/data": {
            "angular_velocity": [_named(names, ("ang rate", "angular rate"), axis, "rate") for axis in "xyz"],
            "linear_acceleration": [_named(names, ("acc ", "acceleration"), axis, "force") for axis in "xyz"],
        }
    }
    wheel = next((name for name in names if name.lower().startswith("wheel velocity")), None)
    if wheel is not None:
        topics["vehicle/velocity"] = {"speed": {"column": wheel, "unit": "m/s"}}
    wanted = {"time": _TIME, "conventions": {"imu/data": "sae_j670"}, "topics": topics}
    recording = csv.read(path / "imu.csv", mapping=wanted)
    channels, metadata = dict(recording.channels), {"source": NAME}
    if (path / "reference.csv").is_file() and set(_PLACE) <= set(_header(path / "reference.csv")):
        channels["reference/odometry"], origin = _reference(path / "reference.csv")
        metadata |= build.origin_metadata(origin)
    return replace(recording, channels=channels, name=path.resolve().name, metadata=metadata)


def _header(path: Path) -> list[str]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return [name.strip() for name in file.readline(1 << 14).split(",")]


def _named(names: list[str], beginnings: tuple[str, ...], axis: str, kind: str) -> dict[str, Any] | None:
    """The column of an axis, with its unit."""
    for name in names:
        if name.lower().startswith(beginnings) and f" {axis} " in f"{name.lower().partition('(')[0]} ":
            unit = ("rad/s" if "rad" in name.lower() else "deg/s") if kind == "rate" else "m/s²"
            return {"column": name, "unit": unit}
    return None


def _reference(path: Path) -> tuple[Channel, tuple[float, float, float]]:
    """Poses and velocities of the reference system; angular velocities are absent."""
    wanted = mapping_file.load({"time": _TIME, "topics": {}}, path)
    table = text_table.read_table(path, wanted, (*_PLACE, *_ANGLES, *_VELOCITY))
    heading, pitch, roll = (np.radians(table.column(Ref(name)).values) for name in _ANGLES)
    latitude, longitude, height = (table.column(Ref(name)).values for name in _PLACE)
    enu = np.column_stack([table.column(Ref(name)).values for name in _VELOCITY])
    # Heading clockwise from north, nose up and right side down positive, of a body forward, right, down.
    turn = Rotation.from_euler("ZYX", np.column_stack([np.pi / 2 - heading, -pitch, roll]))
    stamp = build.nanoseconds(table.time, table.base or 0)
    return build.navigated(stamp, (latitude, longitude, height), turn, enu)
