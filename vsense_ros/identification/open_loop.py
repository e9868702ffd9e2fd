"""The model alone, which nothing corrects: its outputs, and how they depend on its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Course, Gaussian
from vsense_ros.estimation.integrated import Integrated, Rates
from vsense_ros.estimation.state_space import Symbols
from vsense_ros.identification.rinsing import SENSOR, Drive


class OpenLoop:
    """Open-loop simulation of a model with values for all its parameters, of which some are `free`.

    An extended filter without measurements carries the derivatives in its covariance: where that of the parameters is 1
    and nothing disturbs the state, the covariance of state and parameters is the derivative of the one by the other.
    """

    def __init__(self, model: Rates, values: Mapping[str, float], free: Sequence[str]) -> None:
        system = Integrated(model, {})
        augmented = Augmented(system, dict.fromkeys(free, 0.0))
        sensor = system.measurement((1.0,) * len(model.outputs), SENSOR)
        self._n, self._m = len(system.names), len(model.outputs)
        self._fixed = np.array([values[name] for name in augmented.parameters])
        self._filter = Ekf(Dense(augmented, [sensor], self._fixed))
        symbols = Symbols(augmented)
        measured, _ = symbols.measured(sensor)
        results = [measured, ca.densify(ca.jacobian(measured, symbols.x.vector))]
        self._outputs = ca.Function("outputs", [symbols.x.vector, symbols.u.vector, symbols.theta.vector], results)

    def states(self, drive: Drive, values: Array) -> Array:
        """(N, n). Raises `FloatingPointError` where they are none that can be."""
        return self._run(drive, values)[:, : self._n]

    def outputs(self, drive: Drive, values: Array) -> Array:
        """Outputs (N, m) of the model along a drive. Raises `FloatingPointError`."""
        means = self._run(drive, values)[:, : self._n + len(values)]
        return self._at(means, drive.inputs)[0]

    def sensitivities(self, drive: Drive, values: Array) -> tuple[Array, Array]:
        """Outputs (N, m) and their derivatives (N, m, p) by the free parameters. Raises `FloatingPointError`."""
        size = self._n + len(values)
        memory = self._run(drive, values)
        outputs, jacobian = self._at(memory[:, :size], drive.inputs)
        covariance = memory[:, size : size + size**2].reshape(-1, size, size)
        by_parameters = jacobian[:, :, : self._n] @ covariance[:, : self._n, self._n :] + jacobian[:, :, self._n :]
        return outputs, by_parameters

    def _run(self, drive: Drive, values: Array) -> Array:
        """Memory of the filter before each sample, (N, s)."""
        size, count = self._n + len(values), len(drive.inputs)
        spread = np.zeros((size, size))
        spread[self._n :, self._n :] = np.eye(len(values))
        self._filter.inputs[:] = drive.inputs[0]
        self._filter.start(Gaussian(np.concatenate([drive.start, values]), spread))
        nothing = np.full((count, self._m), np.nan)
        course = Course(SENSOR, drive.inputs, nothing, np.ones(self._m), drive.h)
        return self._filter.follow(course, 1).memory

    def _at(self, means: Array, inputs: Array) -> tuple[Array, Array]:
        """Outputs (N, m) and their derivatives (N, m, n + p) by states and free parameters."""
        count = len(means)
        fixed = np.tile(self._fixed[:, None], count)
        outputs, jacobian = self._outputs.map(count)(means.T, inputs.T, fixed)
        return np.array(outputs).T, np.array(jacobian).reshape(self._m, count, -1).transpose(1, 0, 2)
