"""The normal equations of a fit: what small changes of its free parameters would do.

Each window's share is kept apart, so that any part of the data set can be left out without simulating anything again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.candidates import FreeParameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equations:
    """The normal equations of a fit: all that it takes to judge small changes of its free parameters, on any of its
    windows."""

    free_parameters: tuple[FreeParameter, ...]
    scaled_offsets: Array  # (k,) where the free parameters are [deviations]
    weight: float  # what a free parameter that is one deviation off costs
    normal: Array  # (windows, k, k) products of the slopes
    right: Array  # (windows, k) of the slopes and the residuals
    costs: Array  # (windows,) sums of squared residuals
    rows: NDArray[np.int64]  # (windows,) numbers of residuals

    def change(self, windows: Sequence[int] | None = None) -> Array:
        """(k,) by which the free parameters have to turn [deviations] for the least value of all or some of the
        windows."""
        chosen = slice(None) if windows is None else list(windows)
        normal, right = self.normal[chosen].sum(axis=0), self.right[chosen].sum(axis=0)
        return least(normal, right, self.scaled_offsets, self.weight)

    def values(self, change: Array | None = None) -> Array:
        """(windows,) what is minimised, after a change of the free parameters [deviations], by window. Where the free
        parameters are costs each as much as its share of all residuals says."""
        moved, prior = self.costs, self.scaled_offsets
        if change is not None:
            moved = moved + 2 * self.right @ change + (self.normal @ change) @ change
            prior = prior + change
        return np.asarray(moved + self.weight * float(prior @ prior) * self.rows / self.rows.sum())

    def spread(self) -> Array:
        """(k,) standard deviations of the free parameters [deviations], if what is likely of them and what they are
        found to cost is all that is known."""
        normal = self.normal.sum(axis=0)
        inverse = np.linalg.inv(normal + self.weight * np.eye(len(normal)))
        return np.asarray(np.sqrt(self.weight * np.diag(inverse)))

    def out_of_sample(self, group: Sequence[int]) -> float:
        """The value of a group of windows after a fit to all others; where there are no others, as they are."""
        rest = [i for i in range(len(self.rows)) if i not in group]
        return float(self.values(self.change(rest) if rest else None)[list(group)].sum())

    def only(self, stay: Sequence[int]) -> Equations:
        """With those free parameters alone that have these places."""
        stay = list(stay)
        return replace(
            self,
            free_parameters=tuple(self.free_parameters[i] for i in stay),
            scaled_offsets=self.scaled_offsets[stay],
            normal=self.normal[:, stay][:, :, stay],
            right=self.right[:, stay],
        )

    def independent_share(self, free_parameters: Sequence[FreeParameter]) -> float:
        """Share of what some of the free parameters do that is left when all others are fitted to it, in the norm of
        the residuals."""
        names = {parameter.name for parameter in free_parameters}
        rest = [i for i, parameter in enumerate(self.free_parameters) if parameter.name not in names]
        whole = self.normal.sum(axis=0)
        others = whole[np.ix_(rest, rest)]
        total, left = 0.0, 0.0
        for i in (i for i, parameter in enumerate(self.free_parameters) if parameter.name in names):
            along = whole[rest, i]
            change = least(others, along, np.zeros(len(rest)), self.weight)
            total += whole[i, i]
            left += whole[i, i] + 2 * along @ change + change @ others @ change
        return float(np.sqrt(max(left, 0.0) / total)) if total > 0 else 0.0


def least(normal: Array, right: Array, prior: Array, weight: float) -> Array:
    """The change (k,) of the free parameters, in deviations, that is least in squared residuals and `weight` times the
    squared distance of the free parameters from zero: from the products `normal` (k, k) of the slopes, `right` (k,) of
    the slopes and the residuals, and `prior` (k,), where the free parameters are."""
    return np.asarray(np.linalg.solve(normal + weight * np.eye(len(prior)), -right - weight * prior), dtype=float)
