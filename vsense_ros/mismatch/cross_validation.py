"""Cross-validation of a fit: folds of the data are dropped from it in turn, and judged by a fit to all others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.normal_equations import NormalEquations
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.road import ROAD_SETTINGS
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.windows import Dataset, Window
from vsense_ros.model.effects.base import SPACING

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FoldSettings:
    """How recordings are divided for cross-validation: decisions of this project."""

    stretches: int = 4  # of a window that is the only one
    least_pieces: int = 10  # least number of places in each recording of a road that is validated by its pieces


FOLDS = FoldSettings()


@dataclass(frozen=True)
class Folds:
    """How the data of a fit are taken apart into blocks, which blocks are dropped together, and the value that the base
    fit has there."""

    apart: Callable[[Fit], Fit]
    groups: Sequence[Sequence[int]]
    own: Array  # (groups,) value of the base fit
    unseen: Array  # (groups,) the same of the base fitted to all other groups
    rows: NDArray[np.int64]  # (groups,) numbers of residuals

    @classmethod
    def of(cls, base: Fit, apart: Callable[[Fit], Fit], groups: Sequence[Sequence[int]]) -> Folds:
        equations = apart(base).equations
        own, rows = (
            np.array([of[list(group)].sum() for group in groups]) for of in (equations.values(), equations.rows)
        )
        return cls(apart, groups, own, np.array([equations.out_of_sample(group) for group in groups]), rows)

    def gains(self, fitted: NormalEquations, whole: float) -> tuple[float, float]:
        """The cross-validation gain of a fit: how much less than the base it leaves of groups that were dropped, over a
        `whole`, and over what the base leaves of them. The linear model may be far off where one group alone determines
        of a parameter: over the whole, no group counts for more than its own value."""
        falls = self.unseen - [fitted.out_of_sample(group) for group in self.groups]
        most = np.maximum(self.unseen, self.own)
        share = np.sum(np.clip(falls, -most, most)) / np.sum(np.maximum(most, self.rows))
        return float(np.sum(np.clip(falls, -self.own, self.own))) / whole, float(share)


def as_it_is(fitted: Fit) -> Fit:
    """A fit with its windows as blocks."""
    return fitted


def by_windows(residuals: Residuals, base: Fit) -> Folds:
    """Folds are recordings, or windows where there is one recording."""
    groups = residuals.predictor.dataset.places_by_recording()
    return Folds.of(base, as_it_is, groups if len(groups) > 1 else [[i] for i in range(len(base.residuals))])


def by_stretches(residuals: Residuals, base: Fit) -> Folds:
    """Folds are stretches of the only window."""
    (names,) = residuals.layout

    def cut(rows: NDArray[Any]) -> list[NDArray[Any]]:
        instants = np.arange(len(rows)).reshape(len(names), -1)
        return [rows[part.reshape(-1)] for part in np.array_split(instants, FOLDS.stretches, axis=1)]

    def apart(fitted: Fit) -> Fit:
        (rest,), (slopes,) = fitted.residuals, fitted.slopes
        return replace(fitted, residuals=cut(rest), slopes=cut(slopes))

    return Folds.of(base, apart, [[i] for i in range(FOLDS.stretches)])


def by_pieces(residuals: Residuals, base: Fit) -> Folds:
    """Folds are the odd and the even pieces of the road, in all windows: what is on a piece follows from its
    neighbours."""
    n = len(residuals.layout)
    return Folds.of(base, in_pieces(residuals), [range(n), range(n, 2 * n)])


def in_pieces(residuals: Residuals) -> Callable[[Fit], Fit]:
    """Takes a fit apart into what is on odd pieces of the road, a block for each window, and then what is on even
    ones."""
    windows = residuals.predictor.dataset.windows
    on_odd = [np.tile(odd(window), len(names)) for window, names in zip(windows, residuals.layout, strict=True)]
    halves = [*on_odd, *(~rows for rows in on_odd)]

    def apart(fitted: Fit) -> Fit:
        of_both = ([*parts, *parts] for parts in (fitted.residuals, fitted.slopes))
        residuals, slopes = (chosen(parts, halves) for parts in of_both)
        return replace(fitted, residuals=residuals, slopes=slopes)

    return apart


def chosen(parts: Sequence[NDArray[Any]], rows: Sequence[NDArray[np.bool_]]) -> list[NDArray[Any]]:
    """Rows of each block."""
    return [part[some] for part, some in zip(parts, rows, strict=True)]


def odd(window: Window) -> NDArray[np.bool_]:
    """True for each compared instant of a window that is on an odd piece of the road."""
    return np.asarray(places(window) // SPACING % 2 == 1)


def is_long_enough_for_pieces(dataset: Dataset) -> bool:
    """True if a road is long enough to be validated by its pieces: the residuals of one manoeuvre last for a few of
    them."""
    return len(dataset.points) >= FOLDS.least_pieces * len(dataset.by_recording())


def only_pieces_can_validate(dataset: Dataset) -> bool:
    """True if nothing but its pieces can validate the road: no place is met twice, in one recording or in several long
    ones. If there are several short ones, folds are recordings."""
    return passed_once(dataset.windows) and (len(dataset.by_recording()) == 1 or is_long_enough_for_pieces(dataset))


def passed_once(windows: Sequence[Window]) -> bool:
    """True if most of the road is passed once, so that no window predicts what another one meets on its way."""
    times = Counter(point for window in windows for point in passed(window))
    return 2 * sum(count == 1 for count in times.values()) > len(times)


def passed(window: Window) -> set[float]:
    """Where on the road a window has been [`road.POINT`]."""
    return set(places(window) // ROAD_SETTINGS.spacing)


def places(window: Window) -> Array:
    """Abscissa at each instant of a window that is compared [m]."""
    return np.asarray(np.interp(grid(window), window.place.t, window.place.value[:, 0]))


class CrossValidation:
    """The folds by which hypotheses about some recordings are cross-validated beside a base fit."""

    def __init__(self, residuals: Residuals, base: Fit) -> None:
        self.residuals, self.base = residuals, base

    @property
    def _dataset(self) -> Dataset:
        return self.residuals.predictor.dataset

    @cached_property
    def is_validated_by_pieces_alone(self) -> bool:
        """True if a road can be validated by nothing but how its pieces predict one another."""
        return only_pieces_can_validate(self._dataset)

    @cached_property
    def profiles_can_be_validated(self) -> bool:
        """True if the recordings can validate a profile."""
        return not self.is_validated_by_pieces_alone or is_long_enough_for_pieces(self._dataset)

    def folds_for(self, candidates: Sequence[Candidate]) -> Folds:
        """The folds by which a hypothesis of these candidates is cross-validated."""
        if self.is_validated_by_pieces_alone and any(candidate.along_road for candidate in candidates):
            return self.pieces
        return self.folds

    @cached_property
    def folds(self) -> Folds:
        """The folds where no candidate has a profile."""
        return (by_stretches if len(self.base.residuals) == 1 else by_windows)(self.residuals, self.base)

    @cached_property
    def pieces(self) -> Folds:
        """The folds where a candidate has a profile that pieces of the road alone can validate."""
        return by_pieces(self.residuals, self.base)
