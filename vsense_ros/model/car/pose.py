"""Where a car is and how it is turned on the map, from its coordinates over the road and the road's own slopes."""

from __future__ import annotations

from math import asin, atan2, cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.coordinates import BANK, GRADE, PITCH, ROAD_HEIGHT, ROLL, YAW, X, Y, Z

Array = NDArray[np.float64]


def position_on_map(q: Array, disturbances: Array) -> Array:
    """Position of `cog` on the map (…, 3) [m], from coordinates (…, 14) and disturbances (…, 7)."""
    along, across = np.sin(disturbances[..., GRADE]), np.sin(disturbances[..., BANK])
    height = disturbances[..., ROAD_HEIGHT] + q[..., Z] * np.sqrt(1 - along**2 - across**2)
    result = np.empty((*np.shape(height), 3))
    result[..., 0], result[..., 1], result[..., 2] = q[..., X], q[..., Y], height
    return result


def orientation_on_map(q: Array, disturbances: Array) -> Array:
    """Orientation of the body on the map as a quaternion x, y, z, w (…, 4), from coordinates (…, 14) and disturbances
    (…, 7)."""
    grade = disturbances[..., GRADE]
    road = quaternion(leaning(grade, disturbances[..., BANK]), -grade, q[..., YAW])
    return product(road, quaternion(q[..., ROLL], q[..., PITCH], 0.0 * grade))


def tilt_on_map(roll: float, pitch: float, grade: float, bank: float) -> float:
    """The larger of roll and pitch of the body on the map [rad], of its angles over the road and the road's own: as
    `angles(orientation_on_map(…))` has them, for one car in a fraction of the time.

    The upward direction of the map in the axes of the body is all that either depends on.
    """
    along, across = sin(grade), sin(bank)
    upward = sqrt(max(1 - along**2 - across**2, 0.0))
    ahead = along * cos(pitch) - upward * sin(pitch)
    up = along * sin(pitch) + upward * cos(pitch)
    left, up = across * cos(roll) + up * sin(roll), up * cos(roll) - across * sin(roll)
    return max(abs(atan2(left, up)), asin(min(abs(ahead), 1.0)))


def leaning(grade: Array | float, bank: Array | float) -> Array:
    """Roll (…) [rad] of the road's axes after they have been turned about y by minus the grade."""
    return np.asarray(np.arcsin(np.clip(np.sin(bank) / np.cos(grade), -1.0, 1.0)))


def quaternion(roll: Array, pitch: Array, yaw: Array) -> Array:
    """x, y, z, w (…, 4) of angles (…) [rad], intrinsic z-y-x; SciPy takes three times as long for one."""
    c_roll, c_pitch, c_yaw = np.cos(roll / 2), np.cos(pitch / 2), np.cos(yaw / 2)
    s_roll, s_pitch, s_yaw = np.sin(roll / 2), np.sin(pitch / 2), np.sin(yaw / 2)
    result = np.empty((*np.shape(roll), 4))
    result[..., 0] = s_roll * c_pitch * c_yaw - c_roll * s_pitch * s_yaw
    result[..., 1] = c_roll * s_pitch * c_yaw + s_roll * c_pitch * s_yaw
    result[..., 2] = c_roll * c_pitch * s_yaw - s_roll * s_pitch * c_yaw
    result[..., 3] = c_roll * c_pitch * c_yaw + s_roll * s_pitch * s_yaw
    return result


def product(first: Array, second: Array) -> Array:
    """Product of two quaternions x, y, z, w (…, 4): the rotation by the second, followed by that by the first."""
    ax, ay, az, aw = first.T
    bx, by, bz, bw = second.T
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    ).T


def angles(orientation: Array) -> Array:
    """Roll, pitch and yaw (…, 3) [rad] of a quaternion x, y, z, w (…, 4), intrinsic z-y-x."""
    x, y, z, w = np.moveaxis(orientation, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    return np.stack([roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))], axis=-1)
