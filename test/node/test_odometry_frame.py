"""Odometry of the middle of the rear axle, by the motion of a rigid body."""

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.messages.estimates import UNESTIMATED_VARIANCE, odometry
from vsense_ros.node.odometry_frame import moved

ARM = np.array([-1.4, 0.0, -0.5])


def _covariance(random: np.random.Generator, size: float) -> np.ndarray:
    root = size * random.standard_normal((6, 6))
    return root @ root.T


def test_place_velocity_and_covariances_are_those_of_drawn_motions_of_a_rigid_body() -> None:
    random = np.random.default_rng(3)
    place, velocity, rates = random.normal(0, 20, 3), np.array([20.0, 0.3, 0.0]), np.array([0.1, -0.2, 0.6])
    attitude = Rotation.from_euler("xyz", [0.05, -0.02, 2.0])
    pose, twist = _covariance(random, 1e-3), _covariance(random, 1e-2)
    found = moved(odometry(0, place, attitude.as_quat(), pose, velocity, rates, twist), ARM, "base_link")
    errors = random.multivariate_normal(np.zeros(6), pose, 40_000)
    places = place + errors[:, :3] + (Rotation.from_rotvec(errors[:, 3:]) * attitude).apply(ARM)
    errors = random.multivariate_normal(np.zeros(6), twist, 40_000)
    velocities = velocity + errors[:, :3] + np.cross(rates + errors[:, 3:], ARM)
    for name, covariance, drawn in (
        ("position", "pose_covariance", places),
        ("linear", "twist_covariance", velocities),
    ):
        np.testing.assert_allclose(found.values[name], drawn.mean(axis=0), atol=1e-3)
        expected, size = np.cov(drawn.T), np.abs(np.cov(drawn.T)).max()
        np.testing.assert_allclose(found.values[covariance].reshape(6, 6)[:3, :3], expected, atol=0.03 * size)
    assert found.child_frame_id == "base_link"


def test_what_is_not_estimated_stays_so_and_adds_nothing_to_the_others() -> None:
    covariance = np.diag([0.01, 0.01, UNESTIMATED_VARIANCE, UNESTIMATED_VARIANCE, UNESTIMATED_VARIANCE, 1e-4])
    level = odometry(0, np.zeros(3), np.array([0.0, 0, 0, 1]), covariance, np.zeros(3), np.zeros(3), covariance)
    matrix = moved(level, ARM, "base_link").values["pose_covariance"].reshape(6, 6)
    expected = [0.01, 0.01 + 1.4**2 * 1e-4, *[UNESTIMATED_VARIANCE] * 3, 1e-4]
    np.testing.assert_allclose(np.diag(matrix), expected)
