"""Secants: how the residuals of a fit change with a parameter, by simulations with and without a likely size of it.

Those of candidates are simulated once, at the base fit, and used for all hypotheses: what a candidate does near the
base fit is what it does near another fit, to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter, joined
from vsense_ros.identification.least_squares import SEARCH, Fit, Slopes, slopes_by
from vsense_ros.identification.normal_equations import NormalEquations
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.cross_validation import places
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.model.effects.base import SPACING


class Secants:
    """Secants of the residuals by free parameters, by window."""

    def __init__(
        self, residuals: Residuals, start: ParameterSet, base: Fit, progress: Callable[[], None] = lambda: None
    ) -> None:
        self.residuals, self.start, self.base, self._progress = residuals, start, base, progress
        self._columns: dict[tuple[str, str], list[Slopes]] = {  # by name and form
            (parameter.name, parameter.form): [part[:, i] / parameter.deviation for part in base.slopes]
            for i, parameter in enumerate(base.free_parameters)
        }

    def slopes_at(self, fitted: Fit, free_parameters: Sequence[FreeParameter]) -> list[Slopes]:
        """Slopes (rows, k) by k parameters near another fit, per deviation, by window; simulated anew."""
        columns = slopes_by(self.residuals, self.start, fitted, free_parameters)
        return [np.column_stack(parts) for parts in zip(*columns, strict=True)]

    def simulate_new(self, candidates: Iterable[Candidate]) -> None:
        """Simulate the secants of candidates for which there are none yet, those of places far apart together."""
        candidates = list(candidates)
        free_parameters = (parameter for candidate in candidates for parameter in candidate.free_parameters)
        new = [parameter for parameter in free_parameters if (parameter.name, parameter.form) not in self._columns]
        self.simulate(parameter for parameter in new if parameter.place is None)
        for candidate in candidates:
            if candidate.along_road and candidate.places[0] in new:
                self._simulate_places(candidate.places)

    def simulate(self, free_parameters: Iterable[FreeParameter]) -> None:
        """Simulate secants by these parameters at the base fit."""
        every = {(parameter.name, parameter.form): parameter for parameter in free_parameters}
        secants = slopes_by(self.residuals, self.start, self.base, list(every.values()), EFFORT.secant)
        for (key, parameter), secant in zip(every.items(), secants, strict=True):
            self._columns[key] = [part / parameter.deviation for part in secant]
            self._progress()

    def _simulate_places(self, points: Sequence[FreeParameter]) -> None:
        """Simulate secants by a size at each of these places at the base fit."""
        secants = slopes_of_places(self.residuals, self.start, self.base, points, EFFORT.secant, self._progress)
        for point, slopes in zip(points, secants, strict=True):
            self._columns[point.name, point.form] = [
                part / point.deviation if part.strides[0] else part for part in slopes
            ]

    def all_slopes_at(self, at: Fit) -> list[Slopes]:
        """Slopes (rows, k) by all k free parameters of a fit, near this fit, per deviation, by window."""
        known = [parameter for parameter in at.free_parameters if parameter.place is None]
        points = [parameter for parameter in at.free_parameters if parameter.place is not None]
        columns = {}
        for parameter, column in zip(known, slopes_by(self.residuals, self.start, at, known), strict=True):
            columns[parameter.name] = column
            self._progress()
        at_places = slopes_of_places(self.residuals, self.start, at, points, SEARCH.secant, self._progress)
        columns |= {point.name: column for point, column in zip(points, at_places, strict=True)}
        in_order = (columns[parameter.name] for parameter in at.free_parameters)
        return [np.column_stack(parts) for parts in zip(*in_order, strict=True)]

    def column(self, parameter: FreeParameter) -> list[Slopes]:
        """The secant (rows,) by a free parameter at the base fit, per unit of it, by window."""
        return self._columns[parameter.name, parameter.form]

    def joined_equations(self, at: Fit, free_parameters: Sequence[FreeParameter]) -> NormalEquations:
        """The equations of `Fit.joined`, of which those of the fit are known."""
        known, names = at.equations, {parameter.name for parameter in free_parameters}
        stay = [i for i, parameter in enumerate(at.free_parameters) if parameter.name not in names]
        present = at.offset_by_name
        across, own, right = [], [], []
        for slopes, residuals, new in zip(at.slopes, at.residuals, self._by_window(free_parameters), strict=True):
            double = new.astype(np.float64)
            across.append((slopes.T @ double)[stay])
            own.append(double.T @ double)
            right.append(double.T @ residuals)
        rest = known.only(stay)
        return replace(
            rest,
            free_parameters=(*rest.free_parameters, *free_parameters),
            scaled_offsets=np.append(
                rest.scaled_offsets,
                [present.get(parameter.name, 0.0) / parameter.deviation for parameter in free_parameters],
            ),
            normal=np.block([[rest.normal, np.array(across)], [np.array(across).transpose(0, 2, 1), np.array(own)]]),
            right=np.hstack([rest.right, right]),
        )

    def joined(self, at: Fit, free_parameters: Sequence[FreeParameter]) -> Fit:
        """A fit with further free parameters, at zero, whose slopes are the secants of the base fit."""
        return at.joined(free_parameters, self._by_window(free_parameters))

    def _by_window(self, free_parameters: Sequence[FreeParameter]) -> Iterator[Slopes]:
        """Secants (rows, k) of the base fit by k parameters, per deviation, of one window after the other: those of all
        places of a long road by all of its windows would take gigabytes."""
        deviations = np.array([parameter.deviation for parameter in free_parameters], np.float32)
        for parts in zip(*map(self.column, free_parameters), strict=True):
            yield np.column_stack(parts) * deviations


def slopes_of_places(
    residuals: Residuals, start: ParameterSet, at: Fit, points: Sequence[FreeParameter], step: float,
    progress: Callable[[], None] = lambda: None,
) -> list[list[Slopes]]:  # fmt: skip
    """Slopes by a size at each of these places, per deviation, by window: of those that are far from one another at
    once, as a car has soon forgotten where it has been. What happens around a place is what the size there does."""
    if not points:
        return []
    groups = [points[first :: EFFORT.places_apart] for first in range(min(EFFORT.places_apart, len(points)))]
    windows = residuals.predictor.dataset.windows
    passed = [np.tile(places(window), len(names)) for window, names in zip(windows, residuals.layout, strict=True)]
    slopes: dict[str, list[Slopes]] = {}
    secants = slopes_by(residuals, start, at, [joined(group) for group in groups], step)
    for group, secant in zip(groups, secants, strict=True):
        for point in group:
            assert point.place is not None
            near = [np.abs(way - point.place[1]) < EFFORT.places_apart / 2 * SPACING for way in passed]
            slopes[point.name] = [_where(here, part) for here, part in zip(near, secant, strict=True)]
        progress()
    return [slopes[point.name] for point in points]


def _where(here: NDArray[np.bool_], part: Slopes) -> Slopes:
    """The secant (n,) in one window, zero where the car is not `here`. Where it never is, one zero is stored for all:
    most places of a long road are passed in one window of many."""
    return np.where(here, part, np.float32(0)) if here.any() else np.broadcast_to(np.float32(0), part.shape)
