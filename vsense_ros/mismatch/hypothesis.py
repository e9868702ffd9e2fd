"""Signatures, candidates by what they promise, and hypotheses, candidates that were fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from vsense_ros.identification.least_squares import Fit
from vsense_ros.mismatch.candidates import Candidate


@dataclass(frozen=True)
class Signature:
    """What candidates would do to the residuals of a fit, and what of that its free parameters cannot imitate."""

    candidates: tuple[Candidate, ...]  # all of them, the last one is new
    # The fit with their free parameters added, at zero: made anew each time, as those of all candidates would take
    # gigabytes.
    joint: Callable[[], Fit]
    independent_share: float  # of the signature: what is left after all other free parameters were fitted to it
    gain: float  # relative fall of the base's value, by the linear model
    cv_gain: float  # the same in cross-validation
    # The gain without the window that promises most: where a car is at its limit, no fit keeps what slopes promise.
    elsewhere: float

    @property
    def score(self) -> float:
        return min(self.gain, self.cv_gain)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Candidates fitted together with the base parameters; equal to itself alone, so that it can be a key of
    results."""

    candidates: tuple[Candidate, ...]
    fit: Fit
    independent_share: float  # of the signature of the last one
    gain: float  # fall of the base's value, over that value
    cv_gain: float  # cross-validation gain: fall of the value of folds that were dropped from the fit, over the same
    cv_share: float  # that fall over what the base leaves of dropped folds
    spoilt: float  # what windows lose that fit worse than with the base, over what the others gain
    deviations: Mapping[str, float]  # standard deviations of the sizes by dotted name, in their units
    # Probabilities of its effects by id, if the evidence has proposed it, or more than it.
    evident: Mapping[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids."""
        return tuple(candidate.effect for candidate in self.candidates)

    @property
    def name(self) -> str:
        return " + ".join(candidate.name for candidate in self.candidates)

    @property
    def score(self) -> float:
        """The smaller gain."""
        return min(self.gain, self.cv_gain)

    @property
    def sizes(self) -> dict[str, float]:
        """Values by dotted name."""
        offsets = self.fit.offset_by_name
        return {
            parameter.name: offsets[parameter.name]
            for candidate in self.candidates
            for parameter in candidate.free_parameters
        }
