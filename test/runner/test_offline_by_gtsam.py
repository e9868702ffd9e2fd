"""The reference of `vsense smooth` beside GTSAM: the same measurements as a factor graph, solved by another library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vsense_ros as vs
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.iterated import Iterated, IterationSettings, iterated
from vsense_ros.estimation.record import Record
from vsense_ros.runner import smoothing
from vsense_ros.runner.smoothing import run_offline

gtsam = pytest.importorskip("gtsam", reason="the oracle GTSAM is not installed (pip install gtsam)")
pytestmark = pytest.mark.exam

BAG = Path(__file__).parents[2] / "bags" / "double_lane_change"
EXACT = IterationSettings(most=30, change=1e-9)
WALK = 1e-3  # of the prior deviation of each state, by which all of them change in a step: a graph has no constants


def all_walk(system: Dense, deviations: Array) -> None:
    """Let no state of a system be without noise."""
    moved = system.moved

    def with_walk(h: float) -> tuple[Array, Array, Array]:
        state, transition, noise = moved(h)
        return state, transition.copy(), noise + np.diag((WALK * deviations) ** 2)

    system.moved = with_walk


def graph_of(record: Record) -> Any:
    """Prior, a factor for each step of the model, and one for each measurement."""
    graph, system, instants = gtsam.NonlinearFactorGraph(), record.system, record.instants
    start = instants[0].before
    graph.add(gtsam.PriorFactorVector(0, start.mean, gtsam.noiseModel.Gaussian.Covariance(start.covariance)))
    for k, instant in enumerate(instants):
        if k:
            graph.add(_step(system, k, instant.inputs, instant.time - instants[k - 1].time, instants[k - 1].after.mean))
        for used in instant.used:
            graph.add(_measured(system, k, used))
    return graph


def _step(system: Dense, k: int, inputs: Array, h: float, mean: Array) -> Any:
    def moved(state: Array) -> tuple[Array, Array, Array]:
        system.mean[:], system.inputs[:] = state, inputs
        return system.moved(h)

    def error(this: Any, values: Any, jacobians: Any) -> Array:
        expected, transition, _ = moved(values.atVector(k - 1))
        if jacobians is not None:
            jacobians[0], jacobians[1] = -transition, np.eye(len(expected))
        return np.asarray(values.atVector(k) - expected)

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(moved(mean)[2]), [k - 1, k], error)


def _measured(system: Dense, k: int, used: Any) -> Any:
    def error(this: Any, values: Any, jacobians: Any) -> Array:
        system.mean[:], system.inputs[:] = values.atVector(k), used.inputs
        residual, by_error = (np.array(found) for found in system.sense(used.sensor, used.value))
        absent = ~np.isfinite(residual)
        residual[absent], by_error[absent] = 0.0, 0.0
        if jacobians is not None:
            jacobians[0] = -by_error
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Variances(used.variance), [k], error)


def test_the_motion_and_its_deviations_are_those_that_gtsam_finds_from_the_same_measurements(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept: list[tuple[Record, Iterated]] = []

    def exact(record: Record, progress: Any = None) -> Iterated:
        all_walk(record.system, np.sqrt(record.instants[0].before.covariance.diagonal()))
        for instant in record.instants:  # without gates both minimise the same sum of squares
            instant.used[:] = [used._replace(limit=np.inf) for used in instant.used]
        kept.append((record, iterated(record, EXACT)))
        return kept[-1][1]

    monkeypatch.setattr(smoothing, "iterated", exact)
    run_offline(vs.read(BAG).between(None, 4.0), vs.load_vehicle("prototype_real"))
    ((record, found),) = kept

    graph, first = graph_of(record), gtsam.Values()
    for k, instant in enumerate(record.instants):
        first.insert(k, instant.after.mean)
    values = gtsam.GaussNewtonOptimizer(graph, first).optimize()
    marginals = gtsam.Marginals(graph, values)
    for k in range(0, len(found.beliefs), 50):
        belief, covariance = found.beliefs[k], marginals.marginalCovariance(k)
        deviation = np.sqrt(covariance.diagonal())
        assert np.max(np.abs(values.atVector(k) - belief.mean) / deviation) < 0.01, k
        np.testing.assert_allclose(np.sqrt(belief.covariance.diagonal()), deviation, rtol=0.01)
