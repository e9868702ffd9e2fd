"""What measurement and simulation differ by, weighted: what the mismatch search minimises."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import DivergedError, cost
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.signals import SHAKING, difference, grid
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ResidualSettings:
    """Weights of residuals: decisions of this project."""

    # [-] share of a signal's own amplitude that a good model may miss, which no sensor is better than
    model_error_share: float = 0.03
    outlier: float = 40.0  # [standard deviations] beyond which a residual counts as that many
    # Standard deviations of all signals together from where on an instant counts for less and less (Cauchy's
    # loss): a simulated car that spins at the limit, where the real one just did not, says no more than that.
    far: float = 5.0
    astray_before: float = 1.0  # [s] for which a car is off course before it is noticed to be lost
    least_kept: int = 50  # instants of a window, below which nothing of it is compared
    shaken_factor: float = 1.4  # [-] how much further off a good model is in signals that any road shakes


RESIDUALS = ResidualSettings()


class Residuals:
    """Weighted differences of measurement and simulation, by window: what `identify.least_squares` minimises."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor
        measured = predictor.measured
        names = [name for name in compared_signals() if any(name in m for m in measured)]
        self.deviation = {}
        for name in names:
            size = np.concatenate([m[name] - m[name].mean() for m in measured if name in m]).std()
            noise = predictor.noise.get(name, 0.0)
            self.deviation[name] = float(
                np.linalg.norm([compared_signals()[name].floor, RESIDUALS.model_error_share * size, noise])
            )
        self.layout = [[name for name in names if name in m] for m in measured]
        self._instants = [grid(window) for window in predictor.dataset.windows]

    @property
    def at_once(self) -> int:
        """How many parameter sets are best driven side by side."""
        return self.predictor.ahead

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        """Drive up to `at_once` parameter sets, whose residuals are asked for next: by how far they are from another
        one, if they are `near` it."""
        if near is None:
            self.predictor.foresee(parameter_sets)
        else:
            self.predictor.foresee_near(near, parameter_sets)

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        """True for each window in which the simulated car gets lost."""
        return self.predictor.lost(parameter_set)

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[Array] | None = None) -> list[Array]:
        """Residuals of each window, (signals × instants,) in the order of `layout`; in standard deviations, and less
        where the simulation has gone `RESIDUALS.far`. Once the simulated car is lost they are those of `instead`, if
        that is given.

        Raises `DivergedError` where a simulation leaves all bounds and there is nothing instead.
        """
        if instead is None:
            weighted = self._until(parameter_set, [np.inf] * len(self.layout))
            return [rows.reshape(-1) for rows in weighted]
        weighted = self._until(parameter_set, self.predictor.lost_from(parameter_set))
        return [
            np.column_stack([rows, known.reshape(len(rows), -1)[:, rows.shape[1] :]]).reshape(-1)
            if len(rows)
            else known
            for rows, known in zip(weighted, instead, strict=True)
        ]

    def compared(self, parameter_set: ParameterSet, until: Sequence[float]) -> list[Array]:
        """Residuals of each window until a time [s]."""
        return [rows.reshape(-1) for rows in self._until(parameter_set, until)]

    def _until(self, parameter_set: ParameterSet, until: Sequence[float]) -> list[Array]:
        """Residuals of each window (signals, instants) until `RESIDUALS.astray_before` its time [s]; no instants if
        those are few."""
        result = []
        simulations = zip(self.predictor.measured, self.predictor.simulated(parameter_set), strict=True)
        for (measured, simulated), names, t, end in zip(simulations, self.layout, self._instants, until, strict=True):
            kept = len(t) if np.isinf(end) else int(np.searchsorted(t, end - RESIDUALS.astray_before))
            if kept < min(RESIDUALS.least_kept, len(t)) or not names:
                result.append(np.zeros((len(names), 0)))
                continue
            if not simulated:
                raise DivergedError
            off = difference({n: v[:kept] for n, v in measured.items()}, {n: v[:kept] for n, v in simulated.items()})
            rows = np.array([off[name] / self.deviation[name] for name in names if name in off]).reshape(-1, kept)
            result.append(tempered(np.clip(rows, -RESIDUALS.outlier, RESIDUALS.outlier)))
        return result

    @staticmethod
    def level(residuals: Sequence[Array]) -> float:
        """Root mean square of all residuals, in standard deviations."""
        return float(np.sqrt(cost(residuals) / max(sum(len(r) for r in residuals), 1)))

    def worst(self, residuals: Sequence[Array]) -> float:
        """Root mean square of the worst signal's residuals, in standard deviations; of signals that any road shakes,
        over how much this one does."""
        return self.furthest(residuals)[1]

    def furthest(self, residuals: Sequence[Array]) -> tuple[str, float]:
        """The worst signal by name, empty if there is none, and how bad it is."""
        good = self.good(residuals)
        off = {name: error / good[name] for name, error in self.deviations(residuals).items()}
        return max(off.items(), key=itemgetter(1), default=("", 0.0))

    def good(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square that a good model leaves of each signal, in standard deviations: more of those that any road
        shakes, by as much as this one does."""
        errors = self.deviations(residuals)
        shaken = {name for name, signal in compared_signals().items() if signal.shaken}
        road = RESIDUALS.shaken_factor * max(1.0, errors.get(SHAKING, 1.0))
        return {name: road if name in shaken else 1.0 for name in errors}

    def deviations(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square of each signal's residual, in standard deviations."""
        return self._root_mean_squares(residuals, lambda rows: rows)

    def by_signal(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square of each signal's error in its unit."""
        relative = self._root_mean_squares(residuals, untempered)
        return {name: off * self.deviation[name] for name, off in relative.items()}

    def _root_mean_squares(self, residuals: Sequence[Array], of: Callable[[Array], Array]) -> dict[str, float]:
        parts: dict[str, list[Array]] = {}
        for rows, names in zip(residuals, self.layout, strict=True):
            if len(rows):
                for name, part in zip(names, of(rows.reshape(len(names), -1)), strict=True):
                    parts.setdefault(name, []).append(part)
        return {name: float(np.sqrt(np.mean(np.concatenate(p) ** 2))) for name, p in parts.items()}


def tempered(off: Array) -> Array:
    """Residuals (signals, instants) with those shortened at instants where all signals together are far off, by
    Cauchy's loss."""
    far = np.maximum(np.mean(off**2, axis=0) / RESIDUALS.far**2, 1e-12)
    return np.asarray(off * np.sqrt(np.log1p(far) / far))


def untempered(tempered: Array) -> Array:
    """The inverse of `tempered`."""
    near = np.maximum(np.mean(tempered**2, axis=0) / RESIDUALS.far**2, 1e-12)
    return np.asarray(tempered * np.sqrt(np.expm1(near) / near))
