"""Smoothers beside dynamax, and beside all of a linear run's equations solved at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from marks import exam_except
from oracles import DENSITY, MATRICES, dynamax_of
from systems import ATTITUDE, CASES, LINEAR, Case, Truth, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.smoother import FixedLag, smoothed


def recorded(case: Case, run: list[tuple[Array, list[Any]]]) -> Record:
    filter: Record = case.begun(Record(Ekf(case.dense())))
    drive(filter, case, run)
    return filter


@pytest.mark.parametrize("name", exam_except(["heading", "single track", "pendulum"], "pendulum"))
def test_equals_dynamax(name: str) -> None:
    pytest.importorskip("dynamax", reason="dynamax is not installed (requirements/dev.txt)")
    case = CASES[name]
    run = measured(case, 60, every=1)
    inputs, values = np.array([u for u, _ in run]), np.array([each[0].value for _, each in run])
    theirs = dynamax_of(name, case, inputs, values, "extended_kalman_smoother")
    filter = case.begun(Record(Ekf(case.dense())))
    filter.inputs[:] = inputs[0]
    filter.correct(*run[0][1][0])
    drive(filter, case, run[1:])
    ours = smoothed(filter)
    tolerance = {"rtol": 1e-8, "atol": 1e-9}  # dynamax inverts, and rounds more than half of the digits of P⁻ away
    np.testing.assert_allclose([b.mean for b in ours], theirs.smoothed_means, **tolerance)
    np.testing.assert_allclose([b.covariance for b in ours], theirs.smoothed_covariances, **tolerance)


def test_equals_least_squares_over_the_whole_run() -> None:
    """All states of a linear run from all its equations at once, each divided by its standard deviation."""
    name, count = "heading", 40
    case = LINEAR[name]
    run = measured(case, count, every=3)
    ours = smoothed(recorded(case, run))
    n, rows, right = 2, [], []

    def equation(parts: dict[int, Array], value: Array, deviations: Array) -> None:
        row = np.zeros((len(value), n * (count + 1)))
        for k, part in parts.items():
            row[:, n * k : n * (k + 1)] = part
        rows.append(row / deviations[:, None])
        right.append(value / deviations)

    equation({0: np.eye(n)}, case.start.mean, np.array(case.deviations))
    for k, (u, values) in enumerate(run, 1):
        now = MATRICES[name](u, case.h)
        equation({k: np.eye(n), k - 1: -now.f}, now.b, np.sqrt(DENSITY[name] * case.h))
        for one in values:
            equation({k: now.h[one.sensor]}, one.value, np.sqrt(one.variance))
    a = np.vstack(rows)
    q, r = np.linalg.qr(a)
    x = np.linalg.solve(r, q.T @ np.concatenate(right)).reshape(-1, n)
    root = np.linalg.inv(r)
    covariance = root @ root.T
    np.testing.assert_allclose([b.mean for b in ours], x, rtol=1e-7, atol=1e-9)
    for k, belief in enumerate(ours):
        block = covariance[n * k : n * (k + 1), n * k : n * (k + 1)]
        np.testing.assert_allclose(belief.covariance, block, rtol=1e-5, atol=1e-12)


def test_a_fixed_lag_equals_the_whole_of_a_run_that_ends_there() -> None:
    case, lag = LINEAR["velocity"], 15
    run = measured(case, 40)
    filter = case.begun(FixedLag(Ekf(case.dense()), lag))
    drive(filter, case, run)
    time, belief = filter.delayed()
    whole = smoothed(recorded(case, run))[40 - lag]
    assert time == pytest.approx(0.25)
    np.testing.assert_allclose(belief.mean, whole.mean, rtol=1e-12)
    np.testing.assert_allclose(belief.covariance, whole.covariance, rtol=1e-9, atol=1e-15)


def test_what_came_later_helps_with_attitudes_too() -> None:
    random = np.random.default_rng(1)
    truth, filter = Truth(ATTITUDE, random), ATTITUDE.begun(Record(Ekf(ATTITUDE.dense())))
    states = [truth.state.copy()]
    for i in range(400):
        u = np.array(ATTITUDE.inputs(i * ATTITUDE.h))
        truth.step(u)
        states.append(truth.state.copy())
        filter.inputs[:] = u
        filter.predict(ATTITUDE.h)
        if i % 20 == 19:
            for one in ATTITUDE.measurements:
                filter.correct(*truth.measure(one))
    dense = filter.system
    before = np.array([dense.difference(s, i.after.mean) for s, i in zip(states, filter.instants, strict=True)])
    after = np.array([dense.difference(s, b.mean) for s, b in zip(states, smoothed(filter), strict=True)])
    assert np.sqrt((after[:, :3] ** 2).mean()) < 0.7 * np.sqrt((before[:, :3] ** 2).mean())
    spread = np.array([np.sqrt(np.diag(b.covariance)) for b in smoothed(filter)])
    assert (np.abs(after) < 5 * spread).all()


def test_states_that_are_known_exactly_are_smoothed_too() -> None:
    case = LINEAR["heading"]
    filter = recorded(case, measured(case, 10))
    for instant in filter.instants:
        instant.before.covariance[1] = instant.before.covariance[:, 1] = 0.0
        instant.after.covariance[1] = instant.after.covariance[:, 1] = 0.0
    assert all(np.isfinite(b.mean).all() for b in smoothed(filter))


def test_a_system_without_a_state_space_cannot_be_recorded() -> None:
    class Other:
        memory = mean = covariance = inputs = np.zeros((1, 1))
        names = sensors = ()
        operations = None

    with pytest.raises(InputError, match="only filters of a state space can be recorded, not one of Other"):
        Record(Ekf(Other()))  # type: ignore[arg-type]
