"""How drivers fill messages of which a sensor measures only a part."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsense_ros.messages.recording import Sample

# Messages can only mark a whole vector as absent (covariance[0] = -1), not one axis of it. An axis that the sensor does
# not measure has the value NaN (zero, where it is part of a quaternion) and this variance, in the unit squared.
UNMEASURED_VARIANCE = 1e6

ABSENT: NDArray[np.float64] = np.array([-1.0] + [0.0] * 8)


def diagonal(variances: ArrayLike) -> NDArray[np.float64]:
    """Covariance (n²,) of independent axes with variances (n,)."""
    numbers = np.asarray(variances, float)
    covariance = np.zeros(numbers.size**2)
    covariance[:: numbers.size + 1] = numbers
    return covariance


def imu(
    topic: str,
    stamp: int,
    frame_id: str,
    *,
    angular_velocity: ArrayLike | None = None,
    angular_velocity_covariance: ArrayLike | None = None,
    linear_acceleration: ArrayLike | None = None,
    linear_acceleration_covariance: ArrayLike | None = None,
    orientation: ArrayLike | None = None,
    orientation_covariance: ArrayLike | None = None,
    received: int | None = None,
) -> Sample:
    """sensor_msgs/Imu [rad/s, m/s², quaternion x y z w].

    `None` marks a vector as absent, or a covariance as unknown.
    """
    values: dict[str, NDArray[np.float64]] = {}
    for name, value, covariance, empty in (
        ("orientation", orientation, orientation_covariance, (0.0, 0.0, 0.0, 1.0)),
        ("angular_velocity", angular_velocity, angular_velocity_covariance, (0.0, 0.0, 0.0)),
        ("linear_acceleration", linear_acceleration, linear_acceleration_covariance, (0.0, 0.0, 0.0)),
    ):
        values[name] = np.array(empty if value is None else value, float)
        unknown = ABSENT if value is None else np.zeros(9)
        values[f"{name}_covariance"] = np.array(unknown if value is None or covariance is None else covariance, float)
    return Sample(topic, "sensor_msgs/msg/Imu", stamp, values, frame_id, received=received)


def joint_state(topic: str, stamp: int, field: str, values: Mapping[str, float], received: int | None = None) -> Sample:
    """sensor_msgs/JointState with one of `position`, `velocity`, `effort`, by joint name."""
    columns = {name: np.zeros(0) for name in ("position", "velocity", "effort")}
    columns[field] = np.fromiter(values.values(), float, len(values))
    return Sample(topic, "sensor_msgs/msg/JointState", stamp, columns, names=tuple(values), received=received)


def heading_and_tilt(
    topic: str,
    stamp: int,
    frame_id: str,
    yaw: float,
    variances: tuple[float, float, float],
    roll: float = 0.0,
    pitch: float = 0.0,
    received: int | None = None,
) -> Sample:
    """sensor_msgs/Imu with an orientation alone, of the body in ENU (roll about x, after pitch about y, after yaw).

    Angles in radians, ISO 8855: pitch is positive with the nose down, yaw is counted from east to north.
    `variances` are those of roll, pitch and yaw [rad²].
    """
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    quaternion = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    return imu(
        topic,
        stamp,
        frame_id,
        orientation=quaternion,
        orientation_covariance=diagonal(variances),
        received=received,
    )
