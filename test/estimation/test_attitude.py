"""States that are no vectors: attitudes by quaternion, in the extended and the unscented filter."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from systems import ATTITUDE, Attitude, Truth, drive, measured
from vsense_ros.estimation import attitude
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.ukf import Ukf

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
small = vectors.map(lambda v: v * 1.7)  # less than half a turn


def number(expression: Any) -> Array:
    return np.array(ca.evalf(ca.SX(expression)))[:, 0]


def scalar_first(rotation: Rotation) -> Array:
    return rotation.as_quat()[[3, 0, 1, 2]]


def rotation_of(q: Array) -> Rotation:
    return Rotation.from_quat(q[[1, 2, 3, 0]])


@settings(deadline=None)
@given(small, small, vectors)
def test_quaternions_turn_as_those_of_scipy(first: Array, second: Array, vector: Array) -> None:
    p, q = Rotation.from_rotvec(first), Rotation.from_rotvec(second)
    np.testing.assert_allclose(number(attitude.rotation(ca.SX(first))), scalar_first(p), atol=1e-9)
    product = number(attitude.product(ca.SX(scalar_first(p)), ca.SX(scalar_first(q))))
    np.testing.assert_allclose(rotation_of(product).as_matrix(), (p * q).as_matrix(), atol=1e-12)
    turned = number(attitude.turned(ca.SX(scalar_first(p)), ca.SX(vector)))
    np.testing.assert_allclose(turned, p.apply(vector), atol=1e-12)


@settings(deadline=None)
@given(small, small)
def test_difference_undoes_retract(start: Array, by: Array) -> None:
    q = ca.SX(scalar_first(Rotation.from_rotvec(start)))
    moved = attitude.retract(q, ca.SX(by))
    np.testing.assert_allclose(number(attitude.difference(moved, q)), by, atol=1e-7)
    np.testing.assert_allclose(number(attitude.difference(-moved, q)), by, atol=1e-7)
    assert np.linalg.norm(number(moved)) == pytest.approx(1.0, abs=1e-14)


def filters() -> list[Any]:
    made = [Ekf(ATTITUDE.dense()), Ukf(ATTITUDE.system, ATTITUDE.measurements)]
    return [ATTITUDE.begun(one) for one in made]


def test_the_transition_matrix_is_the_derivative_of_errors() -> None:
    """F δ is the error after a step, by differences of steps from x ⊞ δ."""
    dense = ATTITUDE.dense()
    dense.inputs[:], dense.mean[:] = [0.4, -0.7, 1.1], [0.5, 0.5, -0.5, 0.5, 0.01, 0.02, -0.03]
    start, h, e = dense.mean.copy(), 0.1, 6
    dense.step(h)
    f, moved = dense.transition_matrix, dense.mean.copy()
    for j in range(e):
        apart = []
        for by in (1e-4, -1e-4):
            dense.mean[:] = dense.retracted(start, by * np.eye(e)[j])
            dense.step(h)
            apart.append(dense.difference(dense.mean.copy(), moved))
        np.testing.assert_allclose(f[:, j], (apart[0] - apart[1]) / 2e-4, atol=1e-7)


def test_noise_of_inputs_adds_what_they_scatter() -> None:
    """Against the covariance of errors after steps with inputs that scatter, by a hundred thousand draws."""
    h, sigma = 0.1, {"rate_x": 0.3, "rate_z": 0.1}

    class Scattering(Attitude):
        def noise(self, x: Any, u: Any, theta: Any, h: Any) -> Any:
            return self.noise_of_inputs(x, u, theta, h, {name: s**2 for name, s in sigma.items()})

    dense = Dense(Scattering(), [])
    dense.mean[:], dense.inputs[:] = [0.5, 0.5, -0.5, 0.5, 0.0, 0.0, 0.0], [0.2, -0.4, 0.9]
    dense.step(h)
    random, nominal = np.random.default_rng(0), dense.inputs * h
    by = random.normal(size=(100_000, 3)) * [0.3, 0.0, 0.1] * h
    turned = Rotation.from_rotvec(nominal).inv() * Rotation.from_rotvec(nominal + by)
    np.testing.assert_allclose(dense.noise[:3, :3], np.cov(turned.as_rotvec().T), rtol=0.03, atol=2e-6)
    assert not dense.noise[3:].any()


def test_both_filters_find_attitude_and_biases_of_turned_gyros() -> None:
    random = np.random.default_rng(0)
    truth = Truth(ATTITUDE, random)
    both = filters()
    for i in range(2000):
        u = np.array(ATTITUDE.inputs(i * ATTITUDE.h))
        truth.step(u)
        values = [truth.measure(one) for one in ATTITUDE.measurements] if i % 5 == 0 else []
        for filter in both:
            filter.inputs[:] = u
            filter.predict(ATTITUDE.h)
            for value in values:
                filter.correct(*value)
    ekf, ukf = both
    for filter in both:
        error = ekf.system.difference(truth.state.copy(), filter.mean.copy())
        assert (np.abs(error) < 4 * np.sqrt(np.diag(filter.covariance))).all()
        assert np.linalg.norm(filter.mean[:4]) == pytest.approx(1.0, abs=1e-12)
        assert (np.sqrt(np.diag(filter.covariance))[:3] < 0.02).all()
    np.testing.assert_allclose(ekf.covariance, ukf.covariance, rtol=0.02, atol=1e-7)


def test_the_unscented_mean_of_attitudes_is_where_their_errors_vanish() -> None:
    _, ukf = filters()
    drive(ukf, ATTITUDE, measured(ATTITUDE, 50))
    points = ukf._points.retracted(ukf._spread())
    mean, apart = ukf._mean(points)
    np.testing.assert_allclose(ukf._weights @ apart, 0.0, atol=1e-13)
    np.testing.assert_allclose(mean, ukf.mean, atol=1e-12)


def test_compiled_equals_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    run = measured(ATTITUDE, 200)
    one = ATTITUDE.begun(Ekf(ATTITUDE.dense()))
    monkeypatch.setenv("VSENSE_COMPILE", "0")
    other = ATTITUDE.begun(Ekf(ATTITUDE.dense()))
    drive(one, ATTITUDE, run)
    drive(other, ATTITUDE, run)
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-12)
    np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-14)
