"""Conventions of axes and signs that a mapping may state, and how values come from them to those of this project.

Messages have the axes of ISO 8855: the car's forward, left, up, the map's east, north, up, and a steering angle that is
positive to the left. A name here stands for what its authors use instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.checks.finding import Matrix, Scale, Turn
from vsense_ros.messages.recording import Channel

ConventionName = Literal["iso_8855", "sae_j670", "ned", "enu"]
Axes = Literal["body", "map", "steering"]

_SAME: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_FORWARD_RIGHT_DOWN: Matrix = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
_RIGHT_FORWARD_UP: Matrix = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
_NORTH_EAST_DOWN: Matrix = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))


@dataclass(frozen=True)
class Convention:
    """Matrices (3, 3) that take vectors in its axes of the body to forward, left, up, and in its axes of the map to
    east, north, up; `steering` is -1 where a steering angle to the right is positive."""

    body: Matrix = _SAME
    map: Matrix = _SAME
    steering: int = 1


CONVENTIONS: Mapping[ConventionName, Convention] = MappingProxyType(
    {
        "iso_8855": Convention(),
        # SAE J670: forward, right, down; what turns to the right is positive.
        "sae_j670": Convention(_FORWARD_RIGHT_DOWN, _NORTH_EAST_DOWN, -1),
        # Aerospace: forward, right, down on a map of north, east, down; says nothing about steering.
        "ned": Convention(_FORWARD_RIGHT_DOWN, _NORTH_EAST_DOWN),
        # The axes of the body as those of the map when the car drives north, as a phone has them.
        "enu": Convention(_RIGHT_FORWARD_UP),
    }
)

# What a field of a topic is measured in; others, as a course or a named direction, mean the same in all conventions.
IN_AXES: Mapping[str, Mapping[str, Axes]] = MappingProxyType(
    {
        "imu/data": {"angular_velocity": "body", "linear_acceleration": "body"},
        "gps/velocity": {"linear": "map"},
        "vehicle/velocity": {"linear": "body", "angular": "body"},
        "vehicle/steering": {"position": "steering"},
        "reference/odometry": {"position": "map", "linear": "body", "angular": "body"},
        "reference/acceleration": {"linear": "body", "angular": "body"},
    }
)


def in_own_axes(channel: Channel, name: ConventionName) -> Channel:
    """A channel whose values have a convention, in the axes of this project. Vectors, their covariances and
    orientations are turned; topics that have neither stay as they are."""
    convention = CONVENTIONS[name]
    for field, kind in IN_AXES.get(channel.topic, {}).items():
        if field not in channel.columns:
            continue
        if kind == "steering":
            channel = Scale(field, float(convention.steering)).apply(channel)
        else:
            channel = Turn((field,), convention.body if kind == "body" else convention.map).apply(channel)
    if "orientation" in channel.columns and channel.topic in ("imu/data", "reference/odometry"):
        channel = replace(channel, columns={**channel.columns, "orientation": _turned(channel, convention)})
    return channel


def _turned(channel: Channel, convention: Convention) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Orientations (n, 4) as x, y, z, w of the body on the map, both in the axes of this project; those that are no
    rotation stay as they are."""
    given = channel.columns["orientation"]
    turned = given.copy()
    known = np.isfinite(given).all(axis=1) & (np.linalg.norm(np.nan_to_num(given), axis=1) > 0.5)
    if known.any():
        on_map, of_body = Rotation.from_matrix(convention.map), Rotation.from_matrix(convention.body)
        turned[known] = (on_map * Rotation.from_quat(given[known]) * of_body.inv()).as_quat()
    return turned
