"""Gauss-Newton over a whole run beside SciPy's least squares, and its standard deviations beside its errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from systems import CASES, NONLINEAR, Case, Truth, drive, measured
from test_consistency import followed, squared, within
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.iterated import IterationSettings, iterated
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.smoother import smoothed

EXACT = IterationSettings(most=30, change=1e-9)


def by_scipy(case: Case, record: Record, run: list[tuple[Array, list[Any]]]) -> tuple[Array, Array]:
    """States (k, n) with the largest likelihood, and their covariances (k, n, n), by least squares over all residuals
    of a run in one vector: start, steps by the model, measurements, each over its standard deviation."""
    start, dense, n, count = record.instants[0].before, case.dense(), len(case.start.mean), len(record.instants)
    root_of_start = np.linalg.cholesky(np.linalg.inv(start.covariance)).T

    def residuals(flat: Array) -> Array:
        x = flat.reshape(count, n)
        found = [root_of_start @ (x[0] - start.mean)]
        for k, (u, values) in enumerate(run, 1):
            dense.mean[:], dense.inputs[:] = x[k - 1], u
            moved, _, noise = dense.moved(case.h)
            found.append((x[k] - moved) / np.sqrt(noise.diagonal()))
            dense.mean[:] = x[k]
            for one in values:
                innovation, _ = dense.sense(one.sensor, one.value)
                found.append(innovation / np.sqrt(one.variance))
        return np.concatenate(found)

    first = np.concatenate([b.mean for b in smoothed(record)])
    solution = least_squares(residuals, first, method="trf", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac)
    blocks = [covariance[n * k : n * (k + 1), n * k : n * (k + 1)] for k in range(count)]
    return solution.x.reshape(count, n), np.array(blocks)


@pytest.mark.parametrize("name", ["pendulum", "single track"])
def test_equals_least_squares_over_all_residuals_of_a_run(name: str) -> None:
    case = CASES[name]
    run = measured(case, 30, every=2)
    record = case.begun(Record(Ekf(case.dense())))
    drive(record, case, run)
    found = iterated(record, EXACT)
    states, covariances = by_scipy(case, record, run)
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    apart = np.array([b.mean for b in found.beliefs]) - states
    assert np.max(np.abs(apart) / deviations) < 1e-3
    for belief, covariance in zip(found.beliefs, covariances, strict=True):
        np.testing.assert_allclose(belief.covariance, covariance, rtol=2e-2, atol=1e-4 * np.max(covariance))


def test_a_linear_run_is_solved_in_one_iteration_and_equals_the_smoother() -> None:
    case = CASES["heading"]
    record = case.begun(Record(Ekf(case.dense())))
    drive(record, case, measured(case, 40, every=3))
    once = smoothed(record)
    found = iterated(record, EXACT)
    assert found.iterations <= 2
    for one, other in zip(found.beliefs, once, strict=True):
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-7, atol=1e-13)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    case, found = NONLINEAR["pendulum"], []
    record, truth = Record(Ekf(case.dense())), Truth(case)
    for seed in range(100):
        truth.begin(np.random.default_rng(seed))
        start = truth.state.copy()
        followed(truth, seed, record, 30)
        belief = iterated(record).beliefs[0]
        found.append(squared(start - belief.mean, belief.covariance))
    assert within(np.array(found), 2)


def test_a_wrong_start_of_the_linearisation_is_mended_by_iterating() -> None:
    """A pendulum that is believed to hang, while it is held aside by more than a right angle, and hardly measured."""
    case = NONLINEAR["pendulum"]
    truth = Truth(case, np.random.default_rng(3))
    truth.state[:] = [2.0, 0.0]
    record = Record(Ekf(case.dense()))
    record.start(Gaussian(np.array([0.4, 0.0]), np.diag([1.5**2, 0.5**2])))
    states = [truth.state.copy()]
    for i in range(60):
        truth.step(np.zeros(0))
        states.append(truth.state.copy())
        record.predict(case.h)
        if i % 6 == 5:
            record.correct(*truth.measure(case.measurements[0]))
    once, again = smoothed(record), iterated(record).beliefs
    error = [np.abs([b.mean[0] - s[0] for b, s in zip(each, states, strict=True)]).max() for each in (once, again)]
    assert error[1] < 0.5 * error[0]


def test_a_measurement_outside_of_its_gate_of_the_trajectory_is_left_out() -> None:
    case = CASES["heading"]
    record = case.begun(Record(Ekf(case.dense())))
    run = measured(case, 40, every=3)
    drive(record, case, run)
    wild = next(i for i in record.instants if i.used).used
    wild[0] = wild[0]._replace(value=wild[0].value + 1.0, limit=9.0)
    without = iterated(record, EXACT).beliefs
    del wild[0]
    for one, other in zip(without, iterated(record, EXACT).beliefs, strict=True):
        np.testing.assert_allclose(one.mean, other.mean, atol=1e-9)
