"""From a fit that leaves something over to the effects that would explain it.

Candidates are first screened linearly. What a candidate does to the residuals is its signature; what counts is the part
of it that the free parameters of the fit cannot imitate (a projection by their normal equations, window by window, so
that folds of a cross-validation need no further simulation). Those that promise most are then fitted in full, together
with all other free parameters: that is a hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identify.free_parameter import FreeParameter, joined, with_offsets
from vsense_ros.identify.least_squares import SEARCH, DivergedError, Fit, fit, fit_each, slopes_by
from vsense_ros.identify.normal_equations import NormalEquations
from vsense_ros.identify.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate, shapes, terms
from vsense_ros.mismatch.cross_validation import (
    Folds,
    as_it_is,
    by_pieces,
    by_stretches,
    by_windows,
    pieces_alone_tell,
    places,
    tells_its_pieces,
)
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import SPACING
from vsense_ros.model.effects.unmodelled import axle_of_torque

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SearchSettings:
    """How far the search for effects goes: decisions of this project, between computing time and completeness."""

    # candidates by their gain, as many by their cross-validation gain, and as many without their best window
    shortlist: int = 4
    # [-] of a profile (a size for every place of the road) beyond that of one size for all places
    least_profile_gain: float = 0.06
    # [-] of the best score, below which no profile is fitted: it has a parameter for each place
    promising_share: float = 0.5
    trace: float = 1e-6  # [deviations] by which a likely size changes something that was recorded, beyond rounding
    secant: float = 1.0  # [likely offsets]: some effects have no slope at zero
    paired: int = 8  # single hypotheses of which all pairs are tried
    beam: int = 3  # hypotheses to which a further effect is added, and further effects that are tried with each
    most_effects: int = 6  # at once
    shaped_gain: float = 0.03  # [-] of an effect from where on its shape can be seen
    # Least gain of hypotheses that are fitted again with secants of their own: where base parameters stand in
    # for an effect, it takes several fits to undo that.
    refined_gain: float = 0.01
    places_apart: int = 6  # from one to the next of the places that are changed together
    # of a profile up to which explanations are refined: on 76, on two laps, that doubled the computing
    few_places: int = 40
    # [-] of the cost by which base parameters fit better elsewhere if their fit stopped short
    stuck_share: float = 0.02
    terms_tried: int = 3  # terms that are fitted in full
    # [-] deviation of a size that was named, over its fitted value, with which the prior hardly shrinks it
    unshrunk_ratio: float = 2.0


EFFORT = SearchSettings()

SENSOR = "sensor"  # what the effects of the one layer act on


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
    """Candidates fitted together with the base parameters; equal to itself alone, so that results can be told by it."""

    candidates: tuple[Candidate, ...]
    fit: Fit
    independent_share: float  # of the signature of the last one
    gain: float  # fall of the base's value, over that value
    cv_gain: float  # cross-validation gain: fall of the value of folds that were dropped from the fit, over the same
    cv_share: float  # that fall over what the base leaves of dropped folds
    spoilt: float  # what windows lose that fit worse than with the base, over what the others gain
    deviations: Mapping[str, float]  # standard deviations of the sizes by dotted name, in their units

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


class Search:
    """Looks for hypotheses that explain what a base fit leaves over. Secants of candidates are simulated once, at the
    base fit."""

    def __init__(
        self,
        residuals: Residuals,
        start: ParameterSet,
        base: Fit,
        offered: Sequence[Candidate],
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.residuals, self.start, self.base, self.offered = residuals, start, base, offered
        self._with_profile: dict[int, tuple[Hypothesis, Hypothesis | None]] = {}  # by id of the first
        self._varying: set[str] = set()  # names of candidates whose profile is worth it alone
        self._progress = progress
        # What gains are relative to: no less than a good model leaves, as there is nothing to gain below that.
        least_whole = float(sum(len(r) for r in base.residuals))
        self.whole = max(base.value, least_whole)
        self.least_whole = least_whole / self.whole
        self._columns: dict[tuple[str, str], list[Array]] = {  # by name and form
            (parameter.name, parameter.form): [part[:, i] / parameter.deviation for part in base.slopes]
            for i, parameter in enumerate(base.free_parameters)
        }

    @cached_property
    def visible(self) -> frozenset[str]:
        """Ids of the effects that would change something that was recorded, at a likely size."""
        self._simulate_new(self.offered)
        least = EFFORT.trace
        return frozenset(
            c.effect for c in self.offered
            if any(np.abs(p).max(initial=0.0) * k.likely > least for k in c.free_parameters for p in self._column(k))
        )  # fmt: skip

    def single(self) -> list[Hypothesis]:
        """The likeliest candidates alone, fitted in full, best first."""
        found = self._shaped(_worth_their_freedom(self._fitted(self._screened(self.base, (), EFFORT.shortlist))))
        self._varying = {e.candidates[-1].name for e in found if e.candidates[-1].along_road}
        return sorted(self._refined_each(found), key=lambda e: e.score, reverse=True)

    def _shaped(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The hypotheses, the best of them with the shapes of their effects fitted, too."""
        found = [*map(self._with_shape, hypotheses[: EFFORT.beam]), *hypotheses[EFFORT.beam :]]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def _with_shape(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with the shapes of its last effect fitted, too, if that has some and they can be seen."""
        at, free_parameters = hypothesis.fit, shapes(hypothesis.candidates[-1], self.start.values)
        if not free_parameters or hypothesis.gain < EFFORT.shaped_gain:
            return hypothesis
        columns = slopes_by(self.residuals, self.start, at, free_parameters)
        slopes = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        return self._hypothesis(
            hypothesis.candidates, self._fit(at.joined(free_parameters, slopes)), hypothesis.independent_share
        )

    def better_base(self, hypotheses: Sequence[Hypothesis]) -> Fit | None:
        """The base parameters fitted anew from where they are in one of the hypotheses, if even without its effect they
        fit better there than the base: then the effect gained because the base fit had stopped short."""
        least, begin = self.base.value - EFFORT.stuck_share * self.whole, None
        for hypothesis in hypotheses:
            taken = {parameter.name for candidate in hypothesis.candidates for parameter in candidate.free_parameters}
            found = {k: v for k, v in hypothesis.fit.offset_by_name.items() if k not in taken}
            offsets = np.array([found.get(name, offset) for name, offset in self.base.offset_by_name.items()])
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
        what they leave: in cross-validation, unless there are `unseen` recordings to prove it on. What else speaks
        against them is not asked: parts of several defects explain little alone."""
        found: dict[frozenset[str], tuple[float, Signature]] = {}
        pairs: list[tuple[float, Signature]] = []
        promise = itemgetter(0)
        ranked = sorted((e for e in hypotheses if proven(e) > least), key=proven, reverse=True)

        def promised(signature: Signature, known: Hypothesis | None = None) -> tuple[float, Signature] | None:
            """What a hypothesis, or the base fit, would prove with more effects, if that is enough for each of them."""
            gain, score, before = (0.0, 0.0, 0.0) if known is None else (known.gain, known.score, proven(known))
            adds = signature.gain - gain if unseen else signature.score - score
            more = len(signature.candidates) - (0 if known is None else len(known.candidates))
            return (before + adds, signature) if adds > more * least * max(1 - before, self.least_whole) else None

        if all(len(e.candidates) == 1 for e in hypotheses):
            pairs += filter(None, map(promised, self._hiding_each_other(self.base, ())))
        for place, hypothesis in enumerate(ranked[: EFFORT.paired]):
            if len(hypothesis.candidates) >= EFFORT.most_effects:
                continue
            # The best take whatever promises most; of single effects each takes each other.
            if place < EFFORT.beam:
                signatures = self._screened(hypothesis.fit, hypothesis.candidates, EFFORT.beam)
                if len(hypothesis.candidates) + 1 < EFFORT.most_effects:
                    hiding = self._hiding_each_other(hypothesis.fit, hypothesis.candidates)
                    pairs += filter(None, (promised(signature, hypothesis) for signature in hiding))
            elif len(hypothesis.candidates) == 1:
                signatures = [
                    self._signature(hypothesis.fit, hypothesis.candidates, other.candidates)
                    for other in ranked[: EFFORT.paired]
                    if set(other.effects).isdisjoint(hypothesis.effects) and not other.candidates[0].along_road
                ]
            else:
                continue
            for one in filter(None, (promised(signature, hypothesis) for signature in signatures)):
                effects = frozenset(c.effect for c in one[1].candidates)
                found[effects] = max(found.get(effects, one), one, key=promise)
        likeliest = sorted(found.values(), key=promise, reverse=True)
        chosen = [signature for _, signature in (*likeliest[: EFFORT.beam], *_of_both_layers(likeliest)[:1])]
        fitted = self._refined_by_last(self._fitted(chosen))
        best = max(fitted, key=lambda e: e.score, default=None)
        fitted = [self.refined(e) if e is best else e for e in fitted]
        # Two that hide each other promise more than one more effect, unless that explains what they seem to.
        two = max(pairs, key=promise, default=None)
        if two is not None and (not likeliest or two[0] > likeliest[0][0]):
            fitted += self._refined_each(self._fitted([two[1]]))
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def secants(self) -> Iterator[tuple[Candidate, list[Array]]]:
        """Secants at the base fit of the candidates with one size, per deviation, by window."""
        self._simulate_new(self.offered)
        for candidate in self.offered:
            if len(candidate.free_parameters) == 1:
                (parameter,) = candidate.free_parameters
                yield candidate, [part * parameter.deviation for part in self._column(parameter)]

    def described(self, besides: Hypothesis | None = None) -> list[Hypothesis]:
        """Terms without known physics that are possible, alone or `besides` an explanation, fitted in full, best
        first."""
        every = [term for term in terms(self.start.values) if self._possible(term)]
        self._simulate_new(every)
        at, known = (self.base, ()) if besides is None else (besides.fit, besides.candidates)
        found = [self._signature(at, known, (term,)) for term in every]
        return self._fitted(sorted(found, key=lambda s: s.score, reverse=True)[: EFFORT.terms_tried])

    def _possible(self, term: Candidate) -> bool:
        """True if a term is one that this car may have: a torque from one wheel of an axle to the other needs an axle
        that is driven, or brakes."""
        across = {parameter.name: axle_of_torque(parameter.name) for parameter in term.free_parameters}
        return all(axle is None or axle in self._driven for axle in across.values())

    @cached_property
    def _driven(self) -> frozenset[str]:
        """The axles that are driven, as far as that is known: by measured torques, or by the share of the front wheels
        that was fitted."""
        return self.residuals.predictor.driven_axles(self.base.parameter_set)

    def joint(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The first of the hypotheses fitted jointly with the further effects of each other one, which shows what they
        add to one another."""
        first, *others = hypotheses
        besides: dict[frozenset[str], tuple[Candidate, ...]] = {}
        for other in others:
            new = tuple(c for c in other.candidates if c.effect not in first.effects)
            besides.setdefault(frozenset(c.effect for c in new), new)
        likeliest = [new for new in besides.values() if new][: EFFORT.beam]
        fitted = self._fitted([self._signature(first.fit, first.candidates, new) for new in likeliest])
        return self._refined_each(fitted)

    def exchanged(self, hypothesis: Hypothesis, known: Sequence[Hypothesis], share: float) -> list[Hypothesis]:
        """Hypotheses in which each of several effects is exchanged for those that it is mistaken for, where that
        promises a `share` of what it explains beside the others; and the others alone, where that was not known. Sets
        grow from the best, so that a set may never have been fitted that explains as much as one that was."""
        self._simulate_new(self.offered)
        fitted = {frozenset(e.effects): e for e in sorted(known, key=lambda e: e.score)}
        single = [c for c in hypothesis.candidates if len(hypothesis.candidates) > 1 and not c.along_road]
        others = {candidate: frozenset(hypothesis.effects) - {candidate.effect} for candidate in single}
        unknown = [candidate for candidate in single if others[candidate] not in fitted]
        alone = self._without_each(hypothesis, unknown)
        fitted |= {frozenset(e.effects): e for e in alone}
        alike: list[Signature] = []
        for candidate in single:
            rest = fitted[others[candidate]]
            least = rest.gain + share * (hypothesis.gain - rest.gain)
            signatures = (
                self._signature(rest.fit, rest.candidates, (other,))
                for other in self._besides(hypothesis.candidates)
                if _mistaken(candidate.effect, other.effect) and not other.along_road
                and others[candidate] | {other.effect} not in fitted
            )  # fmt: skip
            likely = sorted((s for s in signatures if s.gain > least), key=lambda s: s.gain)
            at_best_place = {s.candidates[-1].effect: s for s in likely}
            alike += list(at_best_place.values())[-EFFORT.beam :]
        return [*alone, *self._refined_by_last(self._fitted(alike))]

    def _without_each(self, hypothesis: Hypothesis, chosen: Sequence[Candidate]) -> list[Hypothesis]:
        """A hypothesis without each of some of its effects, the rest fitted again."""
        fits = self._fit_each(self._without(hypothesis, candidate) for candidate in chosen)
        return [
            self._hypothesis(tuple(c for c in hypothesis.candidates if c is not out), f, hypothesis.independent_share)
            for out, f in zip(chosen, fits, strict=True)
        ]

    def _without(self, hypothesis: Hypothesis, candidate: Candidate) -> Fit:
        """Where a fit of a hypothesis without one of its effects begins."""
        at = hypothesis.fit
        names = {parameter.name for parameter in candidate.free_parameters}
        names |= {parameter.name for parameter in shapes(candidate, self.start.values)}
        base = {parameter.name: parameter for parameter in self.base.free_parameters}
        # What every car has a little of is fitted with its own prior again.
        common = [base[name] for name in names if name in base]
        stay = [i for i, parameter in enumerate(at.free_parameters) if parameter.name not in names]
        return replace(
            at, free_parameters=tuple(at.free_parameters[i] for i in stay), offsets=at.offsets[stay],
            slopes=[s[:, stay] for s in at.slopes],
        ).joined(common, self._base_columns(common))  # fmt: skip

    def _base_columns(self, free_parameters: Sequence[FreeParameter]) -> list[Array]:
        """By window, (rows, n): slopes of the base fit by some of its free parameters, per deviation."""
        names = [parameter.name for parameter in self.base.free_parameters]
        places_of = [names.index(parameter.name) for parameter in free_parameters]
        return [part[:, places_of] for part in self.base.slopes]

    def with_profile(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """A hypothesis with an effect of the road that has one size for all places, fitted with a profile of it (a size
        for every place) instead, if that explains more. None without such an effect."""
        if id(hypothesis) not in self._with_profile:
            self._with_profile[id(hypothesis)] = hypothesis, self._profiled(hypothesis)
        return self._with_profile[id(hypothesis)][1]

    def _profiled(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """`with_profile`, fitted."""
        profiles = {_first(c): c for c in self.offered if c.along_road}
        single = next((c for c in hypothesis.candidates if _first(c) in profiles), None)
        if single is None or any(c.along_road for c in hypothesis.candidates):
            return None
        profile, at = profiles[_first(single)], hypothesis.fit
        if not self._known_well:
            return None
        by_place = map(self._column, profile.places)
        slopes = [np.column_stack(parts) * profile.places[0].deviation for parts in zip(*by_place, strict=True)]
        fitted = self._fit(at.joined(profile.places, slopes))
        fitted = self._fit(replace(fitted, slopes=self._slopes_at(fitted)))
        if at.value - fitted.value < EFFORT.least_profile_gain * self.whole:
            return None
        candidates = (*(c for c in hypothesis.candidates if c is not single), profile)
        return self._with_shape(self._hypothesis(candidates, fitted, hypothesis.independent_share))

    def together(self, candidates: Sequence[Candidate]) -> list[Hypothesis]:
        """All candidates at once, without a search."""
        self._simulate_new(candidates)
        return self._fitted([self._signature(self.base, (), tuple(candidates))])

    def _screened(self, at: Fit, present: tuple[Candidate, ...], count: int) -> list[Signature]:
        """The likeliest candidates besides those present: `count` by their gain, as many by their score, and as many by
        their gain elsewhere than in the window where they promise most."""
        self._simulate_new(self.offered)
        found = [self._signature(at, present, (c,)) for c in self._besides(present)]
        found = [s for s in found if s.independent_share > 0]
        single = [s for s in found if not s.candidates[-1].along_road]
        by_gain = sorted(single, key=lambda s: s.gain, reverse=True)[:count]
        by_score = sorted(single, key=lambda s: s.score, reverse=True)[:count]
        elsewhere = sorted((s for s in single if s.elsewhere > 0), key=lambda s: s.elsewhere, reverse=True)[:count]
        chosen = {s.candidates[-1].name: s for s in (*by_score, *by_gain, *elsewhere)}
        best = max((s.score for s in single), default=0.0)
        for free in (s for s in found if s.candidates[-1].along_road and self._may_vary(s.candidates[-1], present)):
            one = next((s for s in single if _first(s.candidates[-1]) == _first(free.candidates[-1])), None)
            known = max(one.score if one is not None else 0.0, self.of_several_cars)
            if free.score > max(known + EFFORT.least_profile_gain, EFFORT.promising_share * best):
                chosen |= {s.candidates[-1].name: s for s in (one, free) if s is not None}
        return list(chosen.values())

    def _besides(self, present: Sequence[Candidate]) -> list[Candidate]:
        """The candidates of effects that are not present."""
        names = {candidate.effect for candidate in present}
        return [candidate for candidate in self.offered if candidate.effect not in names]

    def _hiding_each_other(self, at: Fit, present: tuple[Candidate, ...]) -> list[Signature]:
        """Pairs of effects that are mistaken for each other and promise more than twice what either does alone. An
        accelerometer that has an offset and is turned as well may read right on the whole: a search that adds one
        effect at a time sees neither."""
        self._simulate_new(self.offered)
        known = (self.base.value - at.value) / self.whole
        single = [c for c in self._besides(present) if len(c.free_parameters) == 1]
        promised = {c.name: self._signature(at, present, (c,)).gain - known for c in single}
        found = []
        for one, other in combinations(single, 2):
            if _mistaken(one.effect, other.effect):
                both = self._signature(at, present, (one, other))
                if both.gain - known > 2 * max(promised[one.name], promised[other.name], 0.0):
                    found.append(both)
        return found

    def _may_vary(self, profile: Candidate, present: Sequence[Candidate]) -> bool:
        """True if a profile may be fitted with the candidates present: it would mend the residuals of any other effect,
        as none is quite right, unless it was worth its many parameters alone."""
        if any(candidate.along_road for candidate in present) or not self._known_well:
            return False
        return not present or profile.name in self._varying

    def _simulate(self, free_parameters: Iterable[FreeParameter]) -> None:
        """Secants of the base fit."""
        every = {(parameter.name, parameter.form): parameter for parameter in free_parameters}
        secants = slopes_by(self.residuals, self.start, self.base, list(every.values()), EFFORT.secant)
        for (key, parameter), secant in zip(every.items(), secants, strict=True):
            self._columns[key] = [part / parameter.deviation for part in secant]
            self._progress()

    def _simulate_new(self, candidates: Iterable[Candidate]) -> None:
        """Secants of candidates that are met for the first time, those of single places `together`."""
        candidates = list(candidates)
        free_parameters = (parameter for candidate in candidates for parameter in candidate.free_parameters)
        new = [parameter for parameter in free_parameters if (parameter.name, parameter.form) not in self._columns]
        self._simulate(parameter for parameter in new if parameter.place is None)
        for candidate in candidates:
            if candidate.along_road and candidate.places[0] in new:
                self._simulate_together(candidate.places)

    def _simulate_together(self, points: Sequence[FreeParameter]) -> None:
        """Secants of the base fit by a size at places."""
        for point, slopes in zip(points, self._slopes_of_places(self.base, points, EFFORT.secant), strict=True):
            self._columns[point.name, point.form] = [part / point.deviation for part in slopes]

    def _slopes_of_places(self, at: Fit, points: Sequence[FreeParameter], step: float) -> list[list[Array]]:
        """Slopes by a size at each of these places, per deviation, by window: of those that are far from one another at
        once, as a car has soon forgotten where it has been. What happens around a place is what the size there does."""
        groups = [points[first :: EFFORT.places_apart] for first in range(min(EFFORT.places_apart, len(points)))]
        windows, layout = self.residuals.predictor.dataset.windows, self.residuals.layout
        passed = [np.tile(places(window), len(names)) for window, names in zip(windows, layout, strict=True)]
        found: dict[str, list[Array]] = {}
        secants = slopes_by(self.residuals, self.start, at, [joined(group) for group in groups], step)
        for group, secant in zip(groups, secants, strict=True):
            for point in group:
                assert point.place is not None
                near = [np.abs(way - point.place[1]) < EFFORT.places_apart / 2 * SPACING for way in passed]
                found[point.name] = [np.where(here, part, 0.0) for here, part in zip(near, secant, strict=True)]
            self._progress()
        return [found[point.name] for point in points]

    def _slopes_at(self, at: Fit) -> list[Array]:
        """By window, (rows, k): slopes by all free parameters of a fit from where it is, per deviation."""
        known = [parameter for parameter in at.free_parameters if parameter.place is None]
        points = [parameter for parameter in at.free_parameters if parameter.place is not None]
        columns = {}
        for parameter, column in zip(known, slopes_by(self.residuals, self.start, at, known), strict=True):
            columns[parameter.name] = column
            self._progress()
        columns |= {p.name: c for p, c in zip(points, self._slopes_of_places(at, points, SEARCH.secant), strict=True)}
        in_order = (columns[parameter.name] for parameter in at.free_parameters)
        return [np.column_stack(parts) for parts in zip(*in_order, strict=True)]

    def _signature(self, at: Fit, present: tuple[Candidate, ...], new: tuple[Candidate, ...]) -> Signature:
        free_parameters = tuple(parameter for candidate in new for parameter in candidate.free_parameters)

        def joint() -> Fit:
            columns = [self._column(parameter) for parameter in free_parameters]
            slopes = [
                np.column_stack(c) * [parameter.deviation for parameter in free_parameters]
                for c in zip(*columns, strict=True)
            ]
            return at.joined(free_parameters, slopes)

        equations = self._joined_equations(at, free_parameters)
        free, change = equations.within_bounds([parameter.name for parameter in free_parameters])
        falls = self.base.equations.values() - free.values(change)
        folds = self._folds_for((*present, *new))
        known = free if folds.apart is as_it_is else folds.apart(joint()).equations
        return Signature(
            (*present, *new), joint, equations.independent_share(free_parameters), float(falls.sum()) / self.whole,
            folds.gains(known, self.whole)[0], float(falls.sum() - falls.max()) / self.whole,
        )  # fmt: skip

    def _joined_equations(self, at: Fit, free_parameters: Sequence[FreeParameter]) -> NormalEquations:
        """The equations of `Fit.joined`, of which those of the fit are known."""
        known, names = at.equations, {parameter.name for parameter in free_parameters}
        stay = [i for i, parameter in enumerate(at.free_parameters) if parameter.name not in names]
        present = at.offset_by_name
        columns = [[part * parameter.deviation for part in self._column(parameter)] for parameter in free_parameters]
        new = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        across = np.array([(s.T @ n)[stay] for s, n in zip(at.slopes, new, strict=True)])
        own = np.array([n.T @ n for n in new])
        rest = known.only(stay)
        return replace(
            rest,
            free_parameters=(*rest.free_parameters, *free_parameters),
            scaled_offsets=np.append(
                rest.scaled_offsets,
                [present.get(parameter.name, 0.0) / parameter.deviation for parameter in free_parameters],
            ),
            normal=np.block([[rest.normal, across], [across.transpose(0, 2, 1), own]]),
            right=np.hstack([rest.right, [n.T @ r for n, r in zip(new, at.residuals, strict=True)]]),
        )

    def _column(self, parameter: FreeParameter) -> list[Array]:
        """Secant per unit of a free parameter."""
        return self._columns[parameter.name, parameter.form]

    @cached_property
    def _in_pieces(self) -> bool:
        """True if a road can be validated by nothing but how its pieces predict one another."""
        return pieces_alone_tell(self.residuals.predictor.dataset)

    @cached_property
    def of_several_cars(self) -> float:
        """What base parameters of its own for each recording would gain, by the linear model, where a road of its own
        for each could stand in for them: nothing of a single recording, or of several on one road."""
        if not self._in_pieces:
            return 0.0
        equations = self.base.equations
        groups = self.residuals.predictor.dataset.places_by_recording()
        left = sum(float(equations.values(equations.change(group))[group].sum()) for group in groups)
        return (self.base.value - left) / self.whole

    @cached_property
    def _known_well(self) -> bool:
        """True if the recordings can validate a profile."""
        return not self._in_pieces or tells_its_pieces(self.residuals.predictor.dataset)

    def _folds_for(self, candidates: Sequence[Candidate]) -> Folds:
        """The folds by which a hypothesis of these candidates is cross-validated."""
        if self._in_pieces and any(candidate.along_road for candidate in candidates):
            return self._pieces
        return self.folds

    @cached_property
    def folds(self) -> Folds:
        """Those where no candidate has a profile."""
        return (by_stretches if len(self.base.residuals) == 1 else by_windows)(self.residuals, self.base)

    @cached_property
    def _pieces(self) -> Folds:
        return by_pieces(self.residuals, self.base)

    def _fitted(self, signatures: Sequence[Signature]) -> list[Hypothesis]:
        fits = self._fit_each(s.joint() for s in signatures)
        found = [self._hypothesis(s.candidates, f, s.independent_share) for s, f in zip(signatures, fits, strict=True)]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis fitted further with secants of its own. With those of the base fit, whose parameters may be
        far off because they stand in for the effect, it stops short."""
        return self._refined_each([hypothesis])[0]

    def _refined_each(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """`refined`, side by side."""

        def few(hypothesis: Hypothesis) -> bool:
            return sum(parameter.place is not None for parameter in hypothesis.fit.free_parameters) <= EFFORT.few_places

        chosen = [e for e in hypotheses if few(e) and e.gain > EFFORT.refined_gain]
        better = self._fitted_further(chosen, (replace(e.fit, slopes=self._slopes_at(e.fit)) for e in chosen))
        return [self._on_the_road(better.get(e, e)) if few(e) else e for e in hypotheses]

    def _refined_by_last(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The hypotheses fitted further with secants of their last effect alone: those of the others and of the base
        parameters are of the hypothesis that it was added to, which is near."""

        def joined(hypothesis: Hypothesis) -> Fit:
            at, new = hypothesis.fit, hypothesis.candidates[-1].free_parameters
            columns = slopes_by(self.residuals, self.start, at, new)
            return at.joined(new, [np.column_stack(parts) for parts in zip(*columns, strict=True)])

        chosen = [e for e in hypotheses if e.gain > EFFORT.refined_gain and not e.candidates[-1].along_road]
        better = self._fitted_further(chosen, map(joined, chosen))
        return [self._on_the_road(better.get(e, e)) if e in chosen else e for e in hypotheses]

    def _fitted_further(self, hypotheses: Sequence[Hypothesis], joints: Iterable[Fit]) -> dict[Hypothesis, Hypothesis]:
        """Those that get better if they go on from these fits, as they are then."""
        fits = zip(hypotheses, self._fit_each(joints), strict=True)
        return {e: self._hypothesis(e.candidates, f, e.independent_share) for e, f in fits if f.value < e.fit.value}

    def _on_the_road(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis, fitted anew from the parameters of the vehicle file if its car gets lost. There the residuals
        are those of the base fit, so that base parameters would stay where they stand in for the effect."""
        at = hypothesis.fit
        lost = sum(self.residuals.predictor.lost(at.parameter_set))
        if not lost:
            return hypothesis
        begin = np.array([hypothesis.sizes.get(parameter.name, 0.0) for parameter in at.free_parameters])
        found = fit(
            self.residuals, self.start, at.free_parameters, begin=begin, instead=self.base.residuals,
            progress=self._progress,
        )  # fmt: skip
        if sum(self.residuals.predictor.lost(found.parameter_set)) >= lost:
            return hypothesis
        return self._hypothesis(hypothesis.candidates, replace(found, weight=at.weight), hypothesis.independent_share)

    def unshrunk(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with its sizes fitted once more with a wider prior, which hardly shrinks them: the narrow one
        has told the likely effects from the unlikely. Its gain is counted with the same prior as that of all others."""
        at, sizes = hypothesis.fit, hypothesis.sizes
        times = np.array(
            [max(1.0, EFFORT.unshrunk_ratio * abs(sizes.get(p.name, 0.0)) / p.deviation) for p in at.free_parameters]
        )
        free_parameters = tuple(
            replace(parameter, deviation=parameter.deviation * factor)
            for parameter, factor in zip(at.free_parameters, times, strict=True)
        )
        fitted = self._fit(replace(at, free_parameters=free_parameters, slopes=[s * times for s in at.slopes]))
        with_narrow_prior = replace(fitted, free_parameters=at.free_parameters, slopes=at.slopes)
        return replace(
            self._hypothesis(hypothesis.candidates, with_narrow_prior, hypothesis.independent_share),
            deviations=self._deviations(hypothesis.candidates, fitted),
        )

    def _fit(self, joint: Fit) -> Fit:
        (fitted,) = self._fit_each([joint])
        return fitted

    def _fit_each(self, joints: Iterable[Fit]) -> list[Fit]:
        """Each fitted further, side by side."""
        fitted = fit_each(self.residuals, self.start, joints, self.base.residuals)
        self._progress()
        return fitted

    def _hypothesis(self, candidates: tuple[Candidate, ...], fitted: Fit, independent_share: float) -> Hypothesis:
        falls = self.base.equations.values() - fitted.equations.values()
        gained, lost = np.sum(falls[falls > 0]), -np.sum(falls[falls < 0])
        folds = self._folds_for(candidates)
        cv_gains = folds.gains(folds.apart(fitted).equations, self.whole)
        return Hypothesis(
            candidates, fitted, independent_share, (self.base.value - fitted.value) / self.whole, *cv_gains,
            float(lost / max(gained, 1e-12)), self._deviations(candidates, fitted),
        )  # fmt: skip

    def _deviations(self, candidates: Sequence[Candidate], fitted: Fit) -> dict[str, float]:
        """Standard deviations of the free parameters by name, by a jackknife over the folds: residuals of neighbouring
        instants err together, so that their number says nothing. The level of a profile is known no better than all
        that shifts with it: sensors with an offset see the same, and the prior alone tells the two apart."""
        equations = self._folds_for(candidates).apart(fitted).equations
        n = len(equations.rows)
        changes = np.array([equations.change([i for i in range(n) if i != out]) for out in range(n)])
        spread = np.sqrt((n - 1) / n * np.sum((changes - changes.mean(axis=0)) ** 2, axis=0))
        everywhere = {c.free_parameters[0].name for c in candidates if c.along_road}
        unknown = np.array([parameter.name in everywhere for parameter in fitted.free_parameters])
        spread = np.hypot(spread, np.where(unknown, equations.spread(), 0.0))
        return {
            parameter.name: float(s * parameter.deviation)
            for parameter, s in zip(fitted.free_parameters, spread, strict=True)
        }


def _of_both_layers(likeliest: Sequence[tuple[float, Signature]]) -> list[tuple[float, Signature]]:
    """Those beyond the first `EFFORT.beam` whose last effect is of the layer, sensors or the car on its road, that none
    of these is of."""

    def of_sensors(signature: Signature) -> bool:
        return EVERY[signature.candidates[-1].effect].acts_on() == SENSOR

    layers = {of_sensors(signature) for _, signature in likeliest[: EFFORT.beam]}
    return [one for one in likeliest[EFFORT.beam :] if of_sensors(one[1]) not in layers]


def _mistaken(one: str, other: str) -> bool:
    """True if two effects, by their ids, are mistaken for each other."""
    return other in EVERY[one].mistaken_for or one in EVERY[other].mistaken_for


def _first(candidate: Candidate) -> tuple[str, str]:
    """Name and form of its first size."""
    return candidate.free_parameters[0].name, candidate.free_parameters[0].form


def _worth_their_freedom(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Without the profiles that explain hardly more than one size for all places does."""
    single: dict[tuple[str, ...], float] = {}
    for e in hypotheses:
        if not e.candidates[-1].along_road:
            single[e.effects] = max(e.score, single.get(e.effects, 0.0))
    return [
        e
        for e in hypotheses
        if not e.candidates[-1].along_road or e.score > single.get(e.effects, 0.0) + EFFORT.least_profile_gain
    ]
