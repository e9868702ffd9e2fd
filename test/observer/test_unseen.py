"""What is published of the state is as wide as errors are that no innovation shows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vsense_ros.estimation.filter import Gaussian
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.schema.observer_settings import UnseenErrors
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.estimate import Estimate
from vsense_ros.observer.unseen import add_drift, add_tilt, turned
from vsense_ros.runner import Runner

NONE = UnseenErrors(rear_axle_direction=0.0, rear_slip=0.0, timing=0.0, yaw_rate=0.0, position_share=0.0, crossfall=0.0)


@pytest.fixture
def estimate(clean: Runner, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """Makes an estimate of the same state for a car with some unseen errors."""
    car = clean.filter.car  # type: ignore[attr-defined]

    def make(**errors: float) -> Estimate:
        unseen = NONE.model_copy(update=errors)
        observer = car.vehicle.observer.model_copy(update={"unseen": unseen})
        monkeypatch.setattr(car, "vehicle", car.vehicle.model_copy(update={"observer": observer}))
        return Estimate.of(clean.stamp, clean.filter)  # type: ignore[arg-type]

    return make


def test_side_slip_is_as_uncertain_as_the_direction_of_the_rear_axle(estimate) -> None:  # type: ignore[no-untyped-def]
    known, unknown = estimate(), estimate(rear_axle_direction=0.01)
    forward, lateral, _ = known.velocity
    added = unknown.side_slip[1] ** 2 - known.side_slip[1] ** 2
    assert added**0.5 == pytest.approx(0.01 * forward**2 / (forward**2 + lateral**2), rel=1e-6)
    assert unknown.pose_covariance[5, 5] - known.pose_covariance[5, 5] == pytest.approx(1e-4)


def test_a_tenth_of_the_slip_angle_of_the_rear_axle_is_as_much_heading_and_side_slip(estimate) -> None:  # type: ignore[no-untyped-def]
    known, unknown = estimate(), estimate(rear_slip=0.1)
    forward, lateral, _ = known.velocity
    slip = (lateral - known.vehicle.physics.chassis.cog_to_rear_axle * known.rates[2]) / forward
    heading = unknown.pose_covariance[5, 5] - known.pose_covariance[5, 5]
    sideways = unknown.twist_covariance[1, 1] - known.twist_covariance[1, 1]
    assert heading == pytest.approx((0.1 * slip) ** 2, rel=1e-6)
    assert sideways == pytest.approx((0.1 * slip * forward) ** 2, rel=1e-6)


def test_pitch_is_doubted_after_a_bend_as_in_it() -> None:
    """Roll that was wrong there made a grade, which the filter does not forget at once."""

    def pitch_variance(rate: float, bend: float) -> float:
        pose, rates = np.zeros((6, 6)), np.array([0.0, 0.0, rate])
        motion = SimpleNamespace(velocity=np.array([20.0, 0.0, 0.0]), rates=rates)
        add_tilt(pose, motion, np.array([0.0, 0.3**2]), 20.0, np.array(bend))  # type: ignore[arg-type]
        return float(pose[4, 4])

    within = pitch_variance(0.3, 0.0)
    assert within == pytest.approx((0.3 / GRAVITY * 0.3) ** 2)  # a roll of 0.3 / g, turned by 0.3 rad in 20 m
    assert pitch_variance(0.0, 0.3 / 20.0) == pytest.approx(within)
    assert pitch_variance(0.0, 0.0) == 0.0


def test_rear_tyres_may_slip_by_what_passed_for_a_bias_across_the_car() -> None:
    pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
    motion = SimpleNamespace(velocity=np.array([20.0, 0.0, 0.0]))
    add_drift(pose, twist, motion, np.array([9.0, 0.5**2]), 0.006)  # type: ignore[arg-type]
    assert pose[5, 5] == pytest.approx(0.003**2)  # 0.5 m/s² that no tyre holds
    assert twist[1, 1] == pytest.approx((0.003 * 20.0) ** 2)
    assert 0 < twist[5, 5] < pose[5, 5]  # a heading that is corrected in some seconds


@given(st.integers(0, 2**32 - 1))
def test_a_vector_is_turned_as_scipy_turns_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    rotation, vector = Rotation.random(rng=random), random.normal(size=3)
    assert turned(rotation.as_quat(), vector) == pytest.approx(rotation.apply(vector), abs=1e-14)


def test_a_state_is_as_uncertain_as_it_changes_within_the_error_of_the_time(estimate) -> None:  # type: ignore[no-untyped-def]
    """Twenty milliseconds at twenty metres a second are forty centimetres, in the direction of motion alone."""
    known, unknown = estimate(), estimate(timing=0.02)
    added = (unknown.pose_covariance - known.pose_covariance)[:2, :2]
    variances, directions = np.linalg.eigh(added)
    course = known.attitude[2] + np.arctan2(known.velocity[1], known.velocity[0])
    assert variances[1] ** 0.5 == pytest.approx(0.02 * np.hypot(*known.velocity[:2]), rel=1e-2)
    assert abs(variances[0]) < 1e-4 * variances[1]
    assert abs(directions[:, 1] @ [np.cos(course), np.sin(course)]) == pytest.approx(1.0, abs=1e-3)
    assert np.linalg.eigvalsh(unknown.twist_covariance).min() > 0


def test_the_filter_itself_and_what_it_estimates_stay_as_they_are(estimate, clean: Runner, vehicle: Vehicle) -> None:  # type: ignore[no-untyped-def]
    before = clean.filter.memory.copy()
    wide = estimate(rear_axle_direction=0.1, timing=0.1, yaw_rate=0.1, position_share=1.0, crossfall=0.1)
    np.testing.assert_array_equal(clean.filter.memory, before)
    assert wide.variance[YAW] == estimate().variance[YAW]
    assert wide.pose_covariance[0, 0] > vehicle.sensors["position"].deviations()[0] ** 2


def test_what_a_bias_has_beyond_its_deviation_may_be_the_slope_of_the_road(estimate, clean: Runner) -> None:  # type: ignore[no-untyped-def]
    """A lateral bias of half a metre per second squared, where the file has a tenth, is 2.9° of roll."""
    known = estimate()
    state, index = known.state.copy(), known.names.index("imu.accelerometer_bias_y")
    state[index] = 0.5
    deviation = known.car.prior.deviation[index]
    added = replace(known, belief=Gaussian(state, known.covariance)).pose_covariance - known.pose_covariance
    assert added[3, 3] == pytest.approx((0.25 - deviation**2) / 9.80665**2, rel=1e-3)
    assert added[4, 4] < 1e-2 * added[3, 3]  # the car goes straight
