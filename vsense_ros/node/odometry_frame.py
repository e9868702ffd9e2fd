"""The odometry of another point of the car: of `base_link`, which Nav2 and robot_localization expect, in place of the
centre of gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.messages.estimates import UNESTIMATED_VARIANCE
from vsense_ros.messages.recording import Sample

Array = NDArray[np.float64]


def moved(odometry: Sample, arm: Array, name: str) -> Sample:
    """The odometry of the point `name` at `arm` (3,) [m] from the centre of gravity, in the body's axes.

    Place and velocity are those of a point of a rigid body. So are their covariances, to first order; a coordinate that
    is not estimated adds nothing to the others.
    """
    values = dict(odometry.values)
    turned = Rotation.from_quat(values["orientation"]).apply(arm)
    values["position"] = values["position"] + turned
    values["linear"] = values["linear"] + np.cross(values["angular"], arm)
    values["pose_covariance"] = _moved(values["pose_covariance"], turned)
    values["twist_covariance"] = _moved(values["twist_covariance"], arm)
    return replace(odometry, values=values, child_frame_id=name)


def _moved(covariance: Array, arm: Array) -> Array:
    """Covariance (36,) of a point's motion and its rotation, for one at `arm` (3,) from it."""
    x, y, z = arm
    matrix = covariance.reshape(6, 6)
    known = np.diag(matrix) < UNESTIMATED_VARIANCE
    lever = np.zeros((6, 6))
    lever[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]  # δθ × arm
    lever = np.eye(6) + np.where(np.outer(known, known), lever, 0.0)
    return (lever @ matrix @ lever.T).reshape(36)
