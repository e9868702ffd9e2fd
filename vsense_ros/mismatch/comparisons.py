"""Residuals of the base fit beside those of other fits, over the same time, on fitted and on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import Fit
from vsense_ros.mismatch.cross_validation import is_long_enough_for_pieces, passed, passed_once
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.road_prediction import RoadPrediction, predict_road
from vsense_ros.mismatch.simulation import LOST

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """Residuals of the base fit and of another one by window, over the same time."""

    residuals: Residuals
    fit: Fit
    before: list[Array]
    after: list[Array]


class Comparisons:
    """Residuals of the base fit and of others until the car of one of them gets lost, each simulated once."""

    def __init__(self, fitted: Residuals, unseen: Residuals | None, base: Fit, least: float) -> None:
        """`unseen` are the residuals on held-out recordings, if there are any. A comparison until the car gets lost
        needs at least the share `least` of all rows."""
        self.fitted, self.residuals, self.base, self._least = fitted, unseen, base, least
        self._comparisons: list[Comparison] = []
        self._predictions: list[tuple[Fit, RoadPrediction]] = []

    @cached_property
    def before(self) -> list[Array]:
        """Residuals of the base fit on held-out recordings, by window."""
        assert self.residuals is not None
        return self.residuals(self.base.parameter_set)

    def prepare(self, hypotheses: Sequence[Hypothesis]) -> None:
        """Compare explanations on held-out recordings, several side by side: what is then asked of them is known."""
        if self.residuals is None:
            return
        known = {id(one.fit) for one in self._comparisons if one.residuals is self.residuals}
        fits = [e.fit for e in hypotheses if id(e.fit) not in known and self._prediction(e.fit) is None]
        for begin in range(0, len(fits), self.residuals.at_once):
            together = fits[begin : begin + self.residuals.at_once]
            self.residuals.prepare([fitted.parameter_set for fitted in together])
            for fitted in together:
                self.held_out(fitted)

    def held_out(self, fitted: Fit) -> tuple[list[Array], list[Array]]:
        """Residuals of the base fit and of another one on held-out recordings, simulated once: in each window until the
        car gets lost. If that leaves little, or nothing can be said of the fit, until the end, with those of the base
        fit from there on. A road that no fit has seen is compared as its other pieces predict it."""
        assert self.residuals is not None
        if (there := self._prediction(fitted)) is not None:
            return self.before, there.predicted(self.before)
        return self._until_lost(self.residuals, self.before, fitted)

    def training(self, fitted: Fit) -> tuple[list[Array], list[Array]]:
        """Residuals before and after on the recordings that were fitted."""
        return self._until_lost(self.fitted, self.base.residuals, fitted)

    def simulated(self, fitted: Fit) -> list[dict[str, Array]]:
        """Signals of each held-out window, as they are compared."""
        assert self.residuals is not None
        there = self._prediction(fitted)
        return there.simulated() if there is not None else self.residuals.predictor.simulated(fitted.parameter_set)

    def by_pieces(self, fitted: Fit) -> bool:
        """True if a fit has estimated a road, and the held-out road is another, which is predicted by its own
        pieces."""
        return self._prediction(fitted) is not None

    def can_prove(self, hypothesis: Hypothesis) -> bool:
        """True if what a hypothesis has of a road, if anything, says something of the road of what was held out."""
        if not any(candidate.along_road for candidate in hypothesis.candidates):
            return True
        if self.residuals is None:
            return not passed_once(self.fitted.predictor.dataset.windows)
        return not self.on_another_road or self.by_pieces(hypothesis.fit)

    def _prediction(self, fitted: Fit) -> RoadPrediction | None:
        if (
            self.residuals is None
            or not self.on_another_road
            or not any(parameter.place for parameter in fitted.free_parameters)
            or not is_long_enough_for_pieces(self.residuals.predictor.dataset)
        ):
            return None
        known = next((there for of, there in self._predictions if of is fitted), None)
        if known is None:
            known = predict_road(self.residuals, self.before, fitted)
            self._predictions.append((fitted, known))
        return known

    def _until_lost(self, residuals: Residuals, whole: list[Array], fitted: Fit) -> tuple[list[Array], list[Array]]:
        """Residuals of the base fit and of another one until the car gets lost; `whole` are those of the base fit until
        the end."""
        known = next((one for one in self._comparisons if one.residuals is residuals and one.fit is fitted), None)
        if known is None:
            known = self._compared(residuals, whole, fitted)
            self._comparisons.append(known)
        return known.before, known.after

    def _compared(self, residuals: Residuals, whole: list[Array], fitted: Fit) -> Comparison:
        until = residuals.predictor.lost_from(fitted.parameter_set)
        before = whole if np.isinf(until).all() else residuals.compared(self.base.parameter_set, until)
        after = residuals.compared(fitted.parameter_set, until)
        if sum(map(len, before)) < self._least * sum(map(len, whole)):
            before, after = whole, residuals(fitted.parameter_set, whole)
        return Comparison(residuals, fitted, before, after)

    def lost(self, fitted: Fit) -> list[str]:
        """Remarks on windows in which the car of a fit gets lost: they say nothing of it from there on."""
        return [
            f"{w.name}: from {lost:.0f} to {w.end:.0f} s what was found is not judged: {LOST}"
            for predictor in (r.predictor for r in (self.fitted, self.residuals) if r is not None)
            for w, lost in zip(predictor.dataset.windows, predictor.lost_from(fitted.parameter_set), strict=True)
            if np.isfinite(lost)
        ]

    @cached_property
    def on_another_road(self) -> bool:
        """True if most of the held-out road is not that of what was fitted."""
        if self.residuals is None:
            return False
        both = (self.fitted.predictor.dataset.windows, self.residuals.predictor.dataset.windows)
        fitted, unseen = (set[float]().union(*map(passed, windows)) for windows in both)
        return 2 * len(fitted & unseen) < len(unseen)
