"""The unscented Kalman filter beside other libraries, and beside the linear filter it must equal."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import dynamax_of, filterpy_of
from systems import ATTITUDE, BOB, CASES, LINEAR, NONLINEAR, VELOCITY, Case, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.state_space import Measurement, wrapped
from vsense_ros.estimation.ukf import Ukf

WEIGHTS = {"plain": {}, "kappa": {"kappa": 1.0}, "scaled": {"alpha": 0.5, "beta": 2.0, "kappa": 1.0}}


def begun(case: Case, **weights: float) -> Ukf:
    found: Ukf = case.begun(Ukf(case.system, case.measurements, case.parameters, **weights))
    return found


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("name", LINEAR)
def test_equals_the_kalman_filter_on_linear_systems(name: str, weights: str) -> None:
    case = LINEAR[name]
    run, filter = measured(case, 200), begun(case, **WEIGHTS[weights])
    drive(filter, case, run)
    mean, covariance = filterpy_of(name, case, run)
    np.testing.assert_allclose(filter.mean, mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(filter.covariance, covariance, rtol=1e-9, atol=1e-9)


def test_equals_dynamax_on_a_nonlinear_system() -> None:
    pytest.importorskip("dynamax", reason="dynamax is not installed (requirements/dev.txt)")
    from dynamax.nonlinear_gaussian_ssm.inference_ukf import UKFHyperParams

    case = NONLINEAR["pendulum"]
    run = measured(case, 100, every=1)
    inputs, values = np.zeros((100, 1)), np.array([each[0].value for _, each in run])
    options = {"alpha": 0.8, "beta": 2.0, "kappa": 1.0}
    method = "unscented_kalman_filter"
    theirs = dynamax_of("pendulum", case, inputs, values, method, hyperparams=UKFHyperParams(**options))
    filter = begun(case, **options)
    filter.correct(*run[0][1][0])
    drive(filter, case, run[1:])
    np.testing.assert_allclose(filter.mean, theirs.filtered_means[-1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(filter.covariance, theirs.filtered_covariances[-1], rtol=1e-9, atol=1e-9)


def test_sees_what_a_linearisation_does_not() -> None:
    """E[sin a] of a normal distribution is sin(mean) exp(-σ²/2), of which the extended filter knows only sin(mean)."""
    case, sigma = NONLINEAR["pendulum"], 0.4
    filter, other = begun(case, kappa=1.0), case.begun(Ekf(case.dense()))
    expected = np.sin(0.8) * np.exp(-(sigma**2) / 2)
    means = []
    for one in (filter, other):
        one.covariance[:] = np.diag([sigma**2, 0.01])
        found = one.correct("bob", np.array([expected, np.nan]), BOB.variances)
        means.append(found.whitened[0] * found.factor[0, 0])
    assert abs(means[0]) < 1e-3
    assert means[1] == pytest.approx(expected - np.sin(0.8), abs=1e-12)


@pytest.mark.parametrize("turns", [-1, 2])
def test_whole_turns_of_an_angle_make_no_difference(turns: int) -> None:
    case = LINEAR["heading"]
    filter, other = begun(case), begun(case)
    filter.correct("course", np.array([0.15]), np.array([0.01]))
    other.correct("course", np.array([0.15 + turns * 2 * np.pi]), np.array([0.01]))
    np.testing.assert_allclose(filter.memory, other.memory, atol=1e-14)


def test_points_on_both_sides_of_the_half_turn_are_near_one_another() -> None:
    """Where the angle measured jumps from π to -π, the innovation and its deviation are as anywhere else."""
    course = Measurement("course", lambda x, z, u, p: wrapped(x.yaw + np.pi), (0.02,), angles=(0,))
    case = LINEAR["heading"]
    filter = case.begun(Ukf(case.system, [course]))
    filter.mean[0] = 0.0
    found = filter.correct("course", np.array([-np.pi + 0.05]), np.array([0.02**2]))
    assert found.factor[0, 0] == pytest.approx(np.hypot(0.1, 0.02), rel=1e-9)
    assert found.whitened[0] * found.factor[0, 0] == pytest.approx(0.05, abs=1e-9)


def test_absent_and_refused_measurements_are_told() -> None:
    filter = begun(LINEAR["velocity"])
    before = filter.memory.copy()
    assert filter.correct("velocity", np.full(2, np.nan), VELOCITY.variances).nis < 0
    assert not filter.correct("velocity", np.array([20.0, 0.0]), VELOCITY.variances, limit=9.0).accepted
    assert (filter.memory == before).all()
    assert filter.correct("velocity", np.array([np.nan, 0.1]), VELOCITY.variances).accepted


def test_a_lost_covariance_is_begun_anew_and_told(caplog: pytest.LogCaptureFixture) -> None:
    filter = begun(LINEAR["velocity"])
    filter.covariance[0, 2] = filter.covariance[2, 0] = 5.0
    assert not filter.correct("velocity", np.array([10.0, 0.0]), VELOCITY.variances).accepted
    assert "not positive definite any more" in caplog.text
    assert filter.correct("velocity", np.array([10.0, 0.0]), VELOCITY.variances).accepted


def test_states_that_are_known_exactly_stay_known() -> None:
    case = LINEAR["velocity"]
    filter = begun(case)
    filter.covariance[1, 1] = filter.covariance[3, 3] = 0.0
    filter.predict(0.01)
    assert filter.is_valid()
    assert filter.covariance[1, 1] == pytest.approx(1e-6 * 0.01)


@pytest.mark.parametrize("name", CASES)
def test_compiled_equals_the_virtual_machine(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[name]
    run, one = measured(case, 30), begun(case)
    monkeypatch.setenv("VSENSE_COMPILE", "0")
    other = begun(case)
    for filter in (one, other):
        drive(filter, case, run)
    np.testing.assert_allclose(one.memory, other.memory, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", CASES)
def test_memory_that_is_put_back_gives_the_same_bits(name: str) -> None:
    case = CASES[name]
    run, filter = measured(case, 20), begun(case)
    kept = filter.memory.copy()
    drive(filter, case, run)
    after = filter.memory.copy()
    filter.memory[:] = kept
    drive(filter, case, run)
    assert (filter.memory == after).all()


def test_weights_without_points_are_refused() -> None:
    case = LINEAR["heading"]
    with pytest.raises(InputError, match="alpha and e \\+ kappa must be positive"):
        Ukf(case.system, case.measurements, kappa=-2.0)


def test_the_mean_of_attitudes_far_apart_is_that_from_which_their_errors_add_up_to_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Turns about different axes do not commute, so that the mean is not where the middle point went."""
    filters = []
    for compiled in ("0", "1"):
        monkeypatch.setenv("VSENSE_COMPILE", compiled)
        filters.append(Ukf(ATTITUDE.system, ATTITUDE.measurements))
    means = []
    for filter in filters:
        filter.inputs[:] = [1.0, 0.5, 0.4]
        deviations = [0.4, 0.1, 0.1, 0.6, 0.1, 0.3]
        correlated = np.diag(deviations) @ (np.eye(6) + 0.6 * (np.eye(6, k=3) + np.eye(6, k=-3))) @ np.diag(deviations)
        filter.start(Gaussian(np.array(ATTITUDE.mean), correlated))
        filter.predict(1.0)
        means.append(filter.mean.copy())
    alone = ATTITUDE.begun(Ekf(ATTITUDE.dense()))
    alone.inputs[:] = [1.0, 0.5, 0.4]
    alone.predict(1.0)
    assert np.abs(means[0] - alone.mean).max() > 1e-3
    np.testing.assert_allclose(means[0], means[1], rtol=1e-9, atol=1e-12)
