"""The observers that others are compared with: the textbook's EKF and UKF over the whole state."""

from __future__ import annotations

import numpy as np
import pytest

from drives import feed, messages
from vsense_ros.messages.recording import Recording
from vsense_ros.model.observer_settings import ForceErrors
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import Observer
from vsense_ros.observer.dekf import Dekf
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import FORCE
from vsense_ros.observer.ukf import Ukf

NAMES = ("longitudinal", "lateral", "vertical", "roll", "pitch", "yaw", "suspension", "wheel_spin")


@pytest.fixture
def believing(vehicle: Vehicle) -> Vehicle:
    """A car of which its observer believes that nothing is missing."""
    errors = ForceErrors(**dict.fromkeys(NAMES, 0.0))
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"force_errors": errors})})


def test_without_force_errors_the_errorekf_and_the_dekf_are_one_filter(
    lane_change: Recording, believing: Vehicle
) -> None:
    made = []
    for kind in (ErrorEkf, Dekf):
        made.append(feed(Observer(believing, lane_change.map_origin, kind), messages(lane_change, until=2.0)).filter)
    one, other = made
    deviation = np.sqrt(np.diag(one.covariance))
    deviation[FORCE] = 1.0
    # They differ in when they linearise for the second sensor of an instant: the errorEKF carries accelerations on.
    assert np.abs((one.state - other.state) / deviation).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)), np.sqrt(np.diag(one.covariance)), rtol=0.05)


def test_where_the_state_is_well_known_the_ukf_is_the_dekf(vehicle: Vehicle) -> None:
    filters = [kind(vehicle, Observer(vehicle).sensors) for kind in (Dekf, Ukf)]
    for f in filters:
        f.start(15.0)
        f.state[15], f.state[19] = -0.2, 0.3
        f.inputs[:] = 0.05, 0.0, 0.0, 100.0, 100.0
        f.covariance *= 1e-8
        f.linearize()
        f.predict(0.004)
        f.linearize()
        f.correct(0, np.array([0.0, 0.0, 0.31, 0.4, 4.0, 9.8]), np.full(6, 1e-6), np.inf)
    dekf, ukf = filters
    deviation = np.sqrt(np.diag(dekf.covariance))
    known = deviation > 0
    # The model's step is stiffened against wheel slip, of which the Jacobian of the dynamics knows nothing.
    known[[*range(10, 14), *range(24, 28)]] = False
    assert np.abs((ukf.state - dekf.state)[known] / deviation[known]).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(ukf.covariance))[known], deviation[known], rtol=0.15)


@pytest.mark.parametrize("kind", [Dekf, Ukf])
def test_the_references_follow_a_lane_change(lane_change: Recording, vehicle: Vehicle, kind: type[ErrorEkf]) -> None:
    until = 3.0 if kind is Dekf else 1.0
    observer = feed(Observer(vehicle, lane_change.map_origin, kind), messages(lane_change, until=until))
    truth = lane_change["reference/odometry"]
    i = int(np.searchsorted(truth.stamp, observer.stamp))
    estimate = observer.snapshot()
    np.testing.assert_allclose(estimate.velocity[:2], truth.columns["linear"][i, :2], atol=0.3)
    np.testing.assert_allclose(estimate.rates[2], truth.columns["angular"][i, 2], atol=0.05)
    assert (np.linalg.eigvalsh(observer.filter.covariance) > -1e-9).all()
