"""The continuous filter: where it equals the discrete one, and where it breaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from systems import ATTITUDE, COURSE, GRAVITY, LINEAR, Attitude, YawKkf, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.cekf import Cekf
from vsense_ros.estimation.ekf import Ekf


def heading(period: float, longest_step: float = 0.01, adaptive: bool = True) -> Cekf:
    case = LINEAR["heading"]
    steps = {"longest_step": longest_step, "adaptive": adaptive}
    made: Cekf = case.begun(Cekf(YawKkf(), [COURSE], periods={"course": period}, **steps))
    return made


def test_the_covariance_settles_where_the_algebraic_riccati_equation_has_it() -> None:
    period, case = 0.02, LINEAR["heading"]
    filter = case.begun(Cekf(YawKkf(0.1, 0.1), [COURSE], periods={"course": period}, longest_step=period))
    for _ in range(1000):
        filter.correct(*COURSE.measured([0.0]))
        filter.predict(period)
    a, h = np.array([[0.0, -1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    expected = solve_continuous_are(a.T, h.T, np.diag([0.01, 0.01]), np.array([[0.02**2 * period]]))
    np.testing.assert_allclose(filter.covariance, expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["heading", "single track"])
def test_equals_the_discrete_filter_where_measurements_are_frequent(name: str) -> None:
    case = replace(LINEAR[name], h=0.001)
    run = measured(case, 600, every=1)
    discrete = case.begun(Ekf(case.dense()))
    periods = {one.name: case.h for one in case.measurements}
    continuous = case.begun(Cekf(case.system, case.measurements, case.parameters, periods=periods, longest_step=case.h))
    for filter in (discrete, continuous):
        drive(filter, case, run[:-1])
    before = discrete.mean.copy()
    for filter in (discrete, continuous):
        drive(filter, case, run[-1:])
    sigma, late = np.sqrt(np.diag(discrete.covariance)), np.abs(discrete.mean - before)  # what a period changes
    assert (np.abs(continuous.mean - discrete.mean) < 0.5 * sigma + late).all()
    np.testing.assert_allclose(np.sqrt(np.diag(continuous.covariance)), sigma, rtol=0.1)


def test_a_held_measurement_is_of_the_past_where_they_are_rare() -> None:
    """A heading that turns at 0.5 rad/s, measured exactly once in a period: the error grows with the period."""
    errors = []
    for period in (0.05, 0.2, 2.0):
        filter, yaw = heading(period), 0.1
        filter.inputs[:] = 0.5
        for _ in range(int(10 / period)):
            filter.correct(*COURSE.measured([yaw]))
            filter.predict(period)
            yaw += 0.5 * period
        errors.append(abs(filter.mean[0] - yaw))
    assert errors[0] < 0.03
    assert errors[0] < errors[1] < errors[2]
    assert errors[2] > 0.1


def test_integrated_at_a_low_sampling_rate_it_loses_its_covariance(caplog: pytest.LogCaptureFixture) -> None:
    """Where the gain times the step is more than the method is stable for."""
    case, period = LINEAR["heading"], 0.5
    sampled = {"periods": {"course": period}, "longest_step": period}
    for adaptive, told in ((True, False), (False, True)):
        filter = case.begun(Cekf(YawKkf(0.5), [COURSE], **sampled, adaptive=adaptive))
        for _ in range(20):
            filter.correct(*COURSE.measured([0.0]))
            filter.predict(period)
        assert ("not positive definite any more" in caplog.text) == told


def test_leaves_the_finite_where_its_steps_are_too_long() -> None:
    filter = heading(0.001, longest_step=1.0, adaptive=False)
    filter.covariance[:] = np.eye(2) * 100
    filter.correct(*COURSE.measured([0.0]))
    with pytest.raises(FloatingPointError, match="left the finite"):
        filter.predict(20.0)


def test_a_refused_measurement_does_not_act() -> None:
    filter, quiet = heading(0.01), heading(0.01)
    refused = filter.correct("course", np.array([2.0]), COURSE.variances, limit=9.0)
    assert not refused.accepted
    for one in (filter, quiet):
        one.predict(0.1)
    assert (filter.mean == quiet.mean).all()


def test_memory_that_is_put_back_gives_the_same_bits() -> None:
    filter = heading(0.01)
    filter.correct(*COURSE.measured([0.2]))
    kept = filter.memory.copy()
    filter.predict(0.05)
    after = filter.memory.copy()
    filter.memory[:] = kept
    filter.predict(0.05)
    assert (filter.memory == after).all()


def test_says_what_it_cannot_do() -> None:
    with pytest.raises(InputError, match="period \\[s\\] of 'course'"):
        Cekf(YawKkf(), [COURSE], periods={})
    with pytest.raises(InputError, match="Attitude is no vector space"):
        Cekf(Attitude(), [GRAVITY], periods={"gravity": ATTITUDE.h})
    with pytest.raises(InputError, match="no sensor 'speed'"):
        heading(0.01).correct("speed", np.zeros(1), np.ones(1))
    with pytest.raises(InputError, match="'course' has 1 components, but got 2"):
        heading(0.01).correct("course", np.zeros(2), np.ones(2))
