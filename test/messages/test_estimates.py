"""Messages of an estimate, against SciPy's rotations and the shapes of the message types."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vsense_ros.messages import estimates
from vsense_ros.messages.recording import FIELDS

ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)


@given(ANGLES)
def test_the_quaternion_of_an_attitude_is_that_of_scipy(attitude):
    roll, pitch, yaw = attitude
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    found = estimates.quaternion(np.array(attitude))
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-12  # q and -q are one rotation


@given(st.lists(ANGLES, min_size=1, max_size=5))
def test_many_attitudes_at_once_have_the_quaternions_of_each(attitudes):
    many = estimates.quaternion(np.array(attitudes))
    np.testing.assert_array_equal(many, [estimates.quaternion(np.array(one)) for one in attitudes])
    assert np.linalg.norm(many, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("rows", [(), (4,)])
def test_every_message_has_the_fields_of_its_type_in_their_shapes(rows):
    rng = np.random.default_rng(0)

    def made(*shape: int) -> np.ndarray:
        return rng.normal(size=(*rows, *shape))

    pose, twist = made(6, 6), made(6, 6)
    samples = [
        estimates.odometry(7, made(3), made(4), pose, made(3), made(3), twist),
        estimates.acceleration(7, made(3), made(3), made(36)),
        estimates.side_slip(7, made(3)),
        estimates.parameters(7, ("a", "b"), made(2), made(2)),
    ]
    for sample in samples:
        assert sample.stamp == 7
        assert sample.values.keys() == FIELDS[sample.kind].keys()
        for name, width in FIELDS[sample.kind].items():
            width = width or (0 if name == "effort" else len(sample.names))
            assert sample.values[name].shape == (*rows, width), name
    odometry = samples[0]
    assert (odometry.frame_id, odometry.child_frame_id) == ("map", "cog")
    np.testing.assert_array_equal(odometry.values["pose_covariance"].reshape(pose.shape), pose)
    np.testing.assert_array_equal(odometry.values["twist_covariance"].reshape(twist.shape), twist)
