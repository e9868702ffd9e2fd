"""What a step of a filter of any state space costs: a prediction and a correction, beside filterpy's in the same run.

filterpy gets a linear model of equal size, with Jacobians that are there already; ours makes them anew in each step.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "estimation"))

from systems import CASES, IMU, REST, STIFFNESS, Case, SingleTrack
from vsense_ros import codegen
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.ukf import Ukf

SIZES = {4: "velocity", 27: "chain"}
FILTERS: dict[str, Callable[[Case], Any]] = {
    "extended": lambda case: Ekf(case.dense()),
    "unscented": lambda case: Ukf(case.system, case.measurements, case.parameters),
}
compiled = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")


@compiled
@pytest.mark.parametrize("states", SIZES)
@pytest.mark.parametrize("way", FILTERS)
def test_filter(benchmark: Any, way: str, states: int) -> None:
    benchmark.group = f"filter of {states} states: prediction and correction"
    case = CASES[SIZES[states]]
    filter = case.begun(FILTERS[way](case))
    name, value, variance, _ = case.measurements[0].measured(np.zeros(len(case.measurements[0].deviations)))

    def step() -> None:
        filter.predict(0.01)
        filter.correct(name, value, variance)

    benchmark(step)
    assert filter.is_valid()


@pytest.mark.parametrize("states", SIZES)
def test_filterpy(benchmark: Any, states: int) -> None:
    filters = pytest.importorskip("filterpy.kalman", reason="filterpy is not installed")
    benchmark.group = f"filter of {states} states: prediction and correction"
    m = len(CASES[SIZES[states]].measurements[0].deviations)
    random = np.random.default_rng(0)
    made = filters.ExtendedKalmanFilter(states, m)
    made.F = 0.99 * np.linalg.qr(random.normal(size=(states, states)))[0]
    made.Q *= 1e-3
    observation, column = random.normal(size=(m, states)), random.normal(size=(m, 1))

    def step() -> None:
        made.predict()
        made.update(column, lambda _: observation, lambda x: observation @ x)

    benchmark(step)


@compiled
@pytest.mark.benchmark(group="identification of two parameters beside two states: prediction and correction")
@pytest.mark.parametrize("way", ["extended", "unscented"])
def test_identifying(benchmark: Any, way: str) -> None:
    system = Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 0.0))
    filter: Any = Ekf(Dense(system, [IMU], REST)) if way == "extended" else Ukf(system, [IMU], REST)
    filter.inputs[:] = 0.02, 15.0
    filter.start(Gaussian(np.array([0.0, 0.0, 120e3, 180e3]), np.diag([0.3, 0.1, 3e4, 3e4]) ** 2))

    def step() -> None:
        filter.predict(0.01)
        filter.correct("imu", np.array([0.1, 1.5]), IMU.variances)

    benchmark(step)
    assert filter.is_valid()
