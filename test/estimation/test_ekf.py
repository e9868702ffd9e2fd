"""The extended Kalman filter beside other libraries, compiled beside NumPy, and what must hold of any covariance."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marks import exam_except
from oracles import dynamax_of, filterpy_of, filterpy_pendulum
from systems import BOB, CASES, LINEAR, NONLINEAR, VELOCITY, Case, drive, measured
from vsense_ros import codegen
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Filter, Gaussian, Given, Step
from vsense_ros.estimation.state_space import Measurement

ONE_SENSOR = {name: CASES[name] for name in ("heading", "single track", "pendulum")}
compiled = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")


@pytest.fixture(params=["compiled", "NumPy"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "NumPy":
        monkeypatch.setenv("VSENSE_COMPILE", "0")
    elif codegen.compiler() is None:
        pytest.skip("needs a C compiler")
    return str(request.param)


def begun(case: Case) -> Ekf:
    found: Ekf = case.begun(Ekf(case.dense()))
    return found


def close(found: Any, mean: Any, covariance: Any, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(found.mean, mean, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(found.covariance, covariance, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("name", LINEAR)
def test_equals_filterpy_on_linear_systems(name: str, way: str) -> None:
    case = LINEAR[name]
    run, filter = measured(case, 500), begun(case)
    assert (filter.system.operations is not None) == (way == "compiled")
    drive(filter, case, run)
    close(filter, *filterpy_of(name, case, run))


def test_equals_filterpy_on_a_nonlinear_system(way: str) -> None:
    case = NONLINEAR["pendulum"]
    run, filter = measured(case, 500), begun(case)
    drive(filter, case, run)
    close(filter, *filterpy_pendulum(case, run))


@pytest.mark.parametrize("name", exam_except(ONE_SENSOR, "heading"))
def test_equals_dynamax(name: str) -> None:
    pytest.importorskip("dynamax", reason="dynamax is not installed (requirements/dev.txt)")
    case = ONE_SENSOR[name]
    run = measured(case, 100, every=1)
    inputs = np.array([u for u, _ in run])
    values = np.array([each[0].value for _, each in run])
    theirs = dynamax_of(name, case, inputs, values)
    filter = begun(case)
    filter.inputs[:] = inputs[0]
    filter.correct(*run[0][1][0])
    drive(filter, case, run[1:])
    close(filter, theirs.filtered_means[-1], theirs.filtered_covariances[-1])


@compiled
@pytest.mark.parametrize("name", CASES)
def test_compiled_equals_numpy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[name]
    run, ours = measured(case, 300), begun(case)
    monkeypatch.setenv("VSENSE_COMPILE", "0")
    plain = begun(case)
    assert plain.system.operations is None
    for a, b in zip(drive(ours, case, run), drive(plain, case, run), strict=True):
        assert a.nis == pytest.approx(b.nis, rel=1e-9)
        np.testing.assert_allclose(a.whitened, b.whitened, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(a.factor, b.factor, rtol=1e-9, atol=1e-12)
    close(ours, plain.mean, plain.covariance, 1e-11)


@compiled
@pytest.mark.parametrize("name", ["velocity", "pendulum"])
def test_many_events_in_one_call_equal_one_after_the_other(name: str) -> None:
    case = CASES[name]
    run = measured(case, 60)
    one, many = begun(case), begun(case)
    events: list[Any] = []
    for u, values in run:
        if len(u):
            events.append((None, Given(0, u)))
        step = Step(many.backup(), 1, case.h)
        first, *rest = values or [Given(0, np.zeros(0))]
        events += [(step, first), *((None, value) for value in rest)]
    done, moved, nis = many.repeat(events)
    assert (done, moved) == (len(events), False)
    assert nis == Filter.repeat(one, events)[2]
    assert (one.memory == many.memory).all()


def test_events_stop_at_what_is_not_believed(way: str) -> None:
    filter = begun(LINEAR["velocity"])
    good, bad = VELOCITY.measured([10.0, 0.0]), VELOCITY.measured([1000.0, 0.0])._replace(limit=50.0)
    step = Step(filter.backup(), 2, 0.01)
    done, moved, nis = filter.repeat([(step, good), (None, bad), (None, good)])
    assert (done, moved, len(nis)) == (1, True, 2)
    assert nis[1] > 50.0


def test_a_filter_that_cannot_move_stays_as_it_was(way: str) -> None:
    filter = begun(LINEAR["single track"])
    filter.inputs[1] = 0.0  # a speed by which the tyres' slip is divided
    before = filter.memory.copy()
    assert not filter.advance(Step(filter.backup(), 3, 0.01))
    assert (filter.memory == before).all()
    with pytest.raises(FloatingPointError, match="SingleTrack"):
        filter.predict(0.01)


def test_what_is_refused_changes_nothing(way: str) -> None:
    filter = begun(LINEAR["velocity"])
    before = filter.memory.copy()
    found = filter.correct("velocity", np.array([20.0, 0.0]), VELOCITY.variances, limit=9.0)
    assert not found.accepted
    assert found.nis == pytest.approx(10.0**2 / 1.01)
    assert (filter.memory == before).all()


def test_absent_components_are_left_out(way: str) -> None:
    whole, part = begun(LINEAR["velocity"]), begun(LINEAR["velocity"])
    speed = Measurement("speed", lambda x, z, u, p: x.forward, (0.1,))
    found = whole.correct("velocity", np.array([10.4, np.nan]), VELOCITY.variances)
    part.correct(*speed.measured([10.4]))
    np.testing.assert_allclose(whole.memory, part.memory, rtol=1e-14)
    assert np.isnan(found.whitened[1])
    np.testing.assert_allclose(found.factor, [[np.sqrt(1.01), 0.0], [0.0, 1.0]])


def test_nothing_measured_is_told_by_a_negative_number(way: str) -> None:
    filter = begun(LINEAR["velocity"])
    before = filter.memory.copy()
    found = filter.correct("velocity", np.full(2, np.nan), VELOCITY.variances)
    assert found.nis < 0
    assert not found.accepted
    assert (filter.memory == before).all()


def test_a_measurement_acts_where_its_condition_holds(way: str) -> None:
    slow = Measurement("slow", lambda x, z, u, p: x.forward, (0.1,), when=lambda x, u, p: u.yaw_rate < 0.1)
    case = LINEAR["velocity"]
    filter = case.begun(Ekf(Dense(case.system, [slow])))
    filter.inputs[2] = 0.2
    assert filter.correct(*slow.measured([11.0])).nis < 0
    filter.inputs[2] = 0.0
    assert filter.correct(*slow.measured([11.0])).accepted


@pytest.mark.parametrize("turns", [-2, 1, 3])
def test_whole_turns_of_an_angle_make_no_difference(turns: int, way: str) -> None:
    case = LINEAR["heading"]
    filter, other = begun(case), begun(case)
    filter.correct("course", np.array([0.15]), np.array([0.01]))
    other.correct("course", np.array([0.15 + turns * 2 * np.pi]), np.array([0.01]))
    np.testing.assert_allclose(filter.memory, other.memory, atol=1e-14)


def test_a_larger_scale_pulls_less(way: str) -> None:
    """P Hᵀ (4 S)⁻¹ r in place of P Hᵀ S⁻¹ r."""
    once, less = begun(LINEAR["velocity"]), begun(LINEAR["velocity"])
    value = np.array([10.5, 0.2])
    full = once.correct("velocity", value, VELOCITY.variances)
    weak = less.correct("velocity", value, VELOCITY.variances, scale=4.0)
    assert weak.nis == pytest.approx(full.nis / 4)
    start = LINEAR["velocity"].start.mean
    np.testing.assert_allclose(less.mean - start, (once.mean - start) / 4, atol=1e-15)


def test_a_lost_covariance_is_begun_anew_and_told(way: str, caplog: pytest.LogCaptureFixture) -> None:
    filter = begun(LINEAR["velocity"])
    filter.covariance[0, 2] = filter.covariance[2, 0] = 5.0
    found = filter.correct("velocity", np.array([10.0, 0.0]), VELOCITY.variances)
    assert np.isnan(found.nis)
    assert not found.accepted
    assert "correcting by velocity: the covariance is not positive definite any more" in caplog.text
    np.testing.assert_allclose(filter.covariance, np.diag(4 * np.square(LINEAR["velocity"].deviations)))
    assert filter.correct("velocity", np.array([10.0, 0.0]), VELOCITY.variances).accepted


def test_a_state_beyond_its_bounds_is_not_valid(way: str) -> None:
    class Bounded(type(NONLINEAR["pendulum"].system)):  # type: ignore[misc]
        largest: ClassVar = {"angle": 2.0}

    case = NONLINEAR["pendulum"]
    filter = case.begun(Ekf(Dense(Bounded(), [BOB], case.parameters)))
    assert filter.is_valid()
    filter.mean[0] = 2.5
    assert not filter.is_valid()
    assert not filter.advance(Step(filter.backup(), 1, 0.01))
    filter.mean[0] = np.nan
    assert not filter.is_valid()


@settings(max_examples=25, deadline=None)
@given(name=st.sampled_from(sorted(CASES)), seed=st.integers(0, 2**32 - 1), every=st.integers(1, 9))
def test_a_covariance_stays_symmetric_and_definite(name: str, seed: int, every: int) -> None:
    case = CASES[name]
    filter = begun(case)
    drive(filter, case, measured(case, 100, every, seed))
    assert (filter.covariance == filter.covariance.T).all()
    assert np.linalg.eigvalsh(filter.covariance)[0] > 0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_independent_corrections_makes_no_difference(seed: int) -> None:
    random = np.random.default_rng(seed)
    values = [VELOCITY.measured(random.normal(size=2)), LINEAR["velocity"].measurements[1].measured([random.normal()])]
    one, other = begun(LINEAR["velocity"]), begun(LINEAR["velocity"])
    for value in values:
        one.correct(*value)
    for value in reversed(values):
        other.correct(*value)
    close(one, other.mean, other.covariance, 1e-12)


@settings(max_examples=10, deadline=None)
@given(name=st.sampled_from(sorted(CASES)), seed=st.integers(0, 2**32 - 1))
def test_memory_that_is_put_back_gives_the_same_bits(name: str, seed: int) -> None:
    case = CASES[name]
    run, filter = measured(case, 30, seed=seed), begun(case)
    drive(filter, case, run[:10])
    kept = filter.memory.copy()
    drive(filter, case, run[10:])
    after = filter.memory.copy()
    filter.memory[:] = kept
    drive(filter, case, run[10:])
    assert (filter.memory == after).all()


def test_a_belief_is_a_copy() -> None:
    filter = begun(LINEAR["heading"])
    belief = filter.belief()
    filter.predict(0.1)
    np.testing.assert_allclose(belief.mean, LINEAR["heading"].mean)
    assert isinstance(belief, Gaussian)
