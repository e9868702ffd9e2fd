"""Errors are as large as filters say: normalized estimation errors squared over 100 runs of the system they assume."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from systems import ATTITUDE, CASES, IMU, LINEAR, NONLINEAR, SALOON, Case, Pendulum, SingleTrack, Truth, continuous
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.cekf import ContinuousSettings
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.smoother import smoothed
from vsense_ros.estimation.ukf import Ukf

SEEDS, STEPS, EVERY = 100, 60, 3
SYSTEMS = {name: CASES[name] for name in ("heading", "velocity", "single track", "pendulum")} | {"attitude": ATTITUDE}


def within(values: Array, degrees: int) -> bool:
    """True if a mean of normalized errors squared lies between the bounds that it leaves once in twenty times."""
    low, high = chi2.ppf([0.025, 0.975], degrees * len(values)) / len(values)
    return bool(low < values.mean() < high)


def followed(truth: Truth, seed: int, filter: Any, steps: int = STEPS, start: Gaussian | None = None) -> Array:
    """The true state after a run that the filter has followed, from its own start or from that of the system."""
    case = truth.case
    truth.begin(np.random.default_rng(seed))
    filter.inputs[:] = case.inputs(0.0)
    filter.start(case.start if start is None else start)
    for i in range(1, steps + 1):
        u = np.array(case.inputs(i * case.h), dtype=float)
        truth.step(u)
        filter.inputs[:] = u
        filter.predict(case.h)
        if i % EVERY == 0:
            for one in case.measurements:
                filter.correct(*truth.measure(one))
    return truth.state.copy()


def squared(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error))


FILTERS: dict[str, Callable[[Case], Any]] = {
    "extended": lambda case: Ekf(case.dense()),
    "unscented": lambda case: Ukf(case.system, case.measurements, case.parameters),
}


@pytest.mark.parametrize("way", FILTERS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_errors_are_as_large_as_the_filter_says(name: str, way: str) -> None:
    case = SYSTEMS[name]
    filter, dense, truth = FILTERS[way](case), case.dense(), Truth(case)
    found = []
    for seed in range(SEEDS):
        state = followed(truth, seed, filter)
        found.append(squared(dense.difference(state, filter.mean.copy()), filter.covariance))
    assert within(np.array(found), len(case.deviations))


@pytest.mark.parametrize("name", ["heading", "pendulum"])
def test_errors_are_as_large_as_the_smoother_says(name: str) -> None:
    case, found = SYSTEMS[name], []
    filter, truth = Record(Ekf(case.dense())), Truth(case)
    for seed in range(SEEDS):
        truth.begin(np.random.default_rng(seed))
        start = truth.state.copy()
        followed(truth, seed, filter, 30)
        belief = smoothed(filter)[0]
        found.append(squared(start - belief.mean, belief.covariance))
    assert within(np.array(found), 2)


PRIOR = {"front_stiffness": 15e3, "rear_stiffness": 15e3}
IDENTIFYING: dict[str, Callable[[], Any]] = {
    "extended": lambda: Ekf(Dense(Augmented(SingleTrack(), dict.fromkeys(PRIOR, 0.0)), [IMU], _rest())),
    "unscented": lambda: Ukf(Augmented(SingleTrack(), dict.fromkeys(PRIOR, 0.0)), [IMU], _rest()),
}


def _rest() -> dict[str, float]:
    return {name: value for name, value in SALOON.items() if name not in PRIOR}


@pytest.mark.parametrize("way", IDENTIFYING)
def test_errors_of_identified_parameters_are_as_large_as_the_filter_says(way: str) -> None:
    """The true stiffnesses are drawn anew in each run from what the filter is told at the start."""
    base, filter, found = LINEAR["single track"], IDENTIFYING[way](), []
    truth = Truth(base)
    nominal = np.array([SALOON[name] for name in PRIOR])
    for seed in range(SEEDS):
        drawn = nominal + np.random.default_rng(1000 + seed).normal(size=2) * list(PRIOR.values())
        truth.parameters(SALOON | _named(drawn))
        deviations = np.array([*base.deviations, *PRIOR.values()])
        begin = Gaussian(np.array([*base.mean, *nominal]), np.diag(deviations**2))
        state = followed(truth, seed, filter, 100, begin)
        belief = filter.belief()
        found.append(squared(np.array([*state, *drawn]) - belief.mean, belief.covariance))
    assert within(np.array(found), 4)


def _named(values: Array) -> dict[str, float]:
    return dict(zip(PRIOR, values.tolist(), strict=True))


def test_innovations_are_white_and_of_unit_deviation() -> None:
    case, whitened = NONLINEAR["pendulum"], []
    filter, truth = case.begun(Ekf(case.dense())), Truth(case, np.random.default_rng(0))
    for _ in range(4000):
        truth.step(np.zeros(0))
        filter.predict(case.h)
        whitened.append(filter.correct(*truth.measure(case.measurements[0])).whitened.copy())
    found = np.array(whitened)
    assert found.std(axis=0) == pytest.approx(1.0, abs=4 / np.sqrt(2 * 4000))
    following = (found[1:] * found[:-1]).mean(axis=0)
    assert (np.abs(following) < 4 / np.sqrt(4000)).all()


def test_errors_are_as_large_as_the_continuous_filter_says_where_measurements_are_frequent() -> None:
    """Its measurements act for all of the period that follows them, so that they are used one period later."""
    case, found = LINEAR["heading"], []
    filter = continuous(case, ContinuousSettings(longest_step=case.h))
    truth = Truth(case)
    for seed in range(SEEDS):
        state = followed(truth, seed, filter, 60)
        found.append(squared(state - filter.mean, filter.covariance))
    assert 0.5 * 2 < np.mean(found) < 1.5 * 2


def test_a_wrong_filter_is_found_out() -> None:
    """One that takes a tenth of the noise leaves the bounds: they can tell."""

    class Overconfident(Pendulum):
        def noise(self, x: Any, u: Any, theta: Any, h: Any) -> Any:
            return [1e-8 * h, 1e-4 * h]

    case = NONLINEAR["pendulum"]
    filter = Ekf(Dense(Overconfident(), case.measurements, case.parameters))
    found, truth = [], Truth(case)
    for seed in range(SEEDS):
        state = followed(truth, seed, filter)
        found.append(squared(state - filter.mean, filter.covariance))
    assert not within(np.array(found), 2)
