"""Which candidates promise to explain what a base fit leaves unexplained, by the linear model.

What a candidate does to the residuals is its signature; what counts is the part of it that the free parameters of the
fit cannot imitate (a projection by their normal equations, window by window, so that folds of a cross-validation need
no further simulation).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from vsense_ros.identification.least_squares import Fit
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.cross_validation import CrossValidation, as_it_is
from vsense_ros.mismatch.hypothesis import Signature
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import Secants
from vsense_ros.model.effects.unmodelled import axle_of_torque


class Screening:
    """Signatures of the candidates that are `offered`, beside a base fit. `whole` is what gains are relative to;
    `varying` has the names of candidates whose profile along the road was worth its many parameters alone; no profile
    is simulated before `roads_may_vary`."""

    def __init__(
        self, secants: Secants, validation: CrossValidation, whole: float, offered: Sequence[Candidate]
    ) -> None:
        self.secants, self.validation, self.whole, self.offered = secants, validation, whole, offered
        self.base = secants.base
        self.varying: set[str] = set()
        self.roads_may_vary = False

    def signature(self, at: Fit, present: tuple[Candidate, ...], new: tuple[Candidate, ...]) -> Signature:
        """What new candidates would do to the residuals of a fit with those present."""
        free_parameters = tuple(parameter for candidate in new for parameter in candidate.free_parameters)

        def joint() -> Fit:
            return self.secants.joined(at, free_parameters)

        equations = self.secants.joined_equations(at, free_parameters)
        free, change = equations.within_bounds([parameter.name for parameter in free_parameters])
        falls = self.base.equations.values() - free.values(change)
        folds = self.validation.folds_for((*present, *new))
        known = free if folds.apart is as_it_is else folds.apart(joint()).equations
        return Signature(
            (*present, *new), joint, equations.independent_share(free_parameters), float(falls.sum()) / self.whole,
            folds.gains(known, self.whole)[0], float(falls.sum() - falls.max()) / self.whole,
        )  # fmt: skip

    def screened(self, at: Fit, present: tuple[Candidate, ...], count: int) -> list[Signature]:
        """The likeliest candidates besides those present: `count` by their gain, as many by their score, and as many by
        their gain elsewhere than in the window where they promise most; and profiles of the road that promise more than
        one size for all places, where `roads_may_vary`."""
        self.simulate_new()
        signatures = [self.signature(at, present, (c,)) for c in self.besides(present)]
        signatures = [s for s in signatures if s.independent_share > 0]
        single = [s for s in signatures if not s.candidates[-1].along_road]
        by_gain = sorted(single, key=lambda s: s.gain, reverse=True)[:count]
        by_score = sorted(single, key=lambda s: s.score, reverse=True)[:count]
        elsewhere = sorted((s for s in single if s.elsewhere > 0), key=lambda s: s.elsewhere, reverse=True)[:count]
        chosen = [*by_score, *by_gain, *elsewhere, *self._profiles(signatures, single, present)]
        return list({s.candidates[-1].name: s for s in chosen}.values())

    def _profiles(
        self, signatures: Sequence[Signature], single: Sequence[Signature], present: Sequence[Candidate]
    ) -> list[Signature]:
        """The profiles among the signatures that promise clearly more than one size for all places, each after that
        size."""
        chosen: list[Signature] = []
        best = max((s.score for s in single), default=0.0)
        for free in (
            s for s in signatures if s.candidates[-1].along_road and self._may_vary(s.candidates[-1], present)
        ):
            one = next((s for s in single if first_size(s.candidates[-1]) == first_size(free.candidates[-1])), None)
            known = max(one.score if one is not None else 0.0, self.of_several_cars)
            if free.score > max(known + EFFORT.least_profile_gain, EFFORT.promising_share * best):
                chosen += [s for s in (one, free) if s is not None]
        return chosen

    def simulate_new(self) -> None:
        """Simulate the secants of the candidates that may be fitted, as far as they are not known."""
        self.secants.simulate_new(self.besides(()))

    def besides(self, present: Sequence[Candidate]) -> list[Candidate]:
        """The candidates of effects that are not present; profiles only where `roads_may_vary`."""
        names = {candidate.effect for candidate in present}
        return [c for c in self.offered if c.effect not in names and (self.roads_may_vary or not c.along_road)]

    def _may_vary(self, profile: Candidate, present: Sequence[Candidate]) -> bool:
        """True if a profile may be fitted with the candidates present: it would mend the residuals of any other effect,
        as none is quite right, unless it was worth its many parameters alone."""
        if any(candidate.along_road for candidate in present) or not self.validation.profiles_can_be_validated:
            return False
        return not present or profile.name in self.varying

    @cached_property
    def of_several_cars(self) -> float:
        """What base parameters of its own for each recording would gain, by the linear model, where a road of its own
        for each could stand in for them: nothing of a single recording, or of several on one road."""
        if not self.validation.is_validated_by_pieces_alone:
            return 0.0
        equations = self.base.equations
        groups = self.secants.residuals.predictor.dataset.places_by_recording()
        left = sum(float(equations.values(equations.change(group))[group].sum()) for group in groups)
        return (self.base.value - left) / self.whole

    def possible(self, term: Candidate) -> bool:
        """True if a term is one that this car may have: a torque from one wheel of an axle to the other needs an axle
        that is driven, or brakes."""
        across = {parameter.name: axle_of_torque(parameter.name) for parameter in term.free_parameters}
        return all(axle is None or axle in self._driven for axle in across.values())

    @cached_property
    def _driven(self) -> frozenset[str]:
        """The axles that are driven, as far as that is known: by measured torques, or by the share of the front wheels
        that was fitted."""
        return self.secants.residuals.predictor.drives.driven_axles(self.base.parameter_set)


def first_size(candidate: Candidate) -> tuple[str, str]:
    """Name and form of the first size of a candidate."""
    return candidate.free_parameters[0].name, candidate.free_parameters[0].form
