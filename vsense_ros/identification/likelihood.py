"""The likelihood of drives, and the parameters that are likeliest.

A Kalman filter whose state is continued by parameters leaves out that its gain depends on them (Ljung 1979): where the
model is disturbed and the sensors are good, it follows the outputs with any parameters, and these come out wrong
however long the drive is. Here the parameters are constants of a filter of the state alone; its innovations ν with
their covariances S give the log-likelihood -½ Σ (νᵀ S⁻¹ ν + ln |S|) (Schweppe 1965), whose slopes have all of that.

What the noise is matters as much: a car on a road whose driver steers against what disturbs it comes out softer than it
is where disturbances are taken to be larger than they are. So factors of the noise are looked for beside.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Course, Gaussian
from vsense_ros.estimation.integrated import Integrated, Rates
from vsense_ros.estimation.state_space import Named, Symbols
from vsense_ros.identification.information import Information, disagreement
from vsense_ros.identification.progress import Progress
from vsense_ros.identification.rinsing import RINSING, SENSOR, Drive, Identifier, Pass, Rinsed


@dataclass(frozen=True)
class LikelihoodSettings:
    """Settings of the maximisation of the likelihood."""

    difference: float = 1e-3  # [prior deviations] for slopes
    most_iterations: int = 25  # [-]
    longest_step: float = 0.7  # [prior deviations]
    least_gain: float = 0.05  # [nat] of the log of the posterior, below which an iteration is the last
    most_halvings: int = 6  # of a step that does not lead upward


LIKELIHOOD = LikelihoodSettings()


class Innovations(NamedTuple):
    """(N, m), and their covariances (N, m, m)."""

    value: Array
    covariance: Array

    @property
    def log_likelihood(self) -> Array:
        """Logarithm of the likelihood of each sample, (N,), without its constant."""
        squares = np.einsum("ki,kij,kj->k", self.value, np.linalg.inv(self.covariance), self.value)
        return -0.5 * (squares + np.linalg.slogdet(self.covariance)[1])


class _Disturbed(Integrated):
    """Whose disturbances are some factor as strong: parameters `noise_<state>`, logarithms of these."""

    def __init__(self, model: Rates, densities: Mapping[str, float], input_noise: Mapping[str, float]) -> None:
        super().__init__(model, densities, input_noise)
        self.parameters = (*model.parameters, *(f"noise_{name}" for name in self.names))

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """Noise of the model without factors, times their squares."""
        factors = ca.vertcat(*(ca.exp(2 * theta[f"noise_{name}"]) for name in self.names))
        return super().noise(x, u, theta, h) * factors


class Likelihood:
    """Likelihood of the free parameters of an identifier, with its model; and of factors of the noise in `noisy` states
    and in all outputs, whose logarithms are the `factors` (q,)."""

    def __init__(self, identifier: Identifier) -> None:
        self.identifier = identifier
        if identifier.noise.inputs:
            raise InputError("the likelihood knows no noise of inputs")
        system = _Disturbed(identifier.model, identifier.noise.disturbances, {})
        self.noisy = tuple(
            name for name, density in identifier.noise.disturbances.items() if density > 0 and "_offset" not in name
        )
        sensor = system.measurement(identifier.noise.outputs, SENSOR)
        self._parameters = system.parameters
        self._n, self._m = len(system.names), len(identifier.model.outputs)
        self.factors = np.zeros(len(self.noisy) + self._m)
        self._dense = Dense(system, [sensor], self._of(identifier.begin(), self.factors))
        self._filter = Ekf(self._dense)
        symbols = Symbols(system)
        measured, _ = symbols.measured(sensor)
        results = [measured, ca.densify(ca.jacobian(measured, symbols.x.vector))]
        self._outputs = ca.Function("outputs", [symbols.x.vector, symbols.u.vector, symbols.theta.vector], results)
        self._variance = np.square(np.asarray(identifier.noise.outputs, dtype=float))

    def _of(self, values: Array, factors: Array) -> Array:
        by_name = self.identifier.named(values) | {
            f"noise_{name}": factor for name, factor in zip(self.noisy, factors, strict=False)
        }
        return np.array([by_name.get(name, 0.0) if "noise_" in name else by_name[name] for name in self._parameters])

    def innovations(self, drive: Drive, values: Array, factors: Array | None = None) -> Innovations:
        """Innovations of a drive with these parameters (p,). Raises `FloatingPointError` where the filter cannot go
        on."""
        factors = self.factors if factors is None else factors
        n, m, fixed = self._n, self._m, self._of(values, factors)
        variance = self._variance * np.exp(2 * factors[len(self.noisy) :])
        self._dense.parameters[:] = fixed
        self._filter.inputs[:] = drive.inputs[0]
        self._filter.start(Gaussian(drive.start, np.diag(np.square(self.identifier.noise.start))))
        course = Course(SENSOR, drive.inputs, drive.sampled_outputs, variance, drive.h)
        memory = self._filter.follow(course, drive.every).memory
        inputs, measured = drive.inputs[:: drive.every], drive.outputs[:: drive.every]
        outputs, jacobian = self._outputs.map(len(memory))(
            memory[:, :n].T, inputs.T, np.tile(fixed[:, None], len(memory))
        )
        by_state = np.array(jacobian).reshape(m, len(memory), n).transpose(1, 0, 2)
        spread = by_state @ memory[:, n : n + n * n].reshape(-1, n, n) @ by_state.transpose(0, 2, 1)
        return Innovations(measured - np.array(outputs).T, spread + np.diag(variance))

    def value(self, drives: Sequence[Drive], values: Array, factors: Array | None = None) -> float:
        """The log-likelihood, minus infinity where a filter cannot go on."""
        try:
            total = sum(float(self.innovations(drive, values, factors).log_likelihood.sum()) for drive in drives)
        except (FloatingPointError, np.linalg.LinAlgError):
            return -np.inf
        return total if np.isfinite(total) else -np.inf

    def scores(self, drives: Sequence[Drive], values: Array, prior: Array, noise: bool = True) -> tuple[Array, Array]:
        """Slopes of the log-likelihood of pieces of the drives (c, p + q), and its expected information (p + q, p + q),
        both scaled by the prior deviations (p,), of the factors of the noise by 1 (Åström 1980); without these (c, p)
        and (p, p). Raises `FloatingPointError`."""
        point, units = np.concatenate([values, self.factors]), np.concatenate([prior, np.ones(len(self.factors))])
        p, size = len(values), len(point) if noise else len(values)
        pieces, information = [], np.zeros((size, size))
        for drive in drives:
            innovations = self.innovations(drive, values)
            inverse = np.linalg.inv(innovations.covariance)
            weighted = np.einsum("kij,kj->ki", inverse, innovations.value)
            root = np.linalg.cholesky(inverse)
            slopes, factors, whitened = [], [], []
            for i in range(size):
                moved = point.copy()
                moved[i] += LIKELIHOOD.difference * units[i]
                moved_innovations = self.innovations(drive, moved[:p], moved[p:])
                by_value = (moved_innovations.value - innovations.value) / LIKELIHOOD.difference
                factor = inverse @ ((moved_innovations.covariance - innovations.covariance) / LIKELIHOOD.difference)
                quadratic = np.einsum("ki,kij,kj->k", innovations.value, factor, weighted)
                trace = np.trace(factor, axis1=1, axis2=2)
                slopes.append(-np.einsum("ki,ki->k", by_value, weighted) - 0.5 * trace + 0.5 * quadratic)
                whitened.append(np.einsum("kji,kj->ki", root, by_value).ravel())
                factors.append(factor)
            by_parameter = np.array(whitened)
            flat = np.array([factor.ravel() for factor in factors])
            turned = np.array([factor.transpose(0, 2, 1).ravel() for factor in factors])
            information += by_parameter @ by_parameter.T + 0.5 * flat @ turned.T
            pieces += [part.sum(axis=1) for part in np.array_split(np.array(slopes), RINSING.pieces, axis=1)]
        return np.array(pieces), information

    def information(self, drives: Sequence[Drive], values: Array, prior: Array, noise: bool = True) -> Information:
        """What the drives say of the parameters around `values` (p,), as `information.information`; with the factors
        of the noise as unknown as they are."""
        pieces, scaled = self.scores(drives, values, prior, noise)
        p = len(values)
        if noise:
            factors_by_values = np.linalg.solve(scaled[p:, p:] + np.eye(len(self.factors)), scaled[p:, :p])
            pieces, scaled = (
                pieces[:, :p] - pieces[:, p:] @ factors_by_values,
                scaled[:p, :p] - scaled[:p, p:] @ factors_by_values,
            )
        overconfidence = disagreement(pieces, scaled)
        return Information(self.identifier.free, values, prior, scaled / overconfidence, overconfidence, pieces)

    def weigh(
        self,
        drives: Sequence[Drive],
        values: Array,
        start: Array,
        prior: Array,
        noise: bool = True,
        progress: Progress | None = None,
    ) -> tuple[Information, Rinsed]:
        """The parameters that are likeliest by prior and drives together, from `values` (p,), and what is known of
        them: steps by the information (Fisher's scoring), with the prior around `start` (p,); and the way there. With
        `noise`, its factors are looked for beside, and kept. Raises `FloatingPointError` where there is no likelihood
        at the start."""
        identifier, p = self.identifier, len(values)
        inside = 0.01 * (identifier.high - identifier.low)
        inside[~np.isfinite(inside)] = 0.0
        low, high = identifier.low + inside, identifier.high - inside
        values = np.clip(np.asarray(values, dtype=float), low, high)
        passes, settled = list[Pass](), False
        for index in range(LIKELIHOOD.most_iterations):
            begun = time.process_time()
            pieces, scaled = self.scores(drives, values, prior, noise)
            distance = (values - start) / prior
            distance = np.concatenate([distance, self.factors]) if noise else distance
            step = np.linalg.solve(scaled + np.eye(len(distance)), pieces.sum(axis=0) - distance)
            step *= min(1.0, LIKELIHOOD.longest_step / max(float(np.abs(step).max()), 1e-12))
            present = self._posterior(drives, values, self.factors, start, prior)
            for halving in range(LIKELIHOOD.most_halvings):
                new = np.clip(values + prior * step[:p] / 2**halving, low, high)
                factors = self.factors + step[p:] / 2**halving if noise else self.factors
                stepped = self._posterior(drives, new, factors, start, prior)
                if stepped > present:
                    break
            else:
                new, factors, stepped = values, self.factors, present
            passes.append(self._pass(drives, values, new, time.process_time() - begun))
            if progress is not None:
                progress((index + 1) / LIKELIHOOD.most_iterations)
            values, self.factors, settled = new, factors, stepped - present < LIKELIHOOD.least_gain
            if settled:
                break
        return self.information(drives, values, prior, noise), Rinsed(values, settled, tuple(passes))

    def _pass(self, drives: Sequence[Drive], before: Array, values: Array, seconds: float) -> Pass:
        """One iteration, as a pass of a filter."""
        innovations = [self.innovations(drive, values) for drive in drives]
        value, covariance = (np.concatenate(parts) for parts in zip(*innovations, strict=True))
        whitened = np.einsum("ki,kij,kj->k", value, np.linalg.inv(covariance), value)
        rms = float(np.sqrt(whitened.mean() / self._m))
        moved = self.identifier.moved(before, values)
        return Pass(values, moved, rms, np.mean(value**2, axis=0), seconds, values[None], np.zeros(1))

    def _posterior(self, drives: Sequence[Drive], values: Array, factors: Array, start: Array, prior: Array) -> float:
        distance = (values - start) / prior
        return self.value(drives, values, factors) - 0.5 * float(distance @ distance + factors @ factors)
