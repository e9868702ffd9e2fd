"""From a fit that leaves residuals to the effects that would explain them.

Candidates are first screened linearly (`screening`). Those that promise most are then fitted in full, together with all
other free parameters (`fitting`): that is a hypothesis. Further effects are added to the best hypotheses, as long as
that explains clearly more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.least_squares import DivergedError, Fit, fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate, terms
from vsense_ros.mismatch.cross_validation import CrossValidation
from vsense_ros.mismatch.evidence import Chosen, SetEvidence
from vsense_ros.mismatch.fitting import Fitting
from vsense_ros.mismatch.hypothesis import Hypothesis, Signature
from vsense_ros.mismatch.proposing import Proposing
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.screening import Screening, first_size
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import Secants
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.model.effects import EVERY

Array = NDArray[np.float64]
Promise = tuple[float, Signature]  # gain that a signature promises to prove

SENSOR = "sensor"  # the layer of effects that act on what is measured, not on the car and its road


class Search:
    """Looks for hypotheses that explain the residuals of a base fit."""

    def __init__(
        self,
        residuals: Residuals,
        start: ParameterSet,
        base: Fit,
        offered: Sequence[Candidate],
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.residuals, self.start, self.base, self.offered = residuals, start, base, offered
        # Gains are relative to the base, but to no less than a good model leaves: nothing can be gained below that.
        least_whole = float(sum(len(r) for r in base.residuals))
        self.whole = max(base.value, least_whole)
        self.least_whole = least_whole / self.whole
        self.secants = Secants(residuals, start, base, progress)
        self.validation = CrossValidation(residuals, base)
        self.screening = Screening(self.secants, self.validation, self.whole, offered)
        self.fitting = Fitting(self.secants, self.validation, self.whole, progress)
        self._profiled: dict[Hypothesis, Hypothesis | None] = {}
        self.evidence: tuple[SetEvidence, Chosen] | None = None  # with the likeliest set
        self.adds: dict[str, float] = {}  # what effects of proposed sets explain of what the others leave, by id
        self._progress = progress

    @cached_property
    def visible(self) -> frozenset[str]:
        """Ids of the effects that would change something that was recorded, at a likely size."""
        self.screening.simulate_new()

        def leaves_a_trace(parameter: FreeParameter) -> bool:
            largest = max(float(np.abs(part).max(initial=0.0)) for part in self.secants.column(parameter))
            return largest * parameter.likely > EFFORT.trace

        single = (c for c in self.offered if not c.along_road)
        return frozenset(c.effect for c in single if any(map(leaves_a_trace, c.free_parameters)))

    @cached_property
    def promised(self) -> float:
        """What the most promising candidate alone would gain by the linear model, in training and left out in turn. Of
        a base parameter far from what it usually is, that is what its effect would cost less."""
        return max((min(signature.gain, signature.score) for signature in self._screened), default=0.0)

    @cached_property
    def _screened(self) -> list[Signature]:
        """The likeliest candidates alone, with one size for all of the road."""
        return self.screening.screened(self.base, (), EFFORT.shortlist)

    def single(self) -> list[Hypothesis]:
        """The likeliest candidates alone, fitted in full, best first; profiles of the road among them only where the
        best other one leaves a signal further off than a good model does."""
        fitted = self._refined(self.fitting.fitted(self._screened))
        if any(c.along_road for c in self.offered) and self.leaves_something(fitted[0].fit if fitted else self.base):
            self.screening.roads_may_vary = True
            known = {e.candidates for e in fitted}
            new = [s for s in self.screening.screened(self.base, (), EFFORT.shortlist) if s.candidates not in known]
            fitted = _worth_their_freedom([*fitted, *self._refined(self.fitting.fitted(new))])
            self.screening.varying = {e.candidates[-1].name for e in fitted if e.candidates[-1].along_road}
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def proposed(self) -> list[Hypothesis]:
        """The set of effects that the evidence proposes, and what is instead of its parts; none if it finds nothing."""
        found = self._proposing.proposed()
        self._profiled |= self._proposing.level
        self.evidence = self._proposing.evidence
        return found

    @property
    def improbable(self) -> frozenset[str]:
        """Ids of the effects that the evidence excludes beside the set that it has found, if it has found one."""
        if self.evidence is None or not self.evidence[1]:
            return frozenset()
        sets, _ = self.evidence
        probabilities = sets.probabilities()
        every = {size.effect for size in sets.sizes}
        return frozenset(id for id in every if probabilities.get(id, 0.0) < THRESHOLDS.improbable)

    def reduced(
        self,
        provable: Sequence[Hypothesis],
        proven: Callable[[Hypothesis], float],
        prepare: Callable[[Sequence[Hypothesis]], None],
    ) -> list[Hypothesis]:
        """The best of the proposed sets that held-out recordings can prove without those effects of which the evidence
        is not sure, or which hardly matter there, and each of these sets without any one of its parts. What hardly
        matters is left out at once where the rest then proves as much, else one after the other. `proven` is what a
        hypothesis gains there, and `prepare` simulates several side by side."""
        found: list[Hypothesis] = []
        best = max(list(filter(is_trusted, provable)) or provable, key=proven, default=None)
        while best is not None and len(best.candidates) > 1:
            doubted = min(best.effects, key=best.evident.__getitem__)
            doubtful = best.evident[doubted] < THRESHOLDS.trusted
            without = self.without_each(best, only=doubted if doubtful else None)
            prepare(without)
            found += without
            for rest in without:
                (out,) = set(best.effects) - set(rest.effects)
                self.adds[out] = self._adds_beyond(rest, best, proven)
            least = doubted if doubtful else min(best.effects, key=self.adds.__getitem__)
            if not doubtful and self.adds[least] > THRESHOLDS.evident_gain:
                break
            strong = {id for id in best.effects if self.adds.get(id, 0.0) > THRESHOLDS.evident_gain}
            best = next(e for e in without if least not in e.effects)
            if not doubtful and 0 < len(strong) < len(best.effects):
                smaller = self._proposing.with_only(best, strong)
                prepare([smaller])
                found.append(smaller)
                if self._adds_beyond(smaller, best, proven) <= THRESHOLDS.evident_gain:
                    best = smaller
        return found

    def _adds_beyond(self, fewer: Hypothesis, more: Hypothesis, proven: Callable[[Hypothesis], float]) -> float:
        """What a hypothesis gains of what one with fewer effects leaves."""
        known = proven(fewer)
        return (proven(more) - known) / max(1 - known, self.least_whole)

    def without_each(
        self, hypothesis: Hypothesis, known: Set[frozenset[str]] = frozenset(), only: str | None = None
    ) -> list[Hypothesis]:
        """A hypothesis without each of its effects, or without one of them only, fitted, but for sets of effects that
        are `known`, by id."""
        return self._proposing.without_each(hypothesis, known, only)

    @cached_property
    def _proposing(self) -> Proposing:
        return Proposing(self.secants, self.fitting, self.offered)

    def _refined(self, fitted: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses with their shapes, fitted further: the best with secants of their own, the others with those of
        their last effect."""
        hypotheses = self.fitting.shaped(fitted)
        best, others = hypotheses[: EFFORT.beam], hypotheses[EFFORT.beam :]
        return [*self.fitting.refined_each(best), *self.fitting.refined_by_last(others)]

    def leaves_something(self, fitted: Fit) -> bool:
        """True if a fit leaves a signal further off than a good model does."""
        return self.residuals.worst(fitted.residuals) > THRESHOLDS.noise_level

    def better_base(self, hypotheses: Sequence[Hypothesis]) -> Fit | None:
        """The base parameters fitted anew from where they are in one of the hypotheses, if even without its effect they
        fit better there than the base: then the effect gained because the base fit had stopped short."""
        least, begin = self.base.value - EFFORT.stuck_share * self.whole, None
        for hypothesis in hypotheses:
            taken = {parameter.name for candidate in hypothesis.candidates for parameter in candidate.free_parameters}
            estimated = {k: v for k, v in hypothesis.fit.offset_by_name.items() if k not in taken}
            offsets = np.array([estimated.get(name, offset) for name, offset in self.base.offset_by_name.items()])
            parameter_set = with_offsets(self.start, self.base.free_parameters, offsets)
            tried = replace(self.base, offsets=offsets, residuals=self.residuals(parameter_set, self.base.residuals))
            if tried.value < least:
                least, begin = tried.value, offsets
        if begin is None:
            return None
        try:
            return fit(self.residuals, self.start, self.base.free_parameters, begin=begin, progress=self._progress)
        except DivergedError:
            return None

    def further(
        self, hypotheses: Sequence[Hypothesis], least: float, proven: Callable[[Hypothesis], float], unseen: bool
    ) -> list[Hypothesis]:
        """The best hypotheses by their `proven` gain with one more effect each, where that promises a share `least` of
        what they leave: in cross-validation, unless there are `unseen` recordings to prove it on. Other objections to
        them do not count here: parts of several defects explain little alone."""

        def promised(signatures: Iterable[Signature], known: Hypothesis) -> Iterator[Promise]:
            """The gain that a hypothesis would prove with one more effect, if that is worth it."""
            before = proven(known)
            for signature in signatures:
                adds = signature.gain - known.gain if unseen else signature.score - known.score
                if adds > least * max(1 - before, self.least_whole):
                    yield before + adds, signature

        promise = itemgetter(0)
        ranked = sorted((e for e in hypotheses if proven(e) > least), key=proven, reverse=True)[: EFFORT.paired]
        extended: dict[frozenset[str], Promise] = {}
        for place, hypothesis in enumerate(ranked):
            for one in promised(self._with_one_more(hypothesis, place, ranked), hypothesis):
                effects = frozenset(c.effect for c in one[1].candidates)
                extended[effects] = max(extended.get(effects, one), one, key=promise)
        fitted = self._fitted_likeliest(sorted(extended.values(), key=promise, reverse=True))
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def _with_one_more(self, hypothesis: Hypothesis, place: int, ranked: Sequence[Hypothesis]) -> list[Signature]:
        """Signatures of a hypothesis, at a `place` among the `ranked` ones, with one more effect: the best take
        whatever promises most; of single effects each takes each other."""
        if len(hypothesis.candidates) >= EFFORT.most_effects:
            return []
        if place < EFFORT.beam:
            return self.screening.screened(hypothesis.fit, hypothesis.candidates, EFFORT.beam)
        if len(hypothesis.candidates) > 1:
            return []
        return [
            self.screening.signature(hypothesis.fit, hypothesis.candidates, other.candidates)
            for other in ranked
            if set(other.effects).isdisjoint(hypothesis.effects) and not other.candidates[0].along_road
        ]

    def _fitted_likeliest(self, likeliest: Sequence[Promise]) -> list[Hypothesis]:
        """The likeliest signatures, fitted, and the best of them fitted further."""
        chosen = [signature for _, signature in (*likeliest[: EFFORT.beam], *_of_both_layers(likeliest)[:1])]
        fitted = self.fitting.refined_by_last(self.fitting.fitted(chosen))
        best = max(fitted, key=lambda e: e.score, default=None)
        return [self.fitting.refined(e) if e is best else e for e in fitted]

    def trials(self) -> Iterator[tuple[Candidate, list[Array]]]:
        """Secants at the base fit of the candidates with one size, per deviation, by window."""
        self.screening.simulate_new()
        for candidate in self.screening.besides(()):
            if len(candidate.free_parameters) == 1:
                (parameter,) = candidate.free_parameters
                yield candidate, [np.asarray(s * parameter.deviation, float) for s in self.secants.column(parameter)]

    def described(self, besides: Hypothesis | None = None) -> list[Hypothesis]:
        """Terms without known physics that are possible, alone or `besides` an explanation, fitted in full, best
        first."""
        every = [term for term in terms(self.start.values) if self.screening.possible(term)]
        self.secants.simulate_new(every)
        at, known = (self.base, ()) if besides is None else (besides.fit, besides.candidates)
        signatures = [self.screening.signature(at, known, (term,)) for term in every]
        return self.fitting.fitted(sorted(signatures, key=lambda s: s.score, reverse=True)[: EFFORT.terms_tried])

    def joint(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The first of the hypotheses fitted jointly with the further effects of each other one, which shows what they
        add to one another."""
        first, *others = hypotheses
        besides: dict[frozenset[str], tuple[Candidate, ...]] = {}
        for other in others:
            new = tuple(c for c in other.candidates if c.effect not in first.effects)
            besides.setdefault(frozenset(c.effect for c in new), new)
        likeliest = [new for new in besides.values() if new][: EFFORT.beam]
        fitted = self.fitting.fitted([self.screening.signature(first.fit, first.candidates, new) for new in likeliest])
        return self.fitting.refined_each(fitted)

    def with_profile(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """A hypothesis with an effect of the road that has one size for all places, fitted with a profile of it (a size
        for every place) instead, if that explains more. None without such an effect."""
        if hypothesis not in self._profiled:
            self._profiled[hypothesis] = self._fitted_with_profile(hypothesis)
        return self._profiled[hypothesis]

    def _fitted_with_profile(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """Fit what `with_profile` returns."""
        profiles = {first_size(c): c for c in self.offered if c.along_road}
        single = next((c for c in hypothesis.candidates if first_size(c) in profiles), None)
        if single is None or any(c.along_road for c in hypothesis.candidates):
            return None
        profile, at = profiles[first_size(single)], hypothesis.fit
        if not self.validation.profiles_can_be_validated:
            return None
        self.secants.simulate_new([profile])
        fitted = self.fitting.fit(self.secants.joined(at, profile.places))
        fitted = self.fitting.fit(replace(fitted, slopes=self.secants.all_slopes_at(fitted)))
        if at.value - fitted.value < EFFORT.least_profile_gain * self.whole:
            return None
        candidates = (*(c for c in hypothesis.candidates if c is not single), profile)
        return self.fitting.with_shape(self.fitting.hypothesis(candidates, fitted, hypothesis.independent_share))

    def together(self, candidates: Sequence[Candidate]) -> list[Hypothesis]:
        """All candidates at once, without a search."""
        self.secants.simulate_new(candidates)
        return self.fitting.fitted([self.screening.signature(self.base, (), tuple(candidates))])


def is_trusted(hypothesis: Hypothesis) -> bool:
    """True if the evidence is sure of each effect of a hypothesis that it has proposed."""
    return all(hypothesis.evident[effect] >= THRESHOLDS.trusted for effect in hypothesis.effects)


def _of_both_layers(likeliest: Sequence[Promise]) -> list[Promise]:
    """Those beyond the first `EFFORT.beam` whose last effect is of the layer, sensors or the car on its road, that none
    of these is of."""

    def of_sensors(signature: Signature) -> bool:
        return EVERY[signature.candidates[-1].effect].acts_on() == SENSOR

    layers = {of_sensors(signature) for _, signature in likeliest[: EFFORT.beam]}
    return [one for one in likeliest[EFFORT.beam :] if of_sensors(one[1]) not in layers]


def _worth_their_freedom(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses without the profiles that explain hardly more than one size for all places does."""
    single: dict[tuple[str, ...], float] = {}
    for e in hypotheses:
        if not e.candidates[-1].along_road:
            single[e.effects] = max(e.score, single.get(e.effects, 0.0))
    return [
        e
        for e in hypotheses
        if not e.candidates[-1].along_road or e.score > single.get(e.effects, 0.0) + EFFORT.least_profile_gain
    ]
