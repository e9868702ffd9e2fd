"""Identification by a state that is continued by parameters, and by a filter of parameters beside that of the state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from systems import IMU, LINEAR, REST, SALOON, STIFFNESS, SingleTrack, VelocityKkf, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.separate_bias import SeparateBias
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.estimation.ukf import Ukf

WRONG = np.array([0.0, 0.0, 120e3, 180e3])
PRIOR = Gaussian(WRONG, np.diag(np.square([0.3, 0.1, 3e4, 3e4])))


class Biased(StateSpace):
    """The velocity filter with its accelerometers' biases, and the scale of a speedometer, as parameters: linear."""

    names = ("forward", "lateral")
    inputs = VelocityKkf.inputs
    parameters = ("forward_bias", "lateral_bias", "offset")

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        forward = u.acceleration_x - theta.forward_bias + u.yaw_rate * x.lateral
        lateral = u.acceleration_y - theta.lateral_bias - u.yaw_rate * x.forward
        return [x.forward + h * forward, x.lateral + h * lateral]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [0.01 * h, 0.01 * h]


GROUND = Measurement("ground", lambda x, z, u, p: [x.forward + p.offset, x.lateral], (0.1, 0.2))
CASE = LINEAR["velocity"]


def joint(drifts: dict[str, float]) -> Ekf:
    return Ekf(Dense(Augmented(Biased(), drifts), [GROUND]))


def separate(drifts: dict[str, float]) -> SeparateBias:
    nominal = dict.fromkeys(Biased.parameters, 0.0)
    return SeparateBias(Ekf(Dense(Biased(), [GROUND], nominal)), drifts)


def runs(count: int, seed: int = 0) -> list[tuple[Any, list[Any]]]:
    random = np.random.default_rng(seed)
    inputs = [np.array(CASE.inputs(i * 0.01)) for i in range(count)]
    return [(u, [GROUND.measured([10 + random.normal(), random.normal()])] if i % 4 == 0 else [])
            for i, u in enumerate(inputs)]  # fmt: skip


@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_the_separate_filter_equals_that_of_the_augmented_state_on_a_linear_system(drift: float) -> None:
    drifts = {"forward_bias": drift, "lateral_bias": 0.5 * drift, "offset": 0.0}
    random = np.random.default_rng(3)
    root = random.normal(size=(5, 5))
    prior = Gaussian(np.array([10.0, 0.1, 0.2, -0.1, 0.3]), root @ root.T)
    both = joint(drifts), separate(drifts)
    for filter in both:
        filter.start(prior)
    found = [drive(filter, CASE, runs(400)) for filter in both]
    for a, b in zip(*found, strict=True):
        assert a.nis == pytest.approx(b.nis, rel=1e-8)
        np.testing.assert_allclose(a.whitened, b.whitened, rtol=1e-7, atol=1e-9)
    one, other = (filter.belief() for filter in both)
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-8, atol=1e-10)


def test_the_separate_filter_pulls_and_leaves_out_as_the_joint_one() -> None:
    drifts = {"forward_bias": 0.01, "offset": 0.0}
    nominal = {"lateral_bias": 0.0}
    one = Ekf(Dense(Augmented(Biased(), drifts), [GROUND], nominal))
    other = separate(drifts)
    for filter in (one, other):
        filter.start(Gaussian(np.array([10.0, 0.0, 0.0, 0.0]), np.diag([1.0, 1.0, 0.2, 0.3])))
        drive(filter, CASE, runs(50))
        filter.correct("ground", np.array([11.0, np.nan]), GROUND.variances, scale=3.0)
        refused = filter.correct("ground", np.array([90.0, 0.0]), GROUND.variances, limit=9.0)
        assert not refused.accepted
    a, b = one.belief(), other.belief()
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-8, atol=1e-10)


IDENTIFYING: dict[str, Callable[[], Any]] = {
    "extended": lambda: Ekf(Dense(Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 0.0)), [IMU], REST)),
    "unscented": lambda: Ukf(Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 0.0)), [IMU], REST),
    "separate": lambda: SeparateBias(Ekf(Dense(SingleTrack(), [IMU], SALOON)), dict.fromkeys(STIFFNESS, 0.0)),
}


@pytest.mark.parametrize("way", IDENTIFYING)
def test_cornering_stiffness_is_found_from_a_start_that_is_a_fifth_off(way: str) -> None:
    case = LINEAR["single track"]
    filter = IDENTIFYING[way]()
    filter.inputs[:] = case.inputs(0.0)
    filter.start(PRIOR)
    drive(filter, case, measured(case, 2000, every=1))
    belief = filter.belief()
    assert filter.names[2:] == STIFFNESS
    truth = [SALOON[name] for name in STIFFNESS]
    error, sigma = belief.mean[2:] - truth, np.sqrt(np.diag(belief.covariance))[2:]
    assert (sigma < 0.002 * np.array(truth)).all()
    assert (np.abs(error) < 4 * sigma).all()


def test_a_parameter_may_be_augmented_after_another() -> None:
    once = Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 1.0))
    twice = Augmented(Augmented(SingleTrack(), {"front_stiffness": 1.0}), {"rear_stiffness": 1.0})
    case, found = LINEAR["single track"], []
    for system in (once, twice):
        filter = Ekf(Dense(system, [IMU], REST))
        filter.inputs[:] = case.inputs(0.0)
        filter.start(PRIOR)
        drive(filter, case, measured(case, 100))
        found.append(filter.memory)
    assert once.names == twice.names
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def test_memory_of_the_separate_filter_that_is_put_back_gives_the_same_bits() -> None:
    filter = separate({"forward_bias": 0.01})
    filter.start(Gaussian(np.array([10.0, 0.0, 0.0]), np.eye(3)))
    kept = filter.memory.copy()
    drive(filter, CASE, runs(30))
    after = filter.memory.copy()
    filter.memory[:] = kept
    drive(filter, CASE, runs(30))
    assert (filter.memory == after).all()


def test_the_separate_filter_forgets_how_errors_belong_together() -> None:
    filter = separate({"forward_bias": 0.01})
    filter.start(Gaussian(np.array([10.0, 0.0, 0.0]), np.eye(3)))
    drive(filter, CASE, runs(30))
    before = np.diag(filter.belief().covariance)
    filter.inflate()
    np.testing.assert_allclose(filter.belief().covariance, np.diag(4 * before))


def test_a_system_without_a_state_space_must_tell_what_parameters_change() -> None:
    class Other:
        memory = mean = covariance = inputs = np.zeros((1, 1))
        names = sensors = ()
        operations = None

        def at(self, memory: Any) -> Other:
            return self

    with pytest.raises(InputError, match="what parameters change in Other must be told"):
        SeparateBias(Ekf(Other()), {"mass": 0.0})  # type: ignore[arg-type]
    del Other.at
    with pytest.raises(InputError, match="a filter of Other cannot be a part of another filter"):
        SeparateBias(Ekf(Other()), {"mass": 0.0})  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [lambda: Augmented(SingleTrack(), {"mas": 0.0}), lambda: separate({"mas": 0.0})])
def test_a_parameter_that_is_not_there_is_named(make: Callable[[], Any]) -> None:
    with pytest.raises(InputError, match="no parameter 'mas'"):
        make()
