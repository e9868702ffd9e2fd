"""What a drive told of the free parameters, and what it did not.

The posterior covariance of a pass that began with the prior covariance D² gives the information of the drive alone,
I = P⁻¹ - D⁻². Units of parameters differ, so that its eigenvalues mean nothing until it is scaled, D I D: an eigenvalue
of 1 halves the variance of its direction, one far below 1 leaves what was known before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.observability import Direction
from vsense_ros.identify.rinsing import Drive, Identifier

TOLD = 0.5  # of its prior deviation: a parameter of which no more is left is told
CORRELATED = 0.9  # correlation from which on two parameters are named together


@dataclass(frozen=True)
class Information:
    """Of the parameters `names` at `values` (p,), with prior deviations (p,): `scaled` information D I D (p, p)."""

    names: tuple[str, ...]
    values: Array
    prior: Array
    scaled: Array

    @property
    def covariance(self) -> Array:
        """Of the parameters, prior and drive together (p, p)."""
        inverse = np.linalg.inv(self.scaled + np.eye(len(self.names)))
        return self.prior[:, None] * inverse * self.prior

    @property
    def deviations(self) -> Array:
        """Standard deviations (p,), prior and drive together."""
        return np.sqrt(self.covariance.diagonal())

    @property
    def left(self) -> Array:
        """Of the prior deviation, (p,)."""
        return self.deviations / self.prior

    @property
    def correlation(self) -> Array:
        """(p, p)"""
        deviations = self.deviations
        return np.asarray(self.covariance / np.outer(deviations, deviations))

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Combinations of parameters in units of their prior deviations, the least told first."""
        values, vectors = np.linalg.eigh(self.scaled)
        return tuple(Direction(v, float(w), self.names) for w, v in zip(values, vectors.T, strict=True))

    def deviation_of(self, gradient: Array) -> float:
        """Standard deviation of a function of the parameters with this gradient (p,)."""
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def without(self, name: str) -> Information:
        """The same if one parameter were known, and is as it is."""
        stay = [i for i, one in enumerate(self.names) if one != name]
        square = np.ix_(stay, stay)
        return Information(
            tuple(self.names[i] for i in stay), self.values[stay], self.prior[stay], self.scaled[square]
        )

    def pairs(self) -> list[tuple[str, str, float]]:
        """Parameters that the drive can hardly tell apart, with their correlation, the closest first."""
        found = [
            (self.names[i], self.names[j], float(self.correlation[i, j]))
            for i in range(len(self.names)) for j in range(i) if abs(self.correlation[i, j]) >= CORRELATED
        ]  # fmt: skip
        return sorted(found, key=lambda pair: -abs(pair[2]))


def information(
    identifier: Identifier, drives: Sequence[Drive], values: Array, prior: Array, share: float = 0.05,
    inflation: float = 1.0,
) -> Information:
    """What drives tell of the parameters around `values` (p,), whose prior deviations are `prior` (p,).

    The pass that tells it begins with only a `share` of these, so that the equations stay as they are there.
    `inflation` is how much larger the variance of the residuals is than what the filter takes it for.
    Raises `FloatingPointError` where the pass cannot go on.
    """
    deviations = share * prior
    belief, _ = identifier.follow(drives, values, np.diag(deviations**2))
    within = belief.covariance / np.outer(deviations, deviations)
    scaled = np.linalg.inv(within) - np.eye(len(prior))
    scaled = 0.5 * (scaled + scaled.T) / share**2 / inflation
    return Information(identifier.free, np.asarray(values, dtype=float), prior, scaled)


def freeze(found: Information, first: Sequence[str] = (), limit: float = TOLD) -> list[tuple[str, float]]:
    """Parameters that are to be held because the drive does not tell them, in order, each with the share of its prior
    deviation that is left; one at a time, as what remains is told better then.

    Of several that are told as little, one of `first` is held before the others.
    """
    frozen = []
    while found.names:
        left = found.left
        if left.max() <= limit:
            break
        alike = [name for name, share in zip(found.names, left, strict=True) if share > 0.9 * left.max()]
        name = next((name for name in first if name in alike), found.names[int(np.argmax(left))])
        frozen.append((name, float(left[found.names.index(name)])))
        found = found.without(name)
    return frozen
