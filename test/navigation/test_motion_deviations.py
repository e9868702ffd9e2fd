"""Standard deviations are as large as errors, the noise of readings included, and what is not estimated is absent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.evaluate.consistency import errors_of
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.estimates import UNESTIMATED_VARIANCE
from vsense_ros.runner.run import run

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("name", "told"), [("strapdown", 3), ("triple_kkf", 2), ("integrated", 2)])
def test_errors_of_accelerations_are_as_large_as_told(name: str, told: int) -> None:
    """`integrated` has its lateral acceleration from its model, and no accelerometer's noise in it."""
    drive = read_bag(ROOT / "bags/double_lane_change").between(0.0, 6.0)
    output = run(drive, load_vehicle(ROOT / "config/vehicles/prototype_model.yaml"), name).output
    found = {key: error for key, error in errors_of(output, drive).items() if key.endswith("acceleration")}
    assert len(found) == told
    for key, error in found.items():
        assert 0.1 < error.nees < 2.5, key
        assert error.inside > 0.8, key
    angular = output["vsense/acceleration"].columns["covariance"][:, [21, 28, 35]]
    assert (angular == UNESTIMATED_VARIANCE).all()


@pytest.mark.parametrize("name", ["inertial", "integrated"])
def test_a_place_that_a_filter_does_not_estimate_is_absent(name: str) -> None:
    drive = read_bag(ROOT / "bags/double_lane_change").between(0.0, 3.0)
    output = run(drive, load_vehicle(ROOT / "config/vehicles/prototype_model.yaml"), name).output
    odometry = output["vsense/odometry"].columns
    assert np.isnan(odometry["position"]).all()
    assert np.isnan(odometry["angular"][:, 1]).all()
    assert np.isfinite(odometry["linear"][:, :2]).all()
    assert np.isfinite(odometry["orientation"]).all()
    assert "position" not in read_signals(output, "vsense")


@pytest.mark.parametrize("name", ["strapdown", "inertial", "yaw_kkf"])
def test_errors_of_the_yaw_rate_are_within_what_is_stated(name: str) -> None:
    """They are those of the gyro's reading, which no state has."""
    drive = read_bag(ROOT / "bags/double_lane_change").between(0.0, 6.0)
    output = run(drive, load_vehicle(ROOT / "config/vehicles/prototype_model.yaml"), name).output
    error = errors_of(output, drive)["yaw_rate"]
    assert error.inside > 0.9
    assert error.nees < 2.0
