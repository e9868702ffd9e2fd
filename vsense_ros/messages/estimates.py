"""The messages of an estimate: which topic, frame and field says what, for every filter alike.

Arrays have the shapes given, or one more axis in front for many estimates at once; then `stamp` is that of the first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.recording import Sample

Array = NDArray[np.float64]

# Variance of what an estimate does not have, whose value is zero: large in any unit, finite, and larger than any that
# is given. A first element of -1, by which a message can be without a covariance, would take all other variances along.
UNESTIMATED_VARIANCE = 1e12


def odometry(
    stamp: int,
    position: Array,
    orientation: Array,
    pose_covariance: Array,
    linear: Array,
    angular: Array,
    twist_covariance: Array,
) -> Sample:
    """Position (3,) [m] and orientation (4,) as x, y, z, w of cog in the map, velocity (3,) [m/s] and rates (3,)
    [rad/s] in its own axes, covariances (6, 6)."""
    rows = position.shape[:-1]
    values = {
        "position": position,
        "orientation": orientation,
        "pose_covariance": pose_covariance.reshape(*rows, 36),
        "linear": linear,
        "angular": angular,
        "twist_covariance": twist_covariance.reshape(*rows, 36),
    }
    return Sample("vsense/odometry", "nav_msgs/msg/Odometry", stamp, values, "map", child_frame_id="cog")


def acceleration(stamp: int, linear: Array, angular: Array, covariance: Array) -> Sample:
    """Kinematic acceleration of cog (3,) [m/s²] and of its rates (3,) [rad/s²], covariance (36,)."""
    values = {"linear": linear, "angular": angular, "covariance": covariance}
    return Sample("vsense/acceleration", "geometry_msgs/msg/AccelWithCovarianceStamped", stamp, values, "cog")


def side_slip(stamp: int, vector: Array) -> Sample:
    """Angle [rad], its standard deviation [rad], its rate [rad/s], (3,)."""
    return Sample("vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", stamp, {"vector": vector}, "cog")


def parameters(stamp: int, names: tuple[str, ...], values: Array, deviations: Array) -> Sample:
    """Slowly varying quantities (k,) and their standard deviations (k,)."""
    absent = np.zeros((*values.shape[:-1], 0))
    fields = {"position": values, "velocity": deviations, "effort": absent}
    return Sample("vsense/parameters", "sensor_msgs/msg/JointState", stamp, fields, names=names)


def quaternion(attitude: Array) -> Array:
    """x, y, z, w of roll, pitch, yaw (3,) [rad], intrinsic z-y-x; SciPy takes three times as long for one."""
    half = 0.5 * attitude
    (c_roll, c_pitch, c_yaw), (s_roll, s_pitch, s_yaw) = np.cos(half).T, np.sin(half).T
    result = np.empty((*attitude.shape[:-1], 4))
    result[..., 0] = s_roll * c_pitch * c_yaw - c_roll * s_pitch * s_yaw
    result[..., 1] = c_roll * s_pitch * c_yaw + s_roll * c_pitch * s_yaw
    result[..., 2] = c_roll * c_pitch * s_yaw - s_roll * s_pitch * c_yaw
    result[..., 3] = c_roll * c_pitch * c_yaw + s_roll * s_pitch * s_yaw
    return result
