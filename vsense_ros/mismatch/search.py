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

from vsense_ros.mismatch.candidates import Candidate, FreeParameter, shapes, terms
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
from vsense_ros.mismatch.road import profile
from vsense_ros.mismatch.simulation import ParameterSet

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
    """What candidates would do to the residuals of a fit, and what of it cannot be had from the free parameters of that
    fit."""

    candidates: tuple[Candidate, ...]  # all of them, the last one is new
    # The fit with their free parameters besides, not turned yet: made anew each time, for those of all would take
    # gigabytes.
    joint: Callable[[], Fit]
    keep: float  # share of the signature that is left after the other free parameters have been fitted to it [-]
    gain: float  # relative fall of the base's value, linearly
    left_out: float  # the same of what was left out of the fit in turn
    # The gain without the window that promises most: where a car is at its limit, lines promise what no fit keeps.
    elsewhere: float

    @property
    def score(self) -> float:
        return min(self.gain, self.left_out)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Candidates fitted together with the base parameters; equal to itself alone, so that results can be told by it."""

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
        offsets = dict(zip((parameter.name for parameter in self.fit.free_parameters), self.fit.offsets, strict=True))
        return {
            parameter.name: float(offsets[parameter.name])
            for candidate in self.candidates
            for parameter in candidate.free_parameters
        }


class Search:
    """What explains that a fit leaves something over; secants are simulated once, at the base fit."""

    def __init__(
        self,
        residuals: Residuals,
        start: ParameterSet,
        base: Fit,
        offered: Sequence[Candidate],
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.residuals, self.start, self.base, self.offered = residuals, start, base, offered
        self._along_the_road: dict[int, tuple[Hypothesis, Hypothesis | None]] = {}  # by id of the first
        self._varying: set[str] = set()  # names of candidates with another size at every place that are worth it alone
        self._progress = progress
        # What gains are relative to: residuals below what sensors and models can do are no data set.
        least_whole = float(sum(len(r) for r in base.residuals))
        self.whole = max(base.value, least_whole)
        self.least_whole = least_whole / self.whole
        self._columns: dict[tuple[str, str], list[Array]] = {  # by name and form
            (parameter.name, parameter.form): [part / parameter.deviation for part in column]
            for parameter, column in zip(base.free_parameters, _columns(base.slopes), strict=True)
        }

    @cached_property
    def visible(self) -> frozenset[str]:
        """Ids of the effects that would change something that was recorded, at a likely size."""
        self._simulate_new(self.offered)
        return frozenset(
            c.effect for c in self.offered
            if any(np.abs(p).max(initial=0.0) * k.likely > TRACE for k in c.free_parameters for p in self._column(k))
        )  # fmt: skip

    def singles(self) -> list[Hypothesis]:
        """The likeliest candidates alone, fitted in full, best first."""
        found = self._shaped(_worth_their_freedom(self._fitted(self._screened(self.base, (), SHORTLIST))))
        self._varying = {e.candidates[-1].name for e in found if e.candidates[-1].along_road}
        return sorted(map(self.polished, found), key=lambda e: e.score, reverse=True)

    def _shaped(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The explanations, the best of them with their shapes fitted besides."""
        found = [*map(self._with_shape, hypotheses[:BEAM]), *hypotheses[BEAM:]]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def _with_shape(self, hypothesis: Hypothesis) -> Hypothesis:
        """The explanation with the shapes of its last effect fitted besides, if that has some and they can be seen."""
        at, free_parameters = hypothesis.fit, shapes(hypothesis.candidates[-1], self.start.values)
        if not free_parameters or hypothesis.gain < ENOUGH:
            return hypothesis
        columns = slopes_by(self.residuals, self.start, at, free_parameters)
        slopes = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        return self._explanation(
            hypothesis.candidates, self._fit(_joined(at, free_parameters, slopes)), hypothesis.keep
        )

    def better_base(self, hypotheses: Sequence[Hypothesis]) -> Fit | None:
        """The base parameters fitted anew from where they are in an explanation, if without its effect they fit better
        there than before: then the effect gained because the fit had stopped short."""
        least, begin = self.base.value - STUCK * self.whole, None
        for hypothesis in hypotheses:
            taken = {parameter.name for candidate in hypothesis.candidates for parameter in candidate.free_parameters}
            found = dict(
                zip(
                    (parameter.name for parameter in hypothesis.fit.free_parameters),
                    hypothesis.fit.offsets,
                    strict=True,
                )
            )
            offsets = np.array(
                [
                    offset if parameter.name in taken else found[parameter.name]
                    for parameter, offset in zip(self.base.free_parameters, self.base.offsets, strict=True)
                ]
            )
            parameter_set = turned(self.start, self.base.free_parameters, offsets)
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
        """The best explanations by what is `proven` of them with one more effect each, where that promises `least` of
        what they leave: where it is left out, unless there are `unseen` recordings to prove it on."""
        found: dict[frozenset[str], tuple[float, Signature]] = {}
        promise = itemgetter(0)
        for hypothesis in sorted(hypotheses, key=proven, reverse=True)[:BEAM]:
            known = proven(hypothesis)
            if len(hypothesis.candidates) == MOST or known <= least:
                continue
            for signature in self._screened(hypothesis.fit, hypothesis.candidates, BEAM):
                adds = signature.gain - hypothesis.gain if unseen else signature.score - hypothesis.score
                if adds > least * max(1 - known, self.least_whole):
                    effects = frozenset(c.effect for c in signature.candidates)
                    promised = known + adds, signature
                    found[effects] = max(found.get(effects, promised), promised, key=promise)
        likeliest = sorted(found.values(), key=promise, reverse=True)[:BEAM]
        fitted = map(self.polished, self._fitted([signature for _, signature in likeliest]))
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def described(self) -> list[Hypothesis]:
        """Terms without known physics, fitted in full, best first."""
        every = terms(self.start.values)
        self._simulate_new(every)
        found = [self._signature(self.base, (), (term,)) for term in every]
        return self._fitted(sorted(found, key=lambda s: s.score, reverse=True)[:TRIED])

    def united(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The first of the explanations with what each other one has besides: what they add to one another."""
        first, *others = hypotheses
        besides: dict[frozenset[str], tuple[Candidate, ...]] = {}
        for other in others:
            new = tuple(c for c in other.candidates if c.effect not in first.effects)
            besides.setdefault(frozenset(c.effect for c in new), new)
        likeliest = [new for new in besides.values() if new][:BEAM]
        fitted = self._fitted([self._signature(first.fit, first.candidates, new) for new in likeliest])
        return [self.polished(e) for e in fitted]

    def along_the_road(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """An explanation that holds an effect of the road with one size for all places, with another size at every
        place, if that explains more. None without such an effect."""
        if id(hypothesis) not in self._along_the_road:
            self._along_the_road[id(hypothesis)] = hypothesis, self._freed(hypothesis)
        return self._along_the_road[id(hypothesis)][1]

    def _freed(self, hypothesis: Hypothesis) -> Hypothesis | None:
        profiles = {_first(c): c for c in self.offered if c.along_road}
        single = next((c for c in hypothesis.candidates if _first(c) in profiles), None)
        if single is None or any(c.along_road for c in hypothesis.candidates):
            return None
        profile, at = profiles[_first(single)], hypothesis.fit
        if not self._known_well:
            return None
        points = [parameter for parameter in profile.free_parameters if parameter.place is not None]
        by_place = [self._at_place(self._column(profile.free_parameters[0]), point) for point in points]
        slopes = [np.column_stack(parts) * points[0].deviation for parts in zip(*by_place, strict=True)]
        fitted = self._fit(_joined(at, points, slopes))
        fitted = self._fit(replace(fitted, slopes=slopes_at(self.residuals, self.start, fitted, self._progress)))
        if at.value - fitted.value < WORTH * self.whole:
            return None
        candidates = (*(c for c in hypothesis.candidates if c is not single), profile)
        return self._with_shape(self._explanation(candidates, fitted, hypothesis.keep))

    def together(self, candidates: Sequence[Candidate]) -> list[Hypothesis]:
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
                self._simulate(
                    parameter for parameter in free.candidates[-1].free_parameters if parameter.place is not None
                )
                free = self._signature(at, present, free.candidates[-1:])
                chosen |= {s.candidates[-1].name: s for s in (one, free) if s is not None}
        return list(chosen.values())

    def _may_vary(self, profile: Candidate, present: Sequence[Candidate]) -> bool:
        """Whether a size may be another at every place besides the candidates present: beside an effect, which is never
        quite right, it would mend everything, unless it was worth its freedom alone."""
        if any(candidate.along_road for candidate in present) or not self._known_well:
            return False
        return not present or profile.name in self._varying

    def _simulate(self, free_parameters: Iterable[FreeParameter]) -> None:
        """Secants of the base fit."""
        every = {(parameter.name, parameter.form): parameter for parameter in free_parameters}
        secants = slopes_by(self.residuals, self.start, self.base, list(every.values()), SECANT)
        for (key, parameter), secant in zip(every.items(), secants, strict=True):
            self._columns[key] = [part / parameter.deviation for part in secant]
            self._progress()

    def _simulate_new(self, candidates: Iterable[Candidate]) -> None:
        """Of candidates that are met for the first time, without what `at_place` tells."""
        free_parameters = (
            parameter for candidate in candidates for parameter in candidate.free_parameters if parameter.place is None
        )
        self._simulate(
            parameter for parameter in free_parameters if (parameter.name, parameter.form) not in self._columns
        )

    def _signature(self, at: Fit, present: tuple[Candidate, ...], new: tuple[Candidate, ...]) -> Signature:
        free_parameters = tuple(parameter for candidate in new for parameter in candidate.free_parameters)

        def joint() -> Fit:
            columns = [self._column(parameter) for parameter in free_parameters]
            slopes = [
                np.column_stack(c) * [parameter.deviation for parameter in free_parameters]
                for c in zip(*columns, strict=True)
            ]
            return _joined(at, free_parameters, slopes)

        equations = self._joined_equations(at, free_parameters)
        free, change = _within_bounds(equations, free_parameters)
        falls = self.base.equations.values() - free.values(change)
        left_out = self._left_out_with((*present, *new))
        known = free if left_out.apart is as_it_is else left_out.apart(joint()).equations
        return Signature(
            (*present, *new), joint, equations.keeps(free_parameters), float(falls.sum()) / self.whole,
            left_out.gains(known, self.whole)[0], float(falls.sum() - falls.max()) / self.whole,
        )  # fmt: skip

    def _joined_equations(self, at: Fit, free_parameters: Sequence[FreeParameter]) -> Equations:
        """The equations of `_joined`, of which those of the fit are known."""
        known, names = at.equations, {parameter.name for parameter in free_parameters}
        stay = [i for i, parameter in enumerate(at.free_parameters) if parameter.name not in names]
        present = dict(zip((parameter.name for parameter in at.free_parameters), at.offsets, strict=True))
        columns = [[part * parameter.deviation for part in self._column(parameter)] for parameter in free_parameters]
        new = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
        across = np.array([(s.T @ n)[stay] for s, n in zip(at.slopes, new, strict=True)])
        own = np.array([n.T @ n for n in new])
        rest = known.only(stay)
        return replace(
            rest,
            free_parameters=(*rest.free_parameters, *free_parameters),
            prior=np.append(
                rest.prior, [present.get(parameter.name, 0.0) / parameter.deviation for parameter in free_parameters]
            ),
            normal=np.block([[rest.normal, across], [across.transpose(0, 2, 1), own]]),
            right=np.hstack([rest.right, [n.T @ r for n, r in zip(new, at.residuals, strict=True)]]),
        )

    def _column(self, parameter: FreeParameter) -> list[Array]:
        """Secant per unit of a free parameter that was simulated, or of what `at_place` tells."""
        key = parameter.name, parameter.form
        if key not in self._columns and parameter.place is not None:
            self._columns[key] = self._at_place(self._columns[parameter.place[0], parameter.form], parameter)
        return self._columns[key]

    def _at_place(self, everywhere: Sequence[Array], parameter: FreeParameter) -> list[Array]:
        assert parameter.place is not None
        return at_place(self.residuals, everywhere, parameter.place[1])

    @cached_property
    def _in_pieces(self) -> bool:
        """Whether nothing but its pieces can prove the road."""
        return pieces_alone_tell(self.residuals.predictor.dataset)

    @cached_property
    def of_several_cars(self) -> float:
        """What base parameters of its own for each recording would gain, linearly, where a road of its own might stand
        in for them: nothing of a single recording, or of several on one road."""
        if not self._in_pieces:
            return 0.0
        equations = self.base.equations
        groups = self.residuals.predictor.dataset.places_by_recording()
        left = sum(float(equations.values(equations.change(group))[group].sum()) for group in groups)
        return (self.base.value - left) / self.whole

    @cached_property
    def _known_well(self) -> bool:
        """Whether another size at every place can be proven."""
        return not self._in_pieces or tells_its_pieces(self.residuals.predictor.dataset)

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

    def _fitted(self, signatures: Sequence[Signature]) -> list[Hypothesis]:
        found = [self._explanation(s.candidates, self._fit(s.joint()), s.keep) for s in signatures]
        return sorted(found, key=lambda e: e.score, reverse=True)

    def polished(self, hypothesis: Hypothesis) -> Hypothesis:
        """The explanation fitted further with secants of its own: with those of the base fit, which an effect that is
        left out may have driven far off, it stops short."""
        if any(candidate.along_road for candidate in hypothesis.candidates):
            return hypothesis  # each place would cost a simulation
        at = hypothesis.fit
        if hypothesis.gain > WORTH_POLISHING:
            fitted = self._fit(replace(at, slopes=slopes_at(self.residuals, self.start, at, self._progress)))
            if fitted.value < at.value:
                hypothesis = self._explanation(hypothesis.candidates, fitted, hypothesis.keep)
        return self._on_the_road(hypothesis)

    def _on_the_road(self, hypothesis: Hypothesis) -> Hypothesis:
        """The explanation, fitted in full from the parameters of the vehicle file if its car gets lost: there it keeps
        the residuals of the base fit, and base parameters stay as they are bent to stand in for the effect."""
        at = hypothesis.fit
        lost = sum(self.residuals.predictor.lost(at.parameter_set))
        if not lost:
            return hypothesis
        begin = np.array([hypothesis.sizes.get(parameter.name, 0.0) for parameter in at.free_parameters])
        found = fit(
            self.residuals,
            self.start,
            at.free_parameters,
            begin=begin,
            instead=self.base.residuals,
            progress=self._progress,
        )
        if sum(self.residuals.predictor.lost(found.parameter_set)) >= lost:
            return hypothesis
        return self._explanation(hypothesis.candidates, replace(found, weight=at.weight), hypothesis.keep)

    def settled(self, hypothesis: Hypothesis) -> Hypothesis:
        """The explanation with its sizes fitted once more, hardly drawn to zero any longer: what they cost has told the
        likely effects from the unlikely. What it gains is counted at the same costs as that of all others."""
        at, sizes = hypothesis.fit, hypothesis.sizes
        times = np.array(
            [
                max(1.0, FREED * abs(sizes[parameter.name]) / parameter.deviation) if parameter.name in sizes else 1.0
                for parameter in at.free_parameters
            ]
        )
        free_parameters = tuple(
            replace(parameter, deviation=parameter.deviation * factor)
            for parameter, factor in zip(at.free_parameters, times, strict=True)
        )
        freed = replace(at, free_parameters=free_parameters, slopes=[s * times for s in at.slopes])
        fitted = self._fit(freed)
        at_same_costs = replace(fitted, free_parameters=at.free_parameters, slopes=at.slopes)
        return replace(
            self._explanation(hypothesis.candidates, at_same_costs, hypothesis.keep),
            deviations=self._deviations(hypothesis.candidates, fitted),
        )

    def _fit(self, joint: Fit) -> Fit:
        fitted = fit(self.residuals, self.start, joint.free_parameters, first=joint, instead=self.base.residuals)
        self._progress()
        return fitted

    def _explanation(self, candidates: tuple[Candidate, ...], fitted: Fit, keep: float) -> Hypothesis:
        falls = self.base.equations.values() - fitted.equations.values()
        gained, lost = np.sum(falls[falls > 0]), -np.sum(falls[falls < 0])
        left_out = self._left_out_with(candidates)
        gains_left_out = left_out.gains(left_out.apart(fitted).equations, self.whole)
        return Hypothesis(
            candidates, fitted, keep, (self.base.value - fitted.value) / self.whole, *gains_left_out,
            float(lost / max(gained, 1e-12)), self._deviations(candidates, fitted),
        )  # fmt: skip

    def _deviations(self, candidates: Sequence[Candidate], fitted: Fit) -> dict[str, float]:
        """Standard deviations of the free parameters by name. Residuals of neighbouring instants err together: the
        spread between the parts of a fit says how much they tell, by a jackknife. What a size is everywhere that may be
        another at every place is known no better than all that shifts with it: sensors with an offset see the same, and
        only what is likely of them tells them apart."""
        equations = self._left_out_with(candidates).apart(fitted).equations
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


def _first(candidate: Candidate) -> tuple[str, str]:
    """Name and form of its first size."""
    return candidate.free_parameters[0].name, candidate.free_parameters[0].form


def _worth_their_freedom(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Without the sizes that are another at every place and explain hardly more than one size does."""
    single: dict[tuple[str, ...], float] = {}
    for e in hypotheses:
        if not e.candidates[-1].along_road:
            single[e.effects] = max(e.score, single.get(e.effects, 0.0))
    return [e for e in hypotheses if not e.candidates[-1].along_road or e.score > single.get(e.effects, 0.0) + WORTH]


def at_place(residuals: Residuals, slopes: Sequence[Array], abscissa: float) -> list[Array]:
    """Slopes by a size at one place, if the car forgot at once: its slopes everywhere, times the share of the place."""
    found = []
    for window, names, everywhere in zip(residuals.predictor.dataset.windows, residuals.layout, slopes, strict=True):
        found.append(np.tile(profile({abscissa: 1.0}, places(window)), len(names)) * everywhere)
    return found


def _columns(slopes: Sequence[Array]) -> list[list[Array]]:
    """By free parameter, by window."""
    return [[window[:, i] for window in slopes] for i in range(slopes[0].shape[1])]


def _without(base: Fit, free_parameters: Sequence[FreeParameter]) -> Fit:
    """The fit with some free parameters no longer free to turn."""
    names = {parameter.name for parameter in free_parameters}
    stay = [i for i, parameter in enumerate(base.free_parameters) if parameter.name not in names]
    return replace(
        base,
        free_parameters=tuple(base.free_parameters[i] for i in stay),
        offsets=base.offsets[stay],
        slopes=[s[:, stay] for s in base.slopes],
    )


def _joined(base: Fit, free_parameters: Sequence[FreeParameter], slopes: Sequence[Array]) -> Fit:
    """The base fit with further free parameters, not turned yet. A free parameter that the base has with a smaller
    deviation, because every car has a little of it, may now be as large as an effect."""
    known = dict(zip((parameter.name for parameter in base.free_parameters), base.offsets, strict=True))
    rest = _without(base, free_parameters)
    return replace(
        rest,
        free_parameters=(*rest.free_parameters, *free_parameters),
        offsets=np.append(rest.offsets, [known.get(parameter.name, 0.0) for parameter in free_parameters]),
        slopes=[np.column_stack(pair) for pair in zip(rest.slopes, slopes, strict=True)],
    )


def _within_bounds(joint: Equations, free_parameters: Sequence[FreeParameter]) -> tuple[Equations, Array]:
    """The equations without those of the free parameters that are at a bound and would have to go beyond it, and the
    linear change of the others [deviations]."""
    asked = {parameter.name for parameter in free_parameters}
    while True:
        change = joint.change()
        beyond = {
            parameter.name for parameter, at, by in zip(joint.free_parameters, joint.prior, change, strict=True)
            if parameter.name in asked
            and (
                (at <= parameter.low / parameter.deviation and by < 0)
                or (at >= parameter.high / parameter.deviation and by > 0)
            )
        }  # fmt: skip
        if not beyond:
            return joint, change
        joint = joint.only([i for i, parameter in enumerate(joint.free_parameters) if parameter.name not in beyond])
