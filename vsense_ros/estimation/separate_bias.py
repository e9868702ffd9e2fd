"""Parameters estimated beside a filter that takes them as known (Friedland 1969; Hsieh & Chen 1999).

The error of the state is written as δx = δx̃ + V δθ, with δx̃ independent of δθ: then P̃, of size e, is the covariance of
a filter for known parameters, and V (e, p) and M (p, p) belong to a filter of p parameters. On a linear system both
together are the filter of the augmented state, at the cost of a filter of e states and p² + e p numbers beside it:

    Ū = F V + ∂f/∂θ,  M⁺ = M + Q_θ,  V⁺ = Ū M M⁺⁻¹,  P̃⁺ = F P̃ Fᵀ + Q + Ū (M - M M⁺⁻¹ M) Ūᵀ
    S = H V + ∂h/∂θ,  K̃ = P̃ Hᵀ (H P̃ Hᵀ + R)⁻¹,  V⁺ = V - K̃ S,  K_θ = M Sᵀ (H P̃ Hᵀ + R + S M Sᵀ)⁻¹

The first line's last two are of Hsieh & Chen, for parameters that drift; Friedland's are constant, Q_θ = 0. State and
parameters stay the filter's own: δθ goes at once into both, so that the next linearisation is where the estimate is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Innovation
from vsense_ros.estimation.gaussian import (
    COMPONENTS,
    Whitened,
    check_belief,
    check_variances,
    inflate,
    is_definite,
    whiten,
)
from vsense_ros.estimation.state_space import Symbols, title


class Sensitivity(Protocol):
    """What parameters change in one system, which has their values in its memory."""

    names: tuple[str, ...]

    def get(self) -> Array:
        """Values of the parameters (p,)."""

    def put(self, values: Array) -> None:
        """Make the system work with these values (p,)."""

    def prepare(self, h: float) -> None:
        """Before a step of `h` [s]: ∂f/∂θ is that of the state before it."""

    def moved(self, v: Array) -> Array:
        """After that step: F V + ∂f/∂θ, (e, p)."""

    def sense(self, sensor: str) -> Array:
        """∂h/∂θ (m, p) of a sensor at the present state."""


class SeparateBias(Filter):
    """An `Ekf`, and beside it a filter of some of its parameters, each with the standard deviation
    [unit of the parameter/√s] by which it drifts: 0 for a constant.

    `names` are those of the filter, then of the parameters; so are mean and covariance of `start` and `belief`. What
    parameters change is made by `sensitivity` of the filter's system and their names; of a state space it is derived.
    """

    def __init__(
        self,
        filter: Ekf,
        drifts: Mapping[str, float],
        sensitivity: Callable[[Any, tuple[str, ...]], Sensitivity] | None = None,
        memory: Array | None = None,
    ) -> None:
        e, p = len(filter.covariance), len(drifts)
        lengths = [len(filter.memory), e * p, p * p]
        self.memory = np.zeros(sum(lengths)) if memory is None else memory
        own, v, m = np.split(self.memory, np.cumsum(lengths[:-1]).tolist())
        self.filter = filter.at(own)
        self.inputs, self.sensors = self.filter.inputs, filter.sensors
        self.v, self.bias_covariance = v.reshape(e, p), m.reshape(p, p)
        self._made = _of_a_state_space if sensitivity is None else sensitivity
        self.sensitivity = self._made(self.filter.system, tuple(drifts))
        self.names = filter.names + self.sensitivity.names
        self._drifts, self._density = dict(drifts), np.square(list(drifts.values()))
        self._whitened, self._factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)

    def at(self, memory: Array) -> SeparateBias:
        """The same, with its memory in this array (s,)."""
        memory[:] = self.memory
        return SeparateBias(self.filter, self._drifts, self._made, memory)

    def start(self, belief: Gaussian) -> None:
        """Begin anew, at the mean (n + p,) and the covariance (e + p, e + p) of state and parameters."""
        n, (e, p) = len(self.filter.mean), self.v.shape
        mean, covariance = np.asarray(belief.mean, dtype=float), np.asarray(belief.covariance, dtype=float)
        check_belief(mean, covariance, n + p, e + p)
        self.bias_covariance[:] = covariance[e:, e:]
        self.v[:] = covariance[:e, e:] @ np.linalg.pinv(covariance[e:, e:], hermitian=True)
        self.sensitivity.put(mean[n:])
        own = covariance[:e, :e] - self.v @ self.bias_covariance @ self.v.T
        self.filter.start(Gaussian(mean[:n], 0.5 * (own + own.T)))

    def predict(self, h: float) -> None:
        """Go on by `h` [s]."""
        self.sensitivity.prepare(h)
        self.filter.predict(h)
        moved, m = self.sensitivity.moved(self.v), self.bias_covariance
        if not self._density.any():
            self.v[:] = moved
            return
        grown = m + np.diag(self._density * h)
        kept = np.linalg.solve(grown, m)  # M⁺⁻¹ M
        self.v[:] = moved @ kept.T
        added = moved @ (m - m @ kept) @ moved.T
        self.filter.covariance += 0.5 * (added + added.T)
        m[:] = grown

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """As `Filter.correct`: the innovation is that of state and parameters together."""
        check_variances(sensor, value, variance)
        residual, h = self.filter.system.sense(sensor, value)
        s = h @ self.v + self.sensitivity.sense(sensor)
        across, of_bias = h @ self.filter.covariance, s @ self.bias_covariance
        by_bias = of_bias @ s.T
        total = scale * (across @ h.T + np.diag(variance) + by_bias)
        found = whiten(residual, total, np.column_stack([across + of_bias @ self.v.T, of_bias]))
        found.write(self._whitened, self._factor)
        if 0.0 <= found.nis <= limit:
            present = found.present
            self._accept(found, s[present], across[present], (total - by_bias)[np.ix_(present, present)])
        elif found.nis != found.nis:
            self._recover(sensor)
        m = len(value)
        factor = self._factor[: m * m].reshape(m, m)
        return Innovation(self._whitened[:m], factor, found.nis, 0.0 <= found.nis <= limit)

    def _accept(self, found: Whitened, s: Array, across: Array, known: Array) -> None:
        """Correct by an innovation: S (m, p), H P̃ (m, e), and its covariance (m, m) if the parameters were known."""
        e, own = len(self.v), self.filter.covariance
        gain = np.linalg.solve(known, across)  # K̃ᵀ
        self.v -= gain.T @ s
        removed = gain.T @ across
        own -= 0.5 * (removed + removed.T)
        by_bias = found.projected[:, e:]
        self.bias_covariance -= by_bias.T @ by_bias
        error = found.error
        self.sensitivity.put(self.sensitivity.get() + error[e:])
        self.filter.system.retract(error[:e])

    def _recover(self, sensor: str) -> None:
        """Begin the covariances anew, and say so, if they were what spoilt a correction."""
        if not is_definite(self.bias_covariance):
            self.inflate()
        self.filter.recover(sensor)

    def belief(self) -> Gaussian:
        """Mean (n + p,) and covariance (e + p, e + p) of state and parameters."""
        across = self.v @ self.bias_covariance
        own = self.filter.covariance + across @ self.v.T
        mean = np.concatenate([self.filter.mean, self.sensitivity.get()])
        return Gaussian(mean, np.block([[own, across], [across.T, self.bias_covariance]]))

    def is_valid(self) -> bool:
        """Whether the filter is, and the parameters are finite with no variance below zero."""
        fine = np.isfinite(self.sensitivity.get()).all() and (self.bias_covariance.diagonal() >= 0).all()
        return bool(fine) and self.filter.is_valid()

    def inflate(self) -> None:
        """Forget how errors belong together, and double their standard deviations."""
        covariance = self.belief().covariance
        e = len(self.v)
        inflate(covariance)
        self.v[:] = 0.0
        self.filter.covariance[:], self.bias_covariance[:] = covariance[:e, :e], covariance[e:, e:]


def _of_a_state_space(system: Any, names: tuple[str, ...]) -> Sensitivity:
    """What parameters change in a `Dense`. Raises `InputError` for other systems."""
    if not isinstance(system, Dense):
        raise InputError(f"what parameters change in {type(system).__name__} must be told: give a `sensitivity`")
    return DenseSensitivity(system, names)


class DenseSensitivity:
    """Derivatives of a state space by some of its parameters."""

    def __init__(self, dense: Dense, names: tuple[str, ...]) -> None:
        if unknown := [name for name in names if name not in dense.system.parameters]:
            known = ", ".join(dense.system.parameters) or "none"
            raise InputError(f"{title(dense.system)} has no parameter {unknown[0]!r}; it has: {known}")
        self.dense, self.names = dense, names
        self._places = [dense.system.parameters.index(name) for name in names]
        self._h, functions = np.zeros(1), self._functions()
        at = [dense.mean, dense.inputs, dense.parameters]
        self._step = Kernel(functions[0], [*at, self._h])
        self._sense = {name: Kernel(f, at) for name, f in zip(dense.sensors, functions[1:], strict=True)}

    def _functions(self) -> list[ca.Function]:
        """∂f/∂θ in terms of the error, and ∂h/∂θ of each sensor."""
        system = self.dense.system
        at = Symbols(system)
        chosen = self._places

        def by_parameters(found: ca.SX) -> ca.SX:
            return ca.jacobian(found, at.theta.vector)[:, chosen]

        moved = at.moved()
        inward = ca.SX.eye(moved.numel()) if system.is_flat else at.inward(moved)
        made = [codegen.function("step", [*at.now, at.h], [inward @ by_parameters(moved)], ("x", "u", "p", "h"))]
        for i, one in enumerate(self.dense.measurements.values()):
            found = by_parameters(at.measured(one)[0])
            made.append(codegen.function(f"sense_{i}", at.now, [found], ("x", "u", "p")))
        return codegen.compiled(f"sensitivity_{title(system)}", made)

    def get(self) -> Array:
        """Values of the parameters (p,)."""
        return self.dense.parameters[self._places]

    def put(self, values: Array) -> None:
        """Make the system work with these values (p,)."""
        self.dense.parameters[self._places] = values

    def prepare(self, h: float) -> None:
        """Before a step of `h` [s]."""
        self._h[0] = h
        self._step.call()

    def moved(self, v: Array) -> Array:
        """After that step: F V + ∂f/∂θ, (e, p)."""
        return self.dense.transition_matrix @ v + self._step.results[0]

    def sense(self, sensor: str) -> Array:
        """∂h/∂θ (m, p) of a sensor at the present state."""
        kernel = self._sense[sensor]
        kernel.call()
        return kernel.results[0]
