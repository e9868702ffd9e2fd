"""From a fit that leaves something over to the effects that would explain it.

Refit, screen, refit the shortlist, judge on what was left out: candidates are first compared by what is left of their
signature after the base parameters have been fitted anew to it (a projection, per window, so that any recording can be
left out), then fitted in full.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.cross_validation import (
    LeftOut,
    as_it_is,
    by_pieces,
    by_stretches,
    by_windows,
    pieces_alone_tell,
    places,
    tells_its_pieces,
)
from vsense_ros.mismatch.equations import Equations
from vsense_ros.mismatch.fit import DivergedError, Fit, Residuals, fit, slopes_at, slopes_by, turned
from vsense_ros.mismatch.knobs import Candidate, Knob, shapes, terms
from vsense_ros.mismatch.road import profile
from vsense_ros.mismatch.simulation import Setting

Array = NDArray[np.float64]

SHORTLIST = 4  # by the fall of the cost, as many by its fall on what was left out, and without the likeliest window
WORTH = 0.06  # of the cost that a size must explain which is another at every place, beyond what one size does
PROMISING = 0.5  # of the best score, below which no such size is fitted: each of its places costs a simulation
TRACE = 1e-6  # deviations by which a likely size changes something that was recorded, beyond rounding
SECANT = 1.0  # deviations: some effects have no slope at zero
BEAM = 3  # explanations to which a further effect is added, and further effects that are tried with each
MOST = 3  # effects at once
ENOUGH = 0.03  # gain of an effect from where on its shape can be seen
# Least gain of explanations that are fitted again with secants of their own: an effect that base parameters have taken
# up is found by degrees.
WORTH_POLISHING = 0.01
STUCK = 0.02  # of the cost by which base parameters fit better elsewhere if their fit stopped short
TRIED = 3  # terms that are fitted in full
FREED = 2.0  # a size of what is named is as likely as any up to this multiple of what it was found to be


@dataclass(frozen=True)
class Signature:
    """What candidates would do to the residuals of a fit, and what of it cannot be had from the knobs of that fit."""

    candidates: tuple[Candidate, ...]  # all of them, the last one is new
    # The fit with their knobs besides, not turned yet: made anew each time, for those of all would take gigabytes.
    joint: Callable[[], Fit]
    keep: float  # share of the signature that is left after the other knobs have been fitted to it [-]
    gain: float  # relative fall of the base's value, linearly
    left_out: float  # the same of what was left out of the fit in turn
    # The gain without the window that promises most: where a car is at its limit, lines promise what no fit keeps.
    elsewhere: float

    @property
    def score(self) -> float:
        return min(self.gain, self.left_out)


@dataclass(frozen=True)
class Explanation:
    """Candidates fitted together with the base parameters."""

    candidates: tuple[Candidate, ...]
    fit: Fit
    keep: float  # of the last one
    gain: float  # relative fall of the base's value
    left_out: float  # the same fall of what was left out in turn, over the same value
    left_out_share: float  # that fall over what the base leaves where it was left out
    spoilt: float  # what windows that fit worse than the base lose, over what the others gain
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
        """What chance must not reach: the smaller gain."""
        return min(self.gain, self.left_out)

    @property
    def sizes(self) -> dict[str, float]:
        """Values by dotted name."""
        amounts = dict(zip((knob.name for knob in self.fit.knobs), self.fit.amounts, strict=True))
        return {knob.name: float(amounts[knob.name]) for candidate in self.candidates for knob in candidate.knobs}


class Search:
    """What explains that a fit leaves something over; secants are simulated once, at the base fit."""

    def __init__(
        self,
        residuals: Residuals,
        start: Setting,
        base: Fit,
        offered: Sequence[Candidate],
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.residuals, self.start, self.base, self.offered = residuals, start, base, offered
        self._along_the_road: dict[int, tuple[Explanation, Explanation | None]] = {}  # by id of the first
        self._varying: set[str] = set()  # names of candidates with another size at every place that are worth it alone
        self._progress = progress
        # What gains are relative to: residuals below what sensors and models can do are no evidence.
        least_whole = float(sum(len(r) for r in base.residuals))
        self.whole = max(base.value, least_whole)
        self.least_whole = least_whole / self.whole
        self._columns: dict[tuple[str, str], list[Array]] = {  # by name and form
            (knob.name, knob.form): [part / knob.deviation for part in column]
            for knob, column in zip(base.knobs, _columns(base.slopes), strict=True)
        }

    @cached_property
    def visible(self) -> frozenset[str]:
        """Ids of the effects that would change something that was recorded, at a likely size."""
        self._simulate_new(self.offered)
        return frozenset(
            c.effect for c in self.offered
            if any(np.abs(p).max(initial=0.0) * k.likely > TRACE for k in c.knobs for p in self._column(k))
        )  # fmt: skip

    def singles(self) -> list[Explanation]:
        """The likeliest candidates alone, fitted in full, best first."""
        found = self._shaped(_worth_their_freedom(self._fitted(self._screened(self.base, (), SHORTLIST))))
        self._varying = {e.candidates[-1].name for e in found if e.candidates[-1].along_road}
        return sorted(map(self.polished, found), key=lambda e: e.score, reverse=True)

    def _shaped(self, explanations: Sequence[Explanation]) -> list[Explanation]:
        """The explanations, the best of them with their shapes fitted besides."""
        found = [*map(self._with_shape, explanations[:BEAM]), *explanations[BEAM:]]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def _with_shape(self, explanation: Explanation) -> Explanation:
        """The explanation with the shapes of its last effect fitted besides, if that has some and they can be seen."""
        at, knobs = explanation.fit, shapes(explanation.candidates[-1], self.start.values)
        if not knobs or explanation.gain < ENOUGH:
            return explanation
        columns = slopes_by(self.residuals, self.start, at, knobs)
        slopes = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        return self._explanation(explanation.candidates, self._fit(_joined(at, knobs, slopes)), explanation.keep)

    def better_base(self, explanations: Sequence[Explanation]) -> Fit | None:
        """The base parameters fitted anew from where they are in an explanation, if without its effect they fit better
        there than before: then the effect gained because the fit had stopped short."""
        least, begin = self.base.value - STUCK * self.whole, None
        for explanation in explanations:
            taken = {knob.name for candidate in explanation.candidates for knob in candidate.knobs}
            found = dict(zip((knob.name for knob in explanation.fit.knobs), explanation.fit.amounts, strict=True))
            amounts = np.array(
                [
                    amount if knob.name in taken else found[knob.name]
                    for knob, amount in zip(self.base.knobs, self.base.amounts, strict=True)
                ]
            )
            setting = turned(self.start, self.base.knobs, amounts)
            tried = replace(self.base, amounts=amounts, residuals=self.residuals(setting, self.base.residuals))
            if tried.value < least:
                least, begin = tried.value, amounts
        if begin is None:
            return None
        try:
            return fit(self.residuals, self.start, self.base.knobs, begin=begin, progress=self._progress)
        except DivergedError:
            return None

    def further(
        self, explanations: Sequence[Explanation], least: float, proven: Callable[[Explanation], float], unseen: bool
    ) -> list[Explanation]:
        """The best explanations by what is `proven` of them with one more effect each, where that promises `least` of
        what they leave: where it is left out, unless there are `unseen` recordings to prove it on."""
        found: dict[frozenset[str], tuple[float, Signature]] = {}
        promise = itemgetter(0)
        for explanation in sorted(explanations, key=proven, reverse=True)[:BEAM]:
            known = proven(explanation)
            if len(explanation.candidates) == MOST or known <= least:
                continue
            for signature in self._screened(explanation.fit, explanation.candidates, BEAM):
                adds = signature.gain - explanation.gain if unseen else signature.score - explanation.score
                if adds > least * max(1 - known, self.least_whole):
                    effects = frozenset(c.effect for c in signature.candidates)
                    promised = known + adds, signature
                    found[effects] = max(found.get(effects, promised), promised, key=promise)
        likeliest = sorted(found.values(), key=promise, reverse=True)[:BEAM]
        fitted = map(self.polished, self._fitted([signature for _, signature in likeliest]))
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def described(self) -> list[Explanation]:
        """Terms without known physics, fitted in full, best first."""
        every = terms(self.start.values)
        self._simulate_new(every)
        found = [self._signature(self.base, (), (term,)) for term in every]
        return self._fitted(sorted(found, key=lambda s: s.score, reverse=True)[:TRIED])

    def united(self, explanations: Sequence[Explanation]) -> list[Explanation]:
        """The first of the explanations with what each other one has besides: what they add to one another."""
        first, *others = explanations
        besides: dict[frozenset[str], tuple[Candidate, ...]] = {}
        for other in others:
            new = tuple(c for c in other.candidates if c.effect not in first.effects)
            besides.setdefault(frozenset(c.effect for c in new), new)
        likeliest = [new for new in besides.values() if new][:BEAM]
        fitted = self._fitted([self._signature(first.fit, first.candidates, new) for new in likeliest])
        return [self.polished(e) for e in fitted]

    def along_the_road(self, explanation: Explanation) -> Explanation | None:
        """An explanation that holds an effect of the road with one size for all places, with another size at every
        place, if that explains more. None without such an effect."""
        if id(explanation) not in self._along_the_road:
            self._along_the_road[id(explanation)] = explanation, self._freed(explanation)
        return self._along_the_road[id(explanation)][1]

    def _freed(self, explanation: Explanation) -> Explanation | None:
        profiles = {_first(c): c for c in self.offered if c.along_road}
        single = next((c for c in explanation.candidates if _first(c) in profiles), None)
        if single is None or any(c.along_road for c in explanation.candidates):
            return None
        profile, at = profiles[_first(single)], explanation.fit
        if not self._known_well:
            return None
        points = [knob for knob in profile.knobs if knob.place is not None]
        by_place = [self._at_place(self._column(profile.knobs[0]), point) for point in points]
        slopes = [np.column_stack(parts) * points[0].deviation for parts in zip(*by_place, strict=True)]
        fitted = self._fit(_joined(at, points, slopes))
        fitted = self._fit(replace(fitted, slopes=slopes_at(self.residuals, self.start, fitted, self._progress)))
        if at.value - fitted.value < WORTH * self.whole:
            return None
        candidates = (*(c for c in explanation.candidates if c is not single), profile)
        return self._with_shape(self._explanation(candidates, fitted, explanation.keep))

    def together(self, candidates: Sequence[Candidate]) -> list[Explanation]:
        """All candidates at once, without a search."""
        self._simulate_new(candidates)
        return self._fitted([self._signature(self.base, (), tuple(candidates))])

    def _screened(self, at: Fit, present: tuple[Candidate, ...], count: int) -> list[Signature]:
        """The likeliest candidates besides those present: `count` by what they gain, as many by what they gain where
        they are left out, and by what they gain elsewhere than where they promise most."""
        self._simulate_new(self.offered)
        names = {candidate.effect for candidate in present}
        found = [self._signature(at, present, (c,)) for c in self.offered if c.effect not in names]
        found = [s for s in found if s.keep > 0]
        single = [s for s in found if not s.candidates[-1].along_road]
        by_gain = sorted(single, key=lambda s: s.gain, reverse=True)[:count]
        by_score = sorted(single, key=lambda s: s.score, reverse=True)[:count]
        elsewhere = sorted((s for s in single if s.elsewhere > 0), key=lambda s: s.elsewhere, reverse=True)[:count]
        chosen = {s.candidates[-1].name: s for s in (*by_score, *by_gain, *elsewhere)}
        best = max((s.score for s in single), default=0.0)
        for free in (s for s in found if s.candidates[-1].along_road and self._may_vary(s.candidates[-1], present)):
            one = next((s for s in single if _first(s.candidates[-1]) == _first(free.candidates[-1])), None)
            known = max(one.score if one is not None else 0.0, self.of_several_cars)
            if free.score > max(known + WORTH, PROMISING * best):
                self._simulate(knob for knob in free.candidates[-1].knobs if knob.place is not None)
                free = self._signature(at, present, free.candidates[-1:])
                chosen |= {s.candidates[-1].name: s for s in (one, free) if s is not None}
        return list(chosen.values())

    def _may_vary(self, profile: Candidate, present: Sequence[Candidate]) -> bool:
        """Whether a size may be another at every place besides the candidates present: beside an effect, which is never
        quite right, it would mend everything, unless it was worth its freedom alone."""
        if any(candidate.along_road for candidate in present) or not self._known_well:
            return False
        return not present or profile.name in self._varying

    def _simulate(self, knobs: Iterable[Knob]) -> None:
        """Secants of the base fit."""
        every = {(knob.name, knob.form): knob for knob in knobs}
        secants = slopes_by(self.residuals, self.start, self.base, list(every.values()), SECANT)
        for (key, knob), secant in zip(every.items(), secants, strict=True):
            self._columns[key] = [part / knob.deviation for part in secant]
            self._progress()

    def _simulate_new(self, candidates: Iterable[Candidate]) -> None:
        """Of candidates that are met for the first time, without what `at_place` tells."""
        knobs = (knob for candidate in candidates for knob in candidate.knobs if knob.place is None)
        self._simulate(knob for knob in knobs if (knob.name, knob.form) not in self._columns)

    def _signature(self, at: Fit, present: tuple[Candidate, ...], new: tuple[Candidate, ...]) -> Signature:
        knobs = tuple(knob for candidate in new for knob in candidate.knobs)

        def joint() -> Fit:
            columns = [self._column(knob) for knob in knobs]
            slopes = [np.column_stack(c) * [knob.deviation for knob in knobs] for c in zip(*columns, strict=True)]
            return _joined(at, knobs, slopes)

        equations = self._joined_equations(at, knobs)
        free, change = _within_bounds(equations, knobs)
        falls = self.base.equations.values() - free.values(change)
        left_out = self._left_out_with((*present, *new))
        known = free if left_out.apart is as_it_is else left_out.apart(joint()).equations
        return Signature(
            (*present, *new), joint, equations.keeps(knobs), float(falls.sum()) / self.whole,
            left_out.gains(known, self.whole)[0], float(falls.sum() - falls.max()) / self.whole,
        )  # fmt: skip

    def _joined_equations(self, at: Fit, knobs: Sequence[Knob]) -> Equations:
        """The equations of `_joined`, of which those of the fit are known."""
        known, names = at.equations, {knob.name for knob in knobs}
        stay = [i for i, knob in enumerate(at.knobs) if knob.name not in names]
        present = dict(zip((knob.name for knob in at.knobs), at.amounts, strict=True))
        columns = [[part * knob.deviation for part in self._column(knob)] for knob in knobs]
        new = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        across = np.array([(s.T @ n)[stay] for s, n in zip(at.slopes, new, strict=True)])
        own = np.array([n.T @ n for n in new])
        rest = known.only(stay)
        return replace(
            rest,
            knobs=(*rest.knobs, *knobs),
            prior=np.append(rest.prior, [present.get(knob.name, 0.0) / knob.deviation for knob in knobs]),
            normal=np.block([[rest.normal, across], [across.transpose(0, 2, 1), own]]),
            right=np.hstack([rest.right, [n.T @ r for n, r in zip(new, at.residuals, strict=True)]]),
        )

    def _column(self, knob: Knob) -> list[Array]:
        """Secant per unit of a knob that was simulated, or of what `at_place` tells."""
        key = knob.name, knob.form
        if key not in self._columns and knob.place is not None:
            self._columns[key] = self._at_place(self._columns[knob.place[0], knob.form], knob)
        return self._columns[key]

    def _at_place(self, everywhere: Sequence[Array], knob: Knob) -> list[Array]:
        assert knob.place is not None
        return at_place(self.residuals, everywhere, knob.place[1])

    @cached_property
    def _in_pieces(self) -> bool:
        """Whether nothing but its pieces can prove the road."""
        return pieces_alone_tell(self.residuals.predictor.evidence)

    @cached_property
    def of_several_cars(self) -> float:
        """What base parameters of its own for each recording would gain, linearly, where a road of its own might stand
        in for them: nothing of a single recording, or of several on one road."""
        if not self._in_pieces:
            return 0.0
        equations = self.base.equations
        groups = self.residuals.predictor.evidence.places_by_recording()
        left = sum(float(equations.values(equations.change(group))[group].sum()) for group in groups)
        return (self.base.value - left) / self.whole

    @cached_property
    def _known_well(self) -> bool:
        """Whether another size at every place can be proven."""
        return not self._in_pieces or tells_its_pieces(self.residuals.predictor.evidence)

    def _left_out_with(self, candidates: Sequence[Candidate]) -> LeftOut:
        """What is left out of a fit with these candidates in turn."""
        if self._in_pieces and any(candidate.along_road for candidate in candidates):
            return self._pieces
        return self.left_out

    @cached_property
    def left_out(self) -> LeftOut:
        """What is left out in turn where no size is another at every place."""
        return (by_stretches if len(self.base.residuals) == 1 else by_windows)(self.residuals, self.base)

    @cached_property
    def _pieces(self) -> LeftOut:
        return by_pieces(self.residuals, self.base)

    def _fitted(self, signatures: Sequence[Signature]) -> list[Explanation]:
        found = [self._explanation(s.candidates, self._fit(s.joint()), s.keep) for s in signatures]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def polished(self, explanation: Explanation) -> Explanation:
        """The explanation fitted further with secants of its own: with those of the base fit, which an effect that is
        left out may have driven far off, it stops short."""
        if any(candidate.along_road for candidate in explanation.candidates):
            return explanation  # each place would cost a simulation
        at = explanation.fit
        if explanation.gain > WORTH_POLISHING:
            fitted = self._fit(replace(at, slopes=slopes_at(self.residuals, self.start, at, self._progress)))
            if fitted.value < at.value:
                explanation = self._explanation(explanation.candidates, fitted, explanation.keep)
        return self._on_the_road(explanation)

    def _on_the_road(self, explanation: Explanation) -> Explanation:
        """The explanation, fitted in full from the parameters of the vehicle file if its car gets lost: there it keeps
        the residuals of the base fit, and base parameters stay as they are bent to stand in for the effect."""
        at = explanation.fit
        lost = sum(self.residuals.predictor.lost(at.setting))
        if not lost:
            return explanation
        begin = np.array([explanation.sizes.get(knob.name, 0.0) for knob in at.knobs])
        found = fit(
            self.residuals, self.start, at.knobs, begin=begin, instead=self.base.residuals, progress=self._progress
        )
        if sum(self.residuals.predictor.lost(found.setting)) >= lost:
            return explanation
        return self._explanation(explanation.candidates, replace(found, weight=at.weight), explanation.keep)

    def settled(self, explanation: Explanation) -> Explanation:
        """The explanation with its sizes fitted once more, hardly drawn to zero any longer: what they cost has told the
        likely effects from the unlikely. What it gains is counted at the same costs as that of all others."""
        at, sizes = explanation.fit, explanation.sizes
        times = np.array(
            [
                max(1.0, FREED * abs(sizes[knob.name]) / knob.deviation) if knob.name in sizes else 1.0
                for knob in at.knobs
            ]
        )
        knobs = tuple(
            replace(knob, deviation=knob.deviation * factor) for knob, factor in zip(at.knobs, times, strict=True)
        )
        freed = replace(at, knobs=knobs, slopes=[s * times for s in at.slopes])
        fitted = self._fit(freed)
        at_same_costs = replace(fitted, knobs=at.knobs, slopes=at.slopes)
        return replace(
            self._explanation(explanation.candidates, at_same_costs, explanation.keep),
            deviations=self._deviations(explanation.candidates, fitted),
        )

    def _fit(self, joint: Fit) -> Fit:
        fitted = fit(self.residuals, self.start, joint.knobs, first=joint, instead=self.base.residuals)
        self._progress()
        return fitted

    def _explanation(self, candidates: tuple[Candidate, ...], fitted: Fit, keep: float) -> Explanation:
        falls = self.base.equations.values() - fitted.equations.values()
        gained, lost = np.sum(falls[falls > 0]), -np.sum(falls[falls < 0])
        left_out = self._left_out_with(candidates)
        gains_left_out = left_out.gains(left_out.apart(fitted).equations, self.whole)
        return Explanation(
            candidates, fitted, keep, (self.base.value - fitted.value) / self.whole, *gains_left_out,
            float(lost / max(gained, 1e-12)), self._deviations(candidates, fitted),
        )  # fmt: skip

    def _deviations(self, candidates: Sequence[Candidate], fitted: Fit) -> dict[str, float]:
        """Standard deviations of the knobs by name. Residuals of neighbouring instants err together: the spread between
        the parts of a fit says how much they tell, by a jackknife. What a size is everywhere that may be another at
        every place is known no better than all that shifts with it: sensors with an offset see the same, and only what
        is likely of them tells them apart."""
        equations = self._left_out_with(candidates).apart(fitted).equations
        n = len(equations.rows)
        changes = np.array([equations.change([i for i in range(n) if i != out]) for out in range(n)])
        spread = np.sqrt((n - 1) / n * np.sum((changes - changes.mean(axis=0)) ** 2, axis=0))
        everywhere = {c.knobs[0].name for c in candidates if c.along_road}
        unknown = np.array([knob.name in everywhere for knob in fitted.knobs])
        spread = np.hypot(spread, np.where(unknown, equations.spread(), 0.0))
        return {knob.name: float(s * knob.deviation) for knob, s in zip(fitted.knobs, spread, strict=True)}


def _first(candidate: Candidate) -> tuple[str, str]:
    """Name and form of its first size."""
    return candidate.knobs[0].name, candidate.knobs[0].form


def _worth_their_freedom(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Without the sizes that are another at every place and explain hardly more than one size does."""
    single: dict[tuple[str, ...], float] = {}
    for e in explanations:
        if not e.candidates[-1].along_road:
            single[e.effects] = max(e.score, single.get(e.effects, 0.0))
    return [e for e in explanations if not e.candidates[-1].along_road or e.score > single.get(e.effects, 0.0) + WORTH]


def at_place(residuals: Residuals, slopes: Sequence[Array], abscissa: float) -> list[Array]:
    """Slopes by a size at one place, if the car forgot at once: its slopes everywhere, times the share of the place."""
    found = []
    for window, names, everywhere in zip(residuals.predictor.evidence.windows, residuals.layout, slopes, strict=True):
        found.append(np.tile(profile({abscissa: 1.0}, places(window)), len(names)) * everywhere)
    return found


def _columns(slopes: Sequence[Array]) -> list[list[Array]]:
    """By knob, by window."""
    return [[window[:, i] for window in slopes] for i in range(slopes[0].shape[1])]


def _without(base: Fit, knobs: Sequence[Knob]) -> Fit:
    """The fit with some knobs no longer free to turn."""
    names = {knob.name for knob in knobs}
    stay = [i for i, knob in enumerate(base.knobs) if knob.name not in names]
    return replace(
        base,
        knobs=tuple(base.knobs[i] for i in stay),
        amounts=base.amounts[stay],
        slopes=[s[:, stay] for s in base.slopes],
    )


def _joined(base: Fit, knobs: Sequence[Knob], slopes: Sequence[Array]) -> Fit:
    """The base fit with further knobs, not turned yet. A knob that the base has with a smaller deviation, because every
    car has a little of it, may now be as large as an effect."""
    known = dict(zip((knob.name for knob in base.knobs), base.amounts, strict=True))
    rest = _without(base, knobs)
    return replace(
        rest,
        knobs=(*rest.knobs, *knobs),
        amounts=np.append(rest.amounts, [known.get(knob.name, 0.0) for knob in knobs]),
        slopes=[np.column_stack(pair) for pair in zip(rest.slopes, slopes, strict=True)],
    )


def _within_bounds(joint: Equations, knobs: Sequence[Knob]) -> tuple[Equations, Array]:
    """The equations without those of the knobs that are at a bound and would have to go beyond it, and the linear
    change of the others [deviations]."""
    asked = {knob.name for knob in knobs}
    while True:
        change = joint.change()
        beyond = {
            knob.name for knob, at, by in zip(joint.knobs, joint.prior, change, strict=True)
            if knob.name in asked
            and ((at <= knob.low / knob.deviation and by < 0) or (at >= knob.high / knob.deviation and by > 0))
        }  # fmt: skip
        if not beyond:
            return joint, change
        joint = joint.only([i for i, knob in enumerate(joint.knobs) if knob.name not in beyond])
