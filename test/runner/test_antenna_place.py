"""A GNSS antenna that sits elsewhere than the vehicle file says: the filter takes it to be where the courses say."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.coordinates import YAW
from vsense_ros.observer.state import FORWARD, LATERAL, YAW_RATE, X, Y
from vsense_ros.runner import Runner
from vsense_ros.runner.adapter import Apart
from vsense_ros.runner.multibody import SETTINGS, CarAdapter

HEADING, RATE, AHEAD = 0.7, 0.4, -1.8  # [rad], [rad/s], [m]


@pytest.fixture
def adapter() -> CarAdapter:
    """That of a car which turns."""
    found = Runner(load_vehicle(vehicle_path("prototype_model"))).adapter
    assert isinstance(found, CarAdapter)
    found.filter.start_rolling(6.0)
    found.car.mean[[YAW, YAW_RATE]] = HEADING, RATE
    found.filter.linearize()
    return found


def expected(adapter: CarAdapter, sensor: str) -> np.ndarray:
    innovation, _ = adapter.car.sense(sensor, np.zeros(2))
    return -innovation


def test_an_antenna_further_back_is_expected_where_a_rigid_body_has_it(adapter):
    before = {sensor: expected(adapter, sensor) for sensor in ("position", "velocity")}
    adapter.place_antennas(AHEAD, 0.0)
    back = AHEAD * np.array([cos(HEADING), sin(HEADING)])
    across = RATE * AHEAD * np.array([-sin(HEADING), cos(HEADING)])
    np.testing.assert_allclose(expected(adapter, "position") - before["position"], back, atol=1e-12)
    np.testing.assert_allclose(expected(adapter, "velocity") - before["velocity"], across, atol=1e-12)


def test_it_is_moved_from_where_the_file_has_it_however_often_it_is_found(adapter):
    adapter.place_antennas(-0.9, 0.0)
    adapter.place_antennas(AHEAD, 0.0)
    once = Runner(adapter.vehicle).adapter
    once.place_antennas(AHEAD, 0.0)
    for found in (adapter, once):
        assert found.car.sensed["position"].mounting[0] == adapter.sensors["position"].mounting()[0] + AHEAD


def test_a_place_that_is_doubted_along_the_car_is_uncertain_in_the_direction_in_which_it_points(adapter):
    known = adapter.snapshot(0).pose_covariance
    adapter.widen_published(doubted := adapter.snapshot(0), Apart(along=1.5))
    ahead, left = np.array([[cos(HEADING), sin(HEADING)], [-sin(HEADING), cos(HEADING)]])
    added = (doubted.pose_covariance - known)[:2, :2]
    assert ahead @ added @ ahead == pytest.approx(1.5**2)
    assert abs(left @ added @ left) < 1e-12


def test_place_velocity_and_heading_are_doubted_by_what_the_old_place_did_to_them(adapter):
    variance = {one.element: one.variance for one in adapter.place_antennas(AHEAD, 0.05)}
    assert variance[X] == variance[Y] == pytest.approx(AHEAD**2)
    assert variance[YAW] == pytest.approx((0.05 * AHEAD) ** 2)
    assert variance[LATERAL] == pytest.approx((6.0 * 0.05 * AHEAD) ** 2)
    assert variance[FORWARD] == 0.0
    turned = {one.element: one.variance for one in adapter.place_antennas(10 * AHEAD, 1.0)}[YAW]
    assert turned == pytest.approx(SETTINGS.turned**2)
