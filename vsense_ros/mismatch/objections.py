"""What speaks against an explanation."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.confidence import interval
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.thresholds import Thresholds
from vsense_ros.mismatch.validation import Validation
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import RoadEffect

NO_MORE_THAN_CHANCE = "it explains no more than chance"
LITTLE_LASTS = "little of what it explains lasts where it was not fitted"
MIGHT_BE_ZERO = "its size might as well be zero"
OUTDONE = "a term without known physics explains clearly more"
ANOTHER_ROAD = (
    "what was held out is of another road, and too short or too level to say anything of this one; "
    "it may join what is fitted"
)
LEAVES_TOO_MUCH = "it leaves too much over to be what lacks"
DISAGREED = "signals and recordings disagree in its size"


class Objections:
    """What speaks against explanations, found once for each."""

    def __init__(
        self,
        validation: Validation,
        best: Mapping[frozenset[str], Hypothesis],
        with_profile: Callable[[Hypothesis], Hypothesis | None],
        least_gain: float,
        thresholds: Thresholds,
    ) -> None:
        """`best` are explanations by the ids of their effects; the other arguments are those of `verdict.judge`."""
        self.validation, self.best, self.with_profile = validation, best, with_profile
        self.least_gain, self.thresholds = least_gain, thresholds
        self._by_hypothesis: dict[Hypothesis, str] = {}
        self._of_part: dict[Hypothesis, str] = {}

    def holds(self, e: Hypothesis) -> bool:
        return not self.to(e)

    def to(self, e: Hypothesis) -> str:
        """What speaks against an explanation, in words; empty where nothing does."""
        if e not in self._by_hypothesis:
            self._by_hypothesis[e] = self._of_gain(e) or self._of_size(e)
        return self._by_hypothesis[e]

    def to_part(self, e: Hypothesis) -> str:
        """Objection to an explanation that need not be complete: its residual may be something else, but not in the
        signals that each of its effects changes most."""
        if e not in self._of_part:
            self._of_part[e] = (
                self._of_gain(e) or (MIGHT_BE_ZERO if negligible(e, self.thresholds) else "") or self._unmended(e)
            )
        return self._of_part[e]

    def _unmended(self, e: Hypothesis) -> str:
        for effect in e.effects:
            known = self.best.get(frozenset(e.effects) - {effect}) if len(e.effects) > 1 else None
            if signal := self.validation.own_unmended(e, known):
                return f"it leaves the {signal.replace('_', ' ')} about as far off as it was"
        return ""

    def agreed(self, e: Hypothesis) -> bool:
        """True if signals and recordings agree in each of its effects."""
        most = self.thresholds.disagreement
        if len(e.effects) == 1:
            return self.validation.disagreement(e) < most
        known = (self.best.get(frozenset(e.effects) - {effect}) for effect in e.effects)
        return all(self.validation.disagreement(e, one) < most for one in known if one is not None)

    def mends_unseen(self, e: Hypothesis) -> bool:
        """True if held-out recordings as a whole, if there are any, are better with an explanation."""
        unseen = self.validation.gain(e)
        return unseen is None or unseen > 0

    def _of_gain(self, e: Hypothesis) -> str:
        """Objection that it explains too little, or too little where it was not fitted; empty for none."""
        limits, proven = self.thresholds, self.validation.proven(e)
        asked = float(np.clip(limits.small_independent_share / max(e.independent_share, 1e-3), 1.0, limits.most_asked))
        least = self.least_gain * asked
        along_road = any(candidate.along_road for candidate in e.candidates)
        if (
            along_road
            and self.validation.comparisons.on_another_road
            and proven <= max(least, limits.lasting_share * e.gain) < e.score
        ):
            return ANOTHER_ROAD
        if proven <= least:
            return NO_MORE_THAN_CHANCE
        # Of many sizes some may suit what was held out by chance, unless they were fitted to its other pieces.
        chance = along_road and not self.validation.comparisons.by_pieces(e.fit)
        lasts = min(proven, e.cv_gain) if chance else proven
        if lasts <= limits.lasting_share * e.gain or not self.mends_unseen(e):
            return LITTLE_LASTS
        if e.spoilt >= limits.spoilt_share:
            return "it spoils in some drives a good part of what it mends in others"
        return ""

    def _of_size(self, e: Hypothesis) -> str:
        """Objection that its size may be zero, or that its residual is too large; empty for none."""
        if any(not issubclass(EVERY[c.effect], RoadEffect) for c in negligible(e, self.thresholds)):
            return MIGHT_BE_ZERO
        # That the road is not level or even, one size shows; what it is where may be another at every place.
        if negligible(e, self.thresholds) or self.validation.unmended(e):
            e = self.with_profile(e) or e
        if self.validation.fitted.level(e.fit.residuals) >= self.thresholds.unexplained:
            return LEAVES_TOO_MUCH
        if negligible(e, self.thresholds):
            return MIGHT_BE_ZERO
        if signal := self.validation.unmended(e):
            return f"it leaves the {signal.replace('_', ' ')} about as far off as it was"
        return ""


def negligible(e: Hypothesis, thresholds: Thresholds) -> list[Candidate]:
    """The effects of an explanation that have next to no size, or one that might as well be zero."""
    sizes, deviations = e.sizes, e.deviations

    def matters(parameter: FreeParameter) -> bool:
        """True if a size is worth reporting, and zero is outside of the reported interval."""
        size = sizes[parameter.name]
        low, high = interval(size, deviations[parameter.name], thresholds=thresholds)
        return abs(size) >= thresholds.negligible_size * parameter.likely and not low <= 0.0 <= high

    return [c for c in e.candidates if c.free_parameters and not any(map(matters, c.free_parameters))]
