"""A road that no fit has seen, predicted from every second piece of it.

No fit to other recordings knows this road. That it is a road is proven if each of its pieces follows from its
neighbours, with the car as it was fitted elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.identification.least_squares import Fit, Slopes, fit, prior_weight
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import at_places
from vsense_ros.mismatch.cross_validation import chosen, odd
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import slopes_of_places
from vsense_ros.mismatch.windows import Window

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RoadPrediction:
    """A car on recordings that no fit has seen, with their road fitted to its even pieces, and to its odd ones."""

    residuals: Residuals
    from_even: ParameterSet
    from_odd: ParameterSet

    def predicted(self, instead: Sequence[Array]) -> list[Array]:
        """Residuals by window, of each piece with the road fitted to its neighbours; those of `instead` where the car
        gets lost."""
        predictions = []
        both = (self.residuals(parameter_set, instead) for parameter_set in (self.from_even, self.from_odd))
        for on_odd, on_even, names, window in zip(*both, self.residuals.layout, self._windows, strict=True):
            predictions.append(np.where(np.tile(odd(window), len(names)), on_odd, on_even))
        return predictions

    def simulated(self) -> list[dict[str, Array]]:
        """Signals by window, of each piece as in `predicted`; none where the car left all bounds."""
        predictor = self.residuals.predictor
        both = (predictor.simulated(parameter_set) for parameter_set in (self.from_even, self.from_odd))
        return [
            {name: np.where(odd(window), on_odd[name], on_even[name]) for name in on_odd if name in on_even}
            for on_odd, on_even, window in zip(*both, self._windows, strict=True)
        ]

    @property
    def _windows(self) -> Sequence[Window]:
        return self.residuals.predictor.dataset.windows


def predict_road(residuals: Residuals, before: Sequence[Array], fitted: Fit) -> RoadPrediction:
    """The road of recordings that no fit has seen, for the car of a fit that has `found` another road. `before` are the
    residuals without a road, which stay where that car gets lost."""
    known = {parameter.place for parameter in fitted.free_parameters if parameter.place is not None}
    sizes = [parameter for parameter in fitted.free_parameters if parameter.name in {size for size, _ in known}]
    unknown = Fit(
        fitted.parameter_set, (), np.zeros(0), residuals(fitted.parameter_set, before),
        [np.zeros((len(r), 0), np.float32) for r in before],
        prior_weight(before),
    )  # fmt: skip
    free_parameters: list[FreeParameter] = []
    columns: list[list[Slopes]] = []
    for size in sizes:
        # A slope at one place bends the road beside it, which no share of the slope everywhere describes.
        points = [*at_places(size, [at for at in residuals.predictor.dataset.points if (size.name, at) not in known])]
        free_parameters += points
        columns += slopes_of_places(residuals, fitted.parameter_set, unknown, points, EFFORT.secant)
    slopes = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
    begin = Fit(
        fitted.parameter_set,
        tuple(free_parameters),
        np.zeros(len(free_parameters)),
        unknown.residuals,
        slopes,
        unknown.weight,
    )
    on_odd = [
        np.tile(odd(w), len(n)) for w, n in zip(residuals.predictor.dataset.windows, residuals.layout, strict=True)
    ]

    def fitted_to(rows: Sequence[NDArray[np.bool_]]) -> ParameterSet:
        on_pieces = _OnPieces(residuals, rows, before)
        first = replace(begin, residuals=chosen(begin.residuals, rows), slopes=chosen(begin.slopes, rows))
        known = chosen(before, rows)
        return fit(on_pieces, fitted.parameter_set, free_parameters, first=first, instead=known).parameter_set

    return RoadPrediction(residuals, from_even=fitted_to([~rows for rows in on_odd]), from_odd=fitted_to(on_odd))


@dataclass(frozen=True)
class _OnPieces:
    """Residuals on some pieces of the road alone: those rows (n,) of each window; `before` are all without a road."""

    residuals: Residuals
    rows: Sequence[NDArray[np.bool_]]
    before: Sequence[Array]

    @property
    def at_once(self) -> int:
        return self.residuals.at_once

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        self.residuals.prepare(parameter_sets, near)

    def diverged(self, parameter_set: ParameterSet) -> Sequence[bool]:
        return self.residuals.diverged(parameter_set)

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[Array] | None = None) -> list[Array]:
        if instead is None:
            return chosen(self.residuals(parameter_set), self.rows)
        everywhere = [all_rows.copy() for all_rows in self.before]
        for all_rows, rows, values in zip(everywhere, self.rows, instead, strict=True):
            all_rows[rows] = values
        return chosen(self.residuals(parameter_set, everywhere), self.rows)
