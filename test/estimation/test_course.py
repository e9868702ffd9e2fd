"""A whole course of samples as one call: the same as correction by correction, and the same in C as in NumPy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vsense_ros.codegen import compiler
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Course, Filter, Gaussian
from vsense_ros.estimation.integrated import Integrated
from vsense_ros.estimation.ukf import Ukf


class Pendulum:
    """With a motor, and an unknown damping."""

    states, inputs = ("angle", "rate"), ("torque",)
    parameters, outputs = ("stiffness", "damping"), ("angle", "acceleration")

    def rates(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.rate, u.torque - p.stiffness * ca.sin(x.angle) - p.damping * x.rate]

    def measured(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.angle, self.rates(x, u, p)[1]]


STEP, COUNT, DAMPING = 0.02, 500, 0.4
SYSTEM = Integrated(Pendulum(), {"rate": 0.01})
IDENTIFYING = Augmented(SYSTEM, {"damping": 0.0})
SENSOR = SYSTEM.measurement((0.02, 0.1))
START = Gaussian(np.array([0.1, 0.0, 0.1]), np.diag([0.1, 0.1, 0.3]) ** 2)


def course() -> Course:
    """Course of a pendulum that SciPy integrates, whose sensors are noisy."""
    time = np.arange(COUNT) * STEP
    torque = np.sin(3.0 * time) + 0.5

    def rates(at: float, x: Any) -> list[float]:
        return [x[1], np.interp(at, time, torque) - 4.0 * np.sin(x[0]) - DAMPING * x[1]]

    x = solve_ivp(rates, time[[0, -1]], [0.1, 0.0], t_eval=time, max_step=STEP, rtol=1e-8).y
    acceleration = torque - 4.0 * np.sin(x[0]) - DAMPING * x[1]
    noise = np.random.default_rng(0).normal(size=(COUNT, 2)) * [0.02, 0.1]
    return Course("outputs", torque[:, None], np.column_stack([x[0], acceleration]) + noise, SENSOR.variances, STEP)


def filters() -> dict[str, Filter]:
    parameters = {"stiffness": 4.0}
    return {
        "extended": Ekf(Dense(IDENTIFYING, [SENSOR], parameters)),
        "unscented": Ukf(IDENTIFYING, [SENSOR], parameters, kappa=1.0),
    }


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_a_course_is_its_corrections_one_by_one(kind: str) -> None:
    filter, one_by_one = filters()[kind], filters()[kind]
    found = []
    for each in (filter, one_by_one):
        each.start(START)
        follow = each.follow if each is filter else lambda *a: Filter.follow(one_by_one, *a)
        found.append(follow(course(), 100))
    assert np.array_equal(filter.memory, one_by_one.memory)
    assert np.array_equal(found[0].nis, found[1].nis)
    assert np.array_equal(found[0].memory, found[1].memory)
    assert found[0].memory.shape == (5, filter.memory.size)
    assert filter.belief().mean[2] == pytest.approx(DAMPING, abs=0.03)


@pytest.mark.skipif(compiler() is None, reason="there is no compiler to compare with")
def test_points_go_the_same_way_in_c_as_in_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = filters()["unscented"]
    compiled.start(START)
    compiled.follow(course())
    monkeypatch.setenv("VSENSE_COMPILE", "0")
    plain = filters()["unscented"]
    plain.start(START)
    plain.follow(course())
    assert compiled._operations is not None  # type: ignore[attr-defined]
    assert plain._operations is None  # type: ignore[attr-defined]
    assert plain.memory == pytest.approx(compiled.memory, rel=1e-7, abs=1e-10)


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_a_course_that_cannot_be_followed_says_where(kind: str) -> None:
    filter = filters()[kind]
    filter.start(START)
    good = course()
    inputs = good.inputs.copy()
    inputs[100] = np.inf
    with pytest.raises(FloatingPointError, match=r"1\.9\d s|2\.00 s"):
        filter.follow(good._replace(inputs=inputs))


def test_steps_are_of_third_order() -> None:
    """Against a step a hundred times as short: half the step, an eighth of the error."""
    errors = []
    for h in (0.1, 0.05):
        ends = []
        for parts in (1, 100):
            filter = Ekf(Dense(SYSTEM, [SENSOR], {"stiffness": 4.0, "damping": 0.4}))
            filter.start(Gaussian(np.array([1.0, 0.0]), np.zeros((2, 2))))
            for _ in range(round(1.0 / h) * parts):
                filter.predict(h / parts)
            ends.append(filter.belief().mean)
        errors.append(np.abs(ends[0] - ends[1]).max())
    assert 7.0 < errors[0] / errors[1] < 9.5
