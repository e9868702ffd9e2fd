"""Particles: on a linear system they have the Kalman filter's mean and covariance, and do the same again."""

from __future__ import annotations

import numpy as np
import pytest

from systems import BOB, COURSE, LINEAR, NONLINEAR, VELOCITY, Attitude, YawKkf, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.particle import ParticleFilter, ParticleSettings

HEADING = LINEAR["heading"]


def particles(name: str = "heading", count: int = 20000) -> ParticleFilter:
    case = {**LINEAR, **NONLINEAR}[name]
    made: ParticleFilter = case.begun(
        ParticleFilter(case.system, case.measurements, case.parameters, ParticleSettings(count))
    )
    return made


@pytest.mark.parametrize("name", ["heading", "velocity"])
def test_on_a_linear_system_it_is_the_kalman_filter(name: str) -> None:
    case = LINEAR[name]
    kalman, other = case.begun(Ekf(case.dense())), particles(name)
    run = measured(case, 10)  # biases hardly move, so that more corrections leave few values of them
    exact, sampled = drive(kalman, case, run), drive(other, case, run)
    deviation = np.sqrt(np.diag(kalman.covariance))
    assert (np.abs(other.mean - kalman.mean) < 0.4 * deviation).all()
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)), deviation, rtol=0.15)
    for a, b in zip(exact, sampled, strict=True):
        assert b.nis == pytest.approx(a.nis, rel=0.2, abs=0.2)
        np.testing.assert_allclose(b.factor, a.factor, rtol=0.1, atol=0.02)


def test_absent_components_are_left_out() -> None:
    case = LINEAR["velocity"]
    kalman, other = case.begun(Ekf(case.dense())), particles("velocity")
    for filter in (kalman, other):
        innovation = filter.correct("velocity", np.array([np.nan, 0.3]), VELOCITY.variances)
        assert np.isnan(innovation.whitened[0])
        assert innovation.accepted
    deviation = np.sqrt(np.diag(kalman.covariance))
    assert (np.abs(other.mean - kalman.mean) < 0.1 * deviation).all()
    nothing = other.correct("velocity", np.full(2, np.nan), VELOCITY.variances)
    assert (nothing.nis, nothing.accepted) == (-1.0, False)


def test_a_refused_measurement_changes_nothing() -> None:
    filter = particles()
    before = filter.memory.copy()
    innovation = filter.correct("course", np.array([2.0]), COURSE.variances, limit=9.0)
    assert innovation.nis > 9.0
    assert not innovation.accepted
    assert (filter.memory == before).all()


def test_a_scale_makes_a_measurement_count_less() -> None:
    free, scaled = particles(), particles()
    free.correct("course", np.array([0.1]), COURSE.variances)
    scaled.correct("course", np.array([0.1]), COURSE.variances, scale=16.0)
    kalman = 1 / (1 / 0.01 + 1 / (16 * COURSE.variances[0]))
    assert scaled.covariance[0, 0] == pytest.approx(kalman, rel=0.05)
    assert free.covariance[0, 0] < 0.5 * scaled.covariance[0, 0]


def test_particles_are_drawn_anew_when_few_have_all_the_weight_and_not_before() -> None:
    filter = particles()
    filter.correct("course", np.array([0.1]), np.array([1.0]))  # says hardly anything
    assert np.ptp(filter.log_weights) > 0
    filter.correct("course", np.array([0.1]), np.array([1e-5]))
    assert np.ptp(filter.log_weights) == 0
    np.testing.assert_allclose(np.exp(filter.log_weights).sum(), 1.0)
    assert filter.covariance[0, 0] < 4e-5


def test_drawn_anew_they_have_the_distribution_that_the_weights_had() -> None:
    filter = particles()
    weights = np.exp(filter.log_weights - 0.5 * (filter.cloud[0] - 0.15) ** 2 / 0.0004)
    weights /= weights.sum()
    mean = filter.cloud @ weights
    off = filter.cloud - mean[:, None]
    filter.correct("course", np.array([0.15]), np.array([0.0004]))
    np.testing.assert_allclose(filter.mean, mean, atol=1e-3)
    np.testing.assert_allclose(filter.covariance, off * weights @ off.T, rtol=0.05, atol=1e-5)


def test_a_particle_without_any_weight_is_never_drawn() -> None:
    for seed in range(20):
        filter = ParticleFilter(YawKkf(), [COURSE], settings=ParticleSettings(10, seed))
        filter.start(Gaussian(np.array([0.1, 0.0]), np.diag([1e-4, 1e-8])))
        for place in (0, 9):
            filter.cloud[0, place] = 3.0
        filter.correct("course", np.array([0.1]), np.array([1e-6]))
        assert np.ptp(filter.log_weights) == 0, "they were drawn anew"
        assert filter.cloud[0].max() < 1.0


def test_put_back_it_draws_the_same_numbers_again_and_others_later() -> None:
    filter = particles(count=50)
    kept, ends = filter.memory.copy(), []
    for _ in range(2):
        filter.memory[:] = kept
        filter.predict(0.01)
        ends.append(filter.memory.copy())
    assert (ends[0] == ends[1]).all()
    first = ends[0][-50:] - kept[-50:]
    filter.predict(0.01)
    assert not np.allclose(filter.memory[-50:] - ends[1][-50:], first)


def test_a_state_that_does_not_move_at_random_stays_exactly() -> None:
    filter = ParticleFilter(YawKkf(0.0, 0.0), [COURSE], settings=ParticleSettings(100))
    filter.inputs[:] = 0.5
    filter.start(Gaussian(np.array([0.0, 0.0]), np.diag([0.0, 0.0])))
    filter.predict(0.1)
    np.testing.assert_allclose(filter.cloud, np.tile([[0.05], [0.0]], 100), atol=1e-15)


def test_less_trust_is_twice_the_deviation_and_no_correlation() -> None:
    filter = particles()
    drive(filter, HEADING, measured(HEADING, 20))
    before = np.diag(filter.covariance).copy()
    filter.inflate()
    np.testing.assert_allclose(np.diag(filter.covariance), 4 * before, rtol=0.05)
    correlation = filter.covariance[0, 1] / np.sqrt(np.prod(np.diag(filter.covariance)))
    assert abs(correlation) < 0.05


def test_particles_that_are_no_numbers_are_not_valid() -> None:
    filter = particles(count=50)
    assert filter.is_valid()
    filter.cloud[0, 3] = np.nan
    assert not filter.is_valid()


def test_on_a_pendulum_it_follows_as_the_kalman_filter_does() -> None:
    case = NONLINEAR["pendulum"]
    kalman, other = case.begun(Ekf(case.dense())), particles("pendulum", 5000)
    run = measured(case, 50, every=1)
    for filter in (kalman, other):
        drive(filter, case, run)
    assert BOB.name in other.sensors
    assert (np.abs(other.mean - kalman.mean) < 0.3 * np.sqrt(np.diag(kalman.covariance))).all()


def test_says_what_it_cannot_do() -> None:
    with pytest.raises(InputError, match="the states of Attitude are no vector"):
        ParticleFilter(Attitude(), [])
    with pytest.raises(InputError, match="no sensor 'speed'"):
        particles(count=5).correct("speed", np.zeros(1), np.ones(1))
    with pytest.raises(InputError, match="has 1 variances, but got"):
        particles(count=5).correct("course", np.zeros(1), np.ones(2))
    filter = particles(count=5)
    filter.inputs[:] = np.nan
    with pytest.raises(FloatingPointError, match="YawKkf cannot be moved"):
        filter.predict(0.1)
