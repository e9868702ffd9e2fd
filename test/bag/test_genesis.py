"""The Genesis laps, against facts that the importer does not use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]


def slope(seconds: Array, values: Array, span: float = 0.2) -> Array:
    """Derivative over `span` on the grid of `seconds`."""
    return (np.interp(seconds + span / 2, seconds, values) - np.interp(seconds - span / 2, seconds, values)) / span


def smooth(values: Array, width: int = 21) -> Array:
    return np.convolve(values, np.ones(width) / width, "same")


def test_the_velocity_of_the_reference_is_the_derivative_of_its_position(genesis: Recording) -> None:
    odometry = genesis["reference/odometry"]
    linear = np.nan_to_num(odometry.columns["linear"])
    enu = Rotation.from_quat(odometry.columns["orientation"]).apply(linear)
    for axis in range(2):
        derivative = slope(odometry.seconds, odometry.columns["position"][:, axis])
        assert np.std((derivative - enu[:, axis])[20:-20]) < 0.04


def test_gnss_velocity_is_the_reference_velocity_in_enu_and_has_no_vertical(genesis: Recording) -> None:
    velocity, odometry = genesis["gps/velocity"], genesis["reference/odometry"]
    rows = np.searchsorted(odometry.stamp, velocity.stamp)
    np.testing.assert_allclose(
        np.linalg.norm(velocity.columns["linear"][:, :2], axis=1),
        np.linalg.norm(odometry.columns["linear"][rows, :2], axis=1),
        atol=1e-9,
    )
    assert np.isnan(velocity.columns["linear"][:, 2]).all()


def test_accelerations_and_yaw_rate_are_positive_forward_and_left(genesis: Recording) -> None:
    imu, odometry = genesis["imu/data"], genesis["reference/odometry"]
    seconds, inner = odometry.seconds, slice(50, -50)
    forward, left = odometry.columns["linear"][:, 0], odometry.columns["linear"][:, 1]
    rate = odometry.columns["angular"][:, 2]
    gain, _ = np.polyfit(rate[inner], smooth(imu.columns["angular_velocity"][:, 2], 11)[inner], 1)
    assert gain == pytest.approx(1.0, abs=0.01)
    longitudinal = slope(seconds, forward) - left * rate
    lateral = slope(seconds, left) + forward * rate
    for axis, kinematic in enumerate((longitudinal, lateral)):
        measured = smooth(imu.columns["linear_acceleration"][:, axis])
        gain, _ = np.polyfit(kinematic[inner], measured[inner], 1)
        assert gain == pytest.approx(1.0, abs=0.12)
    assert np.isnan(imu.columns["angular_velocity"][:, :2]).all()
    assert np.isnan(imu.columns["linear_acceleration"][:, 2]).all()


def test_steering_is_positive_to_the_left(genesis: Recording) -> None:
    steering = genesis["vehicle/steering"]
    assert steering.names == ("road_wheel_front",)
    rate = genesis["reference/odometry"].columns["angular"][:, 2]
    assert np.corrcoef(steering.columns["position"][:, 0], rate)[0, 1] > 0.98


def test_roll_pitch_and_height_are_marked_as_unknown(genesis: Recording) -> None:
    odometry = genesis["reference/odometry"]
    assert np.isnan(odometry.columns["position"][:, 2]).all()
    assert np.isnan(odometry.columns["pose_covariance"][:, [14, 21, 28]]).all()


@pytest.mark.parametrize("rate", [1.0, 10.0, 20.0])
def test_the_receiver_reports_at_the_wanted_rate_and_is_silent_in_the_outage(genesis_path: Path, rate: float) -> None:
    fix = import_recording(genesis_path, gnss_rate_hz=rate, gnss_outage=(30.0, 40.0))["gps/fix"]
    steps = np.diff(fix.seconds)
    assert np.median(steps) == pytest.approx(1 / rate, abs=0.002)
    assert 9.9 < steps.max() < 10.0 + 1 / rate + 0.05
    assert not ((fix.seconds > 30.0) & (fix.seconds < 39.99)).any()


def test_a_rate_that_the_file_does_not_have_is_an_input_error(genesis_path: Path) -> None:
    with pytest.raises(InputError, match="gnss_rate_hz is 200"):
        import_recording(genesis_path, gnss_rate_hz=200)


def test_a_mat_file_of_something_else_is_no_lap(tmp_path: Path) -> None:
    file = tmp_path / "other.mat"
    scipy.io.savemat(file, {"t": np.arange(3.0)})
    with pytest.raises(InputError, match=r"Expected a mapping file other\.yaml beside it"):
        import_recording(file)
    file.write_bytes(b"garbage")
    mapping = {"time": {"column": "t"}, "topics": {}}
    with pytest.raises(InputError, match="not a MATLAB file that can be read"):
        import_recording(file, mapping=mapping)
