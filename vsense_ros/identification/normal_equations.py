"""The normal equations of a fit: what small changes of its free parameters would do.

Each block of residuals (a window, a recording) has its own share of them, so that any of the data can be taken out
without simulating anything again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NormalEquations:
    """The normal equations of a fit with a Gaussian prior, by block of residuals.

    Slopes are by the free parameters in units of their deviations, and so are changes.
    """

    free_parameters: tuple[FreeParameter, ...]
    scaled_offsets: Array  # (k,) [deviations]
    weight: float  # what a free parameter that is one deviation off costs
    normal: Array  # (blocks, k, k) products of the slopes
    right: Array  # (blocks, k) products of slopes and residuals
    costs: Array  # (blocks,) sums of squared residuals
    rows: NDArray[np.int64]  # (blocks,) numbers of residuals

    def change(self, blocks: Sequence[int] | None = None) -> Array:
        """(k,) change of the free parameters [deviations] to the least value of all blocks, or of some."""
        chosen = slice(None) if blocks is None else list(blocks)
        normal, right = self.normal[chosen].sum(axis=0), self.right[chosen].sum(axis=0)
        return minimiser(normal, right, self.scaled_offsets, self.weight)

    @property
    def gradient(self) -> Array:
        """(k,) half the derivative of what is minimised, the prior included, by the free parameters [deviations]."""
        return np.asarray(self.right.sum(axis=0) + self.weight * self.scaled_offsets)

    def values(self, change: Array | None = None) -> Array:
        """(blocks,) what is minimised, after a change of the free parameters [deviations]. Each block bears that share
        of the prior's cost which it has of all residuals."""
        costs, offsets = self.costs, self.scaled_offsets
        if change is not None:
            costs = costs + 2 * self.right @ change + (self.normal @ change) @ change
            offsets = offsets + change
        return np.asarray(costs + self.weight * float(offsets @ offsets) * self.rows / self.rows.sum())

    def spread(self) -> Array:
        """(k,) standard deviations of the free parameters after the fit, in units of those before it."""
        normal = self.normal.sum(axis=0)
        inverse = np.linalg.inv(normal + self.weight * np.eye(len(normal)))
        return np.asarray(np.sqrt(self.weight * np.diag(inverse)))

    def out_of_sample(self, group: Sequence[int]) -> float:
        """The value of a group of blocks after a fit to all others; where there are no others, as they are."""
        others = [i for i in range(len(self.rows)) if i not in group]
        return float(self.values(self.change(others) if others else None)[list(group)].sum())

    def only(self, stay: Sequence[int]) -> NormalEquations:
        """With those free parameters alone that have these indices; all others are held."""
        stay = list(stay)
        return replace(
            self,
            free_parameters=tuple(self.free_parameters[i] for i in stay),
            scaled_offsets=self.scaled_offsets[stay],
            normal=self.normal[:, stay][:, :, stay],
            right=self.right[:, stay],
        )

    def within_bounds(self, names: Sequence[str]) -> tuple[NormalEquations, Array]:
        """The equations without those of these free parameters that are at a bound and would go beyond it, and the
        change of all others [deviations]."""
        equations = self
        while True:
            change = equations.change()
            leaving = {
                p.name
                for p, offset, step in zip(equations.free_parameters, equations.scaled_offsets, change, strict=True)
                if p.name in names
                and ((offset <= p.low / p.deviation and step < 0) or (offset >= p.high / p.deviation and step > 0))
            }  # fmt: skip
            if not leaving:
                return equations, change
            equations = equations.only([i for i, p in enumerate(equations.free_parameters) if p.name not in leaving])

    def independent_share(self, free_parameters: Sequence[FreeParameter]) -> float:
        """Share of what some of the free parameters do to the residuals that is left when all others are fitted to it,
        in the norm of the residuals: how far their slopes are from those of the others."""
        names = {parameter.name for parameter in free_parameters}
        other_places = [i for i, parameter in enumerate(self.free_parameters) if parameter.name not in names]
        normal = self.normal.sum(axis=0)
        normal_of_others = normal[np.ix_(other_places, other_places)]
        total, independent = 0.0, 0.0
        for i in (i for i, parameter in enumerate(self.free_parameters) if parameter.name in names):
            along = normal[other_places, i]
            change = minimiser(normal_of_others, along, np.zeros(len(other_places)), self.weight)
            total += normal[i, i]
            independent += normal[i, i] + 2 * along @ change + change @ normal_of_others @ change
        return float(np.sqrt(max(independent, 0.0) / total)) if total > 0 else 0.0


def minimiser(normal: Array, right: Array, scaled_offsets: Array, weight: float) -> Array:
    """The change (k,) of the free parameters [deviations] at which the squared residuals and `weight` times the squared
    offsets are least together: from the products `normal` (k, k) of the slopes, `right` (k,) of slopes and residuals,
    and the present offsets (k,) [deviations]."""
    unit = np.eye(len(scaled_offsets))
    return np.asarray(np.linalg.solve(normal + weight * unit, -right - weight * scaled_offsets), dtype=float)
