"""The covariance algebra against dense matrices, against filterpy and against itself in the other language."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from algebra import BIASES, SPEED, InC, N, WithFullMatrices, problem
from vsense_ros import codegen
from vsense_ros.observer.state import DYNAMIC, U

Array = NDArray[np.float64]
SEEDS = range(5)
needs_a_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")


def dense_transition(k: Any, h: float, decay: Array) -> Array:
    """(n, n) F from its blocks: velocities first, then coordinates and road that follow the *new* velocities."""
    by_angles, by_velocity, by_road, _, road_by_velocity, road_by_road = k.model.kinematics.results
    f = np.eye(N)
    f[28:, 28:] = np.diag(decay)
    road = np.eye(N)
    for i, state in enumerate((42, 43, 46)):
        road[state, 14:20] = h * road_by_velocity[i]
        road[state, 42:46] += h * road_by_road[i]
    for i, (rate, _, back) in enumerate(k.model.roughness):
        kept = 1 / (1 + h * SPEED * rate)
        road[44 + i, 44 + i], road[44 + i, 42 + i] = kept, -kept * h * SPEED * back
    velocities = np.eye(N)
    velocities[U] = 0
    velocities[U][:, DYNAMIC] = 0
    for column, index in enumerate([*DYNAMIC, *range(14, 49)]):
        velocities[U, index] = k.gain[:, column]
    coordinates = np.eye(N)
    coordinates[:6, 3:6] += h * by_angles
    coordinates[:6, 14:20] += h * by_velocity
    coordinates[:6, 42:46] += h * by_road
    coordinates[6:14, 20:28] += h * np.eye(8)
    return f @ road @ coordinates @ velocities


def beside(k: Any, noise: Array) -> Array:
    """Covariances (n, n) beside the variances that a step adds: tyres turn the body about x and y, too, and torques of
    two wheels each have a part in common."""
    added = np.zeros((N, N))
    for lever, turned, turning in zip(k.model.levers, (31, 32), (29, 28), strict=True):
        added[[turned, turning], [turning, turned]] = lever * noise[turning - 28]
    for pair, (i, j) in enumerate(((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))):
        added[[38 + i, 38 + j], [38 + j, 38 + i]] = noise[N - 28 + pair]
    return added


def noise_of_road(k: Any, h: float) -> Array:
    """Variances (n - 28,) that a step adds to what the slopes of the road change by."""
    added = np.zeros(N - 28)
    for i, (rate, variance, _) in enumerate(k.model.roughness):
        added[16 + i] = variance * (1 - 1 / (1 + h * SPEED * rate) ** 2)
    return added


def assert_close(a: Array, b: Array, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * max(np.abs(b).max(), 1e-300))


@needs_a_compiler
@pytest.mark.parametrize("seed", SEEDS)
def test_the_compiled_algebra_equals_numpy(seed: int) -> None:
    p = problem(seed)
    ours, compiled = p.build(), p.build(InC)
    decay, noise = p.random.uniform(0.9, 1, N - 28), p.random.uniform(0, 1e-3, N - 28 + 6)
    sensed = p.sensed()
    value, variance = sensed[0][:, 0] + p.random.normal(size=6), p.random.uniform(0.1, 1, 6)
    value[2] = np.nan
    nis = []
    for k in (ours, compiled):
        k.transition(0.01)
        k.propagate(0.01, decay, noise)
        after_step = k.covariance.copy()
        nis.append((after_step, k.correct(sensed, True, BIASES, value, variance, 1.0, np.inf)))
    assert_close(compiled.inverse, ours.inverse)
    assert_close(compiled.gain, ours.gain)
    assert_close(nis[1][0], nis[0][0])
    # Both solve with the covariance of the innovation, whose condition number here is below 1e6.
    assert nis[1][1] == pytest.approx(nis[0][1], rel=1e-10)
    assert_close(compiled.error, ours.error, 1e-10)
    assert_close(compiled.covariance, ours.covariance)


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_innovation_is_told_component_by_component_given_those_before(kind: Any, seed: int) -> None:
    p = problem(seed)
    k, sensed = p.build(kind), p.sensed()
    value, variance = sensed[0][:, 0] + p.random.normal(size=6), p.random.uniform(0.1, 1, 6)
    value[2] = np.nan
    h, innovation = p.jacobian(sensed), value - sensed[0][:, 0]
    total = h @ p.covariance @ h.T + np.diag(variance)
    k.correct(sensed, True, BIASES, value, variance, 1.0, np.inf)
    before: list[int] = []
    for i in (0, 1, 3, 4, 5):  # Gaussian conditioning
        weights = np.linalg.solve(total[np.ix_(before, before)], total[before, i])
        deviation = np.sqrt(total[i, i] - weights @ total[before, i])
        rest = innovation[i] - weights @ innovation[before]
        assert k.whitened[i] == pytest.approx(rest / deviation, rel=1e-6)
        assert k.factor[7 * i] == pytest.approx(deviation, rel=1e-6)
        before.append(i)
    assert np.isnan(k.whitened[2])
    factor = k.factor[:36].reshape(6, 6)
    total[2, :] = total[:, 2] = 0.0
    total[2, 2] = 1.0
    assert_close(factor @ factor.T, total, 1e-9)


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
@pytest.mark.parametrize("seed", SEEDS)
def test_propagation_equals_the_dense_product(kind: Any, seed: int) -> None:
    p = problem(seed)
    k = p.build(kind)
    decay, noise = p.random.uniform(0.9, 1, N - 28), p.random.uniform(0, 1e-3, N - 28 + 6)
    k.transition(0.01)
    f = dense_transition(k, 0.01, decay)
    expected = f @ p.covariance @ f.T
    expected[range(28, N), range(28, N)] += noise[: N - 28] + noise_of_road(k, 0.01)
    expected += beside(k, noise)
    k.propagate(0.01, decay, noise)
    assert_close(k.covariance, expected, 1e-11)
    assert np.array_equal(k.covariance, k.covariance.T)


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
@pytest.mark.parametrize("accelerations", [True, False])
@pytest.mark.parametrize("biased", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_correction_equals_filterpys(kind: Any, accelerations: bool, biased: bool, seed: int) -> None:
    p = problem(seed)
    k = p.build(kind)
    sensed = p.sensed(6, accelerations)
    value = sensed[0][:, 0] + p.random.normal(size=6)
    value[4] = np.nan
    variance = p.random.uniform(0.1, 1, 6)
    where = BIASES if biased else slice(49, 49)
    before = p.jacobians[0][:, 0].copy()
    nis = k.correct(sensed, accelerations, where, value, variance, 1.0, np.inf)
    present = np.isfinite(value)
    oracle = KalmanFilter(dim_x=N, dim_z=5)
    oracle.P = p.covariance
    oracle.H = p.jacobian(sensed, accelerations, biased)[present]
    oracle.R = np.diag(variance[present])
    oracle.update((value - sensed[0][:, 0])[present])
    assert_close(k.error, oracle.x[:, 0], 1e-8)
    assert_close(k.covariance, oracle.P, 1e-9)
    assert_close(k.covariance, k.covariance.T, 1e-15)
    assert_close(p.jacobians[0][:, 0], before + p.through() @ oracle.x[:, 0], 1e-8)
    assert nis == pytest.approx(float(oracle.mahalanobis) ** 2, rel=1e-8)
    assert np.array_equal(k.covariance, k.covariance.T)


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
def test_a_measurement_beyond_the_gate_changes_nothing(kind: Any) -> None:
    p = problem(0)
    k = p.build(kind)
    sensed = p.sensed()
    nis = k.correct(sensed, True, BIASES, sensed[0][:, 0] + 1e4, np.full(6, 0.1), 1.0, 36.0)
    assert nis > 36
    assert np.array_equal(k.covariance, p.covariance)
    assert not k.error.any()


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
def test_a_measurement_of_nothing_changes_nothing(kind: Any) -> None:
    p = problem(0)
    k = p.build(kind)
    assert k.correct(p.sensed(), True, BIASES, np.full(6, np.nan), np.ones(6), 1.0, np.inf) < 0
    assert np.array_equal(k.covariance, p.covariance)


@pytest.mark.parametrize("kind", [WithFullMatrices, pytest.param(InC, marks=needs_a_compiler)])
def test_on_a_linear_system_the_error_filter_is_the_kalman_filter(kind: Any) -> None:
    """The model moves the state and the filter its errors; on a linear model that is one and the same filter."""
    p = problem(3)
    for jacobian in p.jacobians[1:]:
        jacobian *= 0.05  # fifty steps must not explode
    for part in p.kinematics:
        part *= 0.1
    k = p.build(kind)
    decay, noise = p.random.uniform(0.9, 1, N - 28), p.random.uniform(0, 1e-3, N - 28 + 6)
    state = p.random.normal(size=N)
    k.transition(0.01)
    oracle = KalmanFilter(dim_x=N, dim_z=6)
    oracle.F = dense_transition(k, 0.01, decay)
    oracle.Q = np.zeros((N, N))
    oracle.Q[range(28, N), range(28, N)] = noise[: N - 28] + noise_of_road(k, 0.01)
    oracle.Q += beside(k, noise)
    oracle.x, oracle.P = state[:, None].copy(), p.covariance.copy()
    variance = np.full(6, 0.5)
    oracle.R = np.diag(variance)
    for _ in range(50):
        sensed = p.sensed()
        oracle.H = p.jacobian(sensed)
        state = oracle.F @ state
        k.propagate(0.01, decay, noise)
        sensed[0][:, 0] = oracle.H @ state
        value = p.random.normal(size=6)
        k.correct(sensed, True, BIASES, value, variance, 1.0, np.inf)
        state += k.error
        oracle.predict()
        oracle.update(value)
    assert_close(state, oracle.x[:, 0], 1e-8)
    assert_close(k.covariance, oracle.P, 1e-8)
