"""The continuous filter: where it equals the discrete one, and where holding a measurement makes it wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from systems import ATTITUDE, COURSE, LINEAR, Case, YawKkf, continuous, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.cekf import Cekf, ContinuousSettings
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian

HEADING = LINEAR["heading"]


def heading(settings: ContinuousSettings | None = None, noise: float = 0.005, drift: float = 1e-5) -> Cekf:
    made: Cekf = HEADING.begun(continuous(replace(HEADING, system=YawKkf(noise, drift)), settings))
    return made


def refuse(filter: Cekf) -> None:
    """A measurement that does not act, from which on the period until the next one counts."""
    filter.correct("course", np.array([0.1]), COURSE.variances, limit=-1.0)


@pytest.mark.parametrize("step", [0.002, 0.02])
def test_the_covariance_settles_where_the_algebraic_riccati_equation_has_it(step: float) -> None:
    """Kalman & Bucy 1961, solved by SciPy; in the long step the discretised noise is what differs."""
    period = 0.02
    filter = heading(ContinuousSettings(longest_step=step), 0.1, 0.1)
    for _ in range(1000):
        filter.correct(*COURSE.measured([0.0]))
        filter.predict(period)
    a, h = np.array([[0.0, -1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    expected = solve_continuous_are(a.T, h.T, np.diag([0.01, 0.01]), np.array([[0.02**2 * period]]))
    np.testing.assert_allclose(filter.covariance, expected, rtol=20 * step, atol=20 * step * 1e-4)


@pytest.mark.parametrize("case", [HEADING, LINEAR["single track"], ATTITUDE])
def test_equals_the_discrete_filter_where_measurements_are_frequent(case: Case) -> None:
    case = replace(case, h=0.002)
    run = measured(case, 300, every=1)
    discrete = case.begun(Ekf(case.dense()))
    other = case.begun(continuous(case))
    for filter in (discrete, other):
        drive(filter, case, run[:-1])
    before = discrete.mean.copy()
    for filter in (discrete, other):
        drive(filter, case, run[-1:])
    sigma, change = np.sqrt(np.diag(discrete.covariance)), np.abs(case.dense().difference(discrete.mean, before))
    apart = np.abs(case.dense().difference(other.mean, discrete.mean))
    assert (apart < 0.5 * sigma + change).all()
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)), sigma, rtol=0.1)


def test_a_held_measurement_is_of_the_past_where_they_are_rare() -> None:
    """A heading that turns at 0.5 rad/s, measured exactly once in a period: the error grows with the period."""
    errors = []
    for period in (0.05, 0.2, 2.0):
        filter, yaw = heading(ContinuousSettings(longest_step=0.01)), 0.1
        filter.inputs[:] = 0.5
        for _ in range(int(10 / period)):
            filter.correct(*COURSE.measured([yaw]))
            filter.predict(period)
            yaw += 0.5 * period
        errors.append(abs(filter.mean[0] - yaw))
    assert errors[0] < 0.03
    assert errors[0] < errors[1] < errors[2]
    assert errors[2] > 0.1


def test_a_measurement_acts_for_as_long_as_those_of_its_sensor_are_apart() -> None:
    """In one period it removes what a discrete measurement removes, whatever the period is, as no noise comes in."""
    for period in (0.01, 0.1, 1.0):
        filter = heading(None, 0.0, 0.0)
        filter.covariance[:] = np.diag([0.01, 0.0])
        filter.correct(
            "course", np.array([0.1]), COURSE.variances, limit=-1.0
        )  # begins the period, and does not act itself
        filter.predict(period)
        filter.correct(*COURSE.measured([0.1]))
        filter.predict(period)
        assert 1 / filter.covariance[0, 0] == pytest.approx(1 / 0.01 + 1 / COURSE.variances[0], rel=1e-9)


def test_the_first_measurement_acts_as_that_of_a_sensor_that_was_silent_for_long() -> None:
    """No period is known yet, and a short one would believe it at once."""
    filter = heading(None, 0.0, 0.0)
    filter.covariance[:] = np.diag([0.01, 0.0])
    filter.correct(*COURSE.measured([0.1]))
    filter.predict(2.0)
    assert 1 / filter.covariance[0, 0] == pytest.approx(1 / 0.01 + 1 / COURSE.variances[0], rel=1e-9)


@pytest.mark.parametrize(("apart", "taken"), [(1e-4, 0.002), (30.0, 2.0)])
def test_periods_that_are_implausible_are_limited(apart: float, taken: float) -> None:
    filter = heading(None, 0.0, 0.0)
    refuse(filter)
    filter.predict(apart)
    filter.covariance[:] = np.diag([0.01, 0.0])
    filter.correct(*COURSE.measured([0.1]))
    filter.predict(taken)
    assert 1 / filter.covariance[0, 0] == pytest.approx(1 / 0.01 + 1 / COURSE.variances[0], rel=1e-9)


def test_integrated_at_a_low_sampling_rate_it_keeps_a_positive_definite_covariance() -> None:
    """An explicit method would lose it: the gain times the step is far beyond what that is stable for."""
    filter = heading(ContinuousSettings(longest_step=0.5), 0.5)
    for _ in range(20):
        filter.correct(*COURSE.measured([0.0]))
        filter.predict(0.5)
        assert np.linalg.eigvalsh(filter.covariance)[0] > 0


def test_a_state_that_leaves_the_finite_is_an_error() -> None:
    filter = heading()
    filter.inputs[:] = np.nan
    with pytest.raises(FloatingPointError):
        filter.predict(0.01)


def test_a_refused_measurement_does_not_act() -> None:
    filter, quiet = heading(), heading()
    refused = filter.correct("course", np.array([2.0]), COURSE.variances, limit=9.0)
    assert not refused.accepted
    for one in (filter, quiet):
        one.predict(0.1)
    assert (filter.mean == quiet.mean).all()


def test_a_refused_measurement_ends_what_the_one_before_did() -> None:
    filter = heading(None, 0.0, 0.0)
    filter.correct(*COURSE.measured([0.2]))
    filter.predict(0.1)
    filter.correct("course", np.array([2.0]), COURSE.variances, limit=9.0)
    kept = filter.covariance.copy()
    filter.predict(0.1)
    assert filter.covariance[1, 1] == pytest.approx(kept[1, 1])


def test_a_filter_that_starts_again_has_measured_nothing() -> None:
    filter, fresh = heading(), heading()
    filter.correct(*COURSE.measured([0.5]))
    filter.predict(0.05)
    filter.start(Gaussian(fresh.mean.copy(), fresh.covariance.copy()))
    for one in (filter, fresh):
        one.predict(0.05)
    assert (filter.mean == fresh.mean).all()
    assert (filter.covariance == fresh.covariance).all()


def test_memory_that_is_put_back_gives_the_same_bits() -> None:
    filter = heading()
    filter.correct(*COURSE.measured([0.2]))
    kept = filter.memory.copy()
    filter.predict(0.05)
    after = filter.memory.copy()
    filter.memory[:] = kept
    filter.predict(0.05)
    assert (filter.memory == after).all()


def test_says_what_it_cannot_do() -> None:
    with pytest.raises(InputError, match="no sensor 'speed'"):
        heading().correct("speed", np.zeros(1), np.ones(1))
    with pytest.raises(InputError, match="'course' has 1 components, but got 2"):
        heading().correct("course", np.zeros(2), np.ones(2))
