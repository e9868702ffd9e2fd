"""The bootstrap particle filter (Gordon, Salmond & Smith 1993; Arulampalam et al. 2002, algorithm 4).

Particles move by the equations with noise drawn for each, are weighed by the likelihood of what is measured, and drawn
anew, systematically, when few of them have all the weight. No Jacobian is made and no distribution assumed; the price
is some hundred evaluations a step. Its random numbers are counted in its memory, so that it does the same again when a
late measurement makes it go back. States are vectors: ⊞ is +.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Gaussian, Innovation
from vsense_ros.estimation.gaussian import COMPONENTS, GaussianFilter, check_variances
from vsense_ros.estimation.operations import unknown_sensor
from vsense_ros.estimation.state_space import (
    Measurement,
    StateSpace,
    Symbols,
    by_name,
    parameter_values,
    residual,
    title,
)


@dataclass(frozen=True)
class ParticleSettings:
    """How many particles there are, and when they are drawn anew."""

    count: int = 500
    seed: int = 0
    # Share of effective particles below which they are drawn anew [-] (Arulampalam et al. 2002, section V.A).
    fewest_effective: float = 0.5
    least_deviation: float = 1e-12  # [unit of the state], below which a state does not move at random: rounding


class ParticleFilter(GaussianFilter):
    """Filter of a state space by particles. Raises `InputError` where ⊞ of the system is not +."""

    def __init__(
        self,
        system: StateSpace,
        measurements: Sequence[Measurement],
        parameters: Mapping[str, float] | Sequence[float] | Array = (),
        settings: ParticleSettings | None = None,
    ) -> None:
        if not system.is_flat:
            raise InputError(f"the states of {title(system)} are no vector, which a particle filter needs")
        self.system, self.measurements = system, by_name(measurements, COMPONENTS)
        self.names, self.sensors = system.names, tuple(self.measurements)
        self.settings = ParticleSettings() if settings is None else settings
        self.parameters, self.count = parameter_values(system, parameters), self.settings.count
        count = self.count
        n, k = len(system.names), len(system.inputs)
        self.memory = np.zeros(n + n * n + k + 1 + count + n * count)
        bounds = np.cumsum([n, n * n, k, 1, count]).tolist()
        self.mean, covariance, self.inputs, self._drawn, self.log_weights, cloud = np.split(self.memory, bounds)
        self.covariance, self.cloud = covariance.reshape(n, n), cloud.reshape(n, count)
        at = Symbols(system)
        self._move = ca.Function("move", [*at.now, at.h], [at.moved()]).map(count)
        self._noise = ca.Function("noise", [*at.now, at.h], [at.noise()])
        self._sense = {}
        for one in measurements:
            value = ca.SX.sym("value", len(one.deviations))
            expected, used = at.measured(one)
            results = [residual(value, expected, one.angles), used]
            self._sense[one.name] = ca.Function("sense", [*at.now, value], results).map(count)

    def _random(self) -> np.random.Generator:
        """The next numbers, by how often some were drawn."""
        self._drawn += 1
        return np.random.Generator(np.random.Philox(key=self.settings.seed, counter=[0, 0, 0, int(self._drawn[0])]))

    def start(self, belief: Gaussian) -> None:
        """Begin anew, with particles of this distribution."""
        self.check(belief)
        self._drawn[:] = 0.0
        self.cloud[:] = self._scattered(np.asarray(belief.mean)[:, None], np.asarray(belief.covariance))
        self.log_weights[:] = -np.log(self.count)
        self._summarize()

    def _scattered(self, cloud: Array, covariance: Array) -> Array:
        values, vectors = np.linalg.eigh(covariance)
        spread = vectors * np.sqrt(np.where(values > self.settings.least_deviation**2, values, 0.0))
        return np.asarray(cloud + spread @ self._random().standard_normal((len(cloud), self.count)))

    def predict(self, h: float) -> None:
        """Move each particle, and scatter it."""
        moved = np.array(self._move(self.cloud, self.inputs, self.parameters, h))
        if not np.isfinite(moved).all():
            raise FloatingPointError(f"{title(self.system)} cannot be moved: a particle would not be finite")
        noise = np.array(self._noise(self.mean, self.inputs, self.parameters, h))
        self.cloud[:] = self._scattered(moved, noise)
        self._summarize()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """Weigh the particles. The normalized innovation squared is that of their mean and spread."""
        if sensor not in self._sense:
            raise unknown_sensor(sensor, self.sensors)
        check_variances(sensor, value, variance)
        residuals, used = (
            np.array(one) for one in self._sense[sensor](self.cloud, self.inputs, self.parameters, value)
        )
        present = np.isfinite(residuals).all(axis=1) & bool(used.any())
        m = len(value)
        if not present.any():
            return Innovation(np.full(m, np.nan), np.eye(m), -1.0, False)
        weights, off = np.exp(self.log_weights), residuals[present]
        mean = off @ weights
        total = scale * ((off - mean[:, None]) * weights @ (off - mean[:, None]).T + np.diag(variance[present]))
        factor = np.linalg.cholesky(total)
        whitened, every = np.full(m, np.nan), np.eye(m)
        whitened[present] = np.linalg.solve(factor, mean)
        every[np.ix_(present, present)] = factor
        nis = float(np.nansum(whitened**2))
        if nis > limit:
            return Innovation(whitened, every, nis, False)
        self.log_weights -= 0.5 * np.sum(off**2 / (scale * variance[present, None]), axis=0)
        self.log_weights -= self.log_weights.max()
        self.log_weights -= np.log(np.sum(np.exp(self.log_weights)))
        weights = np.exp(self.log_weights)
        if 1 / np.sum(weights**2) < self.settings.fewest_effective * self.count:
            places = (np.arange(self.count) + self._random().random()) / self.count
            chosen = np.searchsorted(np.cumsum(weights), places).clip(max=self.count - 1)
            self.cloud[:] = self.cloud[:, chosen]
            self.log_weights[:] = -np.log(self.count)
        self._summarize()
        return Innovation(whitened, every, nis, True)

    def _summarize(self) -> None:
        weights = np.exp(self.log_weights)
        self.mean[:] = self.cloud @ weights
        off = self.cloud - self.mean[:, None]
        self.covariance[:] = off * weights @ off.T

    def is_valid(self) -> bool:
        """True if all particles are finite."""
        return bool(np.isfinite(self.cloud).all())

    def inflate(self) -> None:
        """Scatter the particles about their mean, twice as far."""
        self.start(Gaussian(self.mean.copy(), 4 * np.diag(np.diag(self.covariance))))
