"""A road that no fit has seen: found with the car of a fit, each second piece of it as it follows from the others.

Nothing that was fitted elsewhere knows this road. What proves that it is one is that its pieces tell of their
neighbours, with a car that has learnt nothing there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.cross_validation import in_pieces, odd
from vsense_ros.mismatch.fit import Fit, Residuals, fit, slope, strength, turned
from vsense_ros.mismatch.knobs import at_places
from vsense_ros.mismatch.search import SECANT, at_place
from vsense_ros.mismatch.simulation import Setting
from vsense_ros.mismatch.windows import Window

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Survey:
    """A car on recordings that no fit has seen, with their road as the even pieces tell it, and as the odd do."""

    residuals: Residuals
    by_even: Setting
    by_odd: Setting

    def foretold(self, instead: Sequence[Array]) -> list[Array]:
        """Residuals by window, of each piece with the road that follows from its neighbours; `instead` are those where
        the car is lost."""
        found = []
        both = (self.residuals(setting, instead) for setting in (self.by_even, self.by_odd))
        for on_odd, on_even, names, window in zip(*both, self.residuals.layout, self._windows, strict=True):
            found.append(np.where(np.tile(odd(window), len(names)), on_odd, on_even))
        return found

    def simulated(self) -> list[dict[str, Array]]:
        """Signals by window, of each piece as in `foretold`; none where the car left all bounds."""
        predictor = self.residuals.predictor
        both = (predictor.simulated(setting) for setting in (self.by_even, self.by_odd))
        return [
            {name: np.where(odd(window), on_odd[name], on_even[name]) for name in on_odd if name in on_even}
            for on_odd, on_even, window in zip(*both, self._windows, strict=True)
        ]

    @property
    def _windows(self) -> Sequence[Window]:
        return self.residuals.predictor.evidence.windows


def survey(residuals: Residuals, before: Sequence[Array], found: Fit) -> Survey:
    """The road under recordings that no fit has seen, for the car of a fit that has found another; `before` are their
    residuals without one, which stay where that car gets lost."""
    known = {knob.place for knob in found.knobs if knob.place is not None}
    sizes = [knob for knob in found.knobs if knob.name in {size for size, _ in known}]
    columns, knobs = [], []
    unknown = Fit(
        found.setting, (), np.zeros(0), residuals(found.setting, before), [np.zeros((len(r), 0)) for r in before],
        strength(before),
    )  # fmt: skip
    for size in sizes:
        everywhere = slope(residuals, found.setting, unknown, size, SECANT)
        for knob in at_places(size, [at for at in residuals.predictor.evidence.points if (size.name, at) not in known]):
            assert knob.place is not None
            share = at_place(residuals, everywhere, knob.place[1])
            columns.append([part * (knob.deviation / size.deviation) for part in share])
            knobs.append(knob)
    slopes = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
    begin = Fit(found.setting, tuple(knobs), np.zeros(len(knobs)), unknown.residuals, slopes, unknown.weight)
    whole = fit(residuals, found.setting, knobs, first=begin, instead=before)
    equations, windows = in_pieces(residuals)(whole).equations, len(before)
    deviations = np.array([knob.deviation for knob in knobs])

    def told_by(parts: range) -> Setting:
        return turned(found.setting, knobs, whole.amounts + deviations * equations.change(parts))

    return Survey(residuals, by_even=told_by(range(windows, 2 * windows)), by_odd=told_by(range(windows)))
