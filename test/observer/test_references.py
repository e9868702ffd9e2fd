"""The observers that others are compared with: the textbook's EKF and UKF over the whole state."""

from __future__ import annotations

import numpy as np
import pytest

from drives import feed, messages
from vsense_ros.messages.recording import Recording
from vsense_ros.model.schema.drivetrain import Drivetrain
from vsense_ros.model.schema.observer_settings import ForceErrors
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.state import FORCE
from vsense_ros.runner import Runner

NAMES = ("longitudinal", "lateral", "vertical", "roll", "pitch", "yaw", "suspension", "wheel_spin")


@pytest.fixture
def independent(vehicle: Vehicle) -> Vehicle:
    """A car of which no axle is known to be driven, so that errors of its wheels' torques are independent, as the
    references take them always."""
    return vehicle.model_copy(update={"drivetrain": Drivetrain()})


@pytest.fixture
def believing(independent: Vehicle) -> Vehicle:
    """A car of which its observer believes that nothing is missing."""
    errors = ForceErrors(**dict.fromkeys(NAMES, 0.0))
    observer = independent.observer.model_copy(update={"force_errors": errors})
    return independent.model_copy(update={"observer": observer})


def test_without_force_errors_the_errorekf_and_the_dekf_are_one_filter(
    lane_change: Recording, believing: Vehicle
) -> None:
    made = []
    for name in ("error_ekf", "dekf"):
        observer = Runner(believing, lane_change.map_origin, FILTERS[name].make)
        made.append(feed(observer, messages(lane_change, until=2.0)).filter)
    one, other = made
    deviation = np.sqrt(np.diag(one.car.covariance))
    deviation[FORCE] = 1.0
    # They differ in when they linearise for the second sensor of an instant: the errorEKF carries accelerations on.
    assert np.abs((one.car.mean - other.car.mean) / deviation).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(other.car.covariance)), np.sqrt(np.diag(one.car.covariance)), rtol=0.05)


def test_where_the_state_is_well_known_the_ukf_is_the_dekf(independent: Vehicle) -> None:
    filters = [FILTERS[name].make(independent, Runner(independent).sensors) for name in ("dekf", "ukf")]
    for f in filters:
        f.start_rolling(15.0)
        f.car.mean[15], f.car.mean[19] = -0.2, 0.3
        f.inputs[:] = 0.05, 0.0, 0.0, 100.0, 100.0, 0.0
        f.car.covariance *= 1e-8
        f.linearize()
        f.predict(0.004)
        f.correct("imu", np.array([0.0, 0.0, 0.31, 0.4, 4.0, 9.8]), np.full(6, 1e-6), np.inf)
    dekf, ukf = filters
    deviation = np.sqrt(np.diag(dekf.car.covariance))
    known = deviation > 0
    # The model's step is stiffened against wheel slip, of which the Jacobian of the dynamics knows nothing.
    known[[*range(10, 14), *range(24, 28)]] = False
    assert np.abs((ukf.car.mean - dekf.car.mean)[known] / deviation[known]).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(ukf.car.covariance))[known], deviation[known], rtol=0.15)


@pytest.mark.parametrize("name", ["dekf", "ukf"])
def test_the_references_follow_a_lane_change(lane_change: Recording, vehicle: Vehicle, name: str) -> None:
    until = 3.0 if name == "dekf" else 1.0
    observer = feed(Runner(vehicle, lane_change.map_origin, FILTERS[name].make), messages(lane_change, until=until))
    truth = lane_change["reference/odometry"]
    i = int(np.searchsorted(truth.stamp, observer.stamp))
    estimate = observer.snapshot()
    np.testing.assert_allclose(estimate.velocity[:2], truth.columns["linear"][i, :2], atol=0.3)
    np.testing.assert_allclose(estimate.rates[2], truth.columns["angular"][i, 2], atol=0.05)
    assert (np.linalg.eigvalsh(observer.filter.car.covariance) > -1e-9).all()
