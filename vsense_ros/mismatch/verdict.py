"""What may be said of explanations: whether one is proven, which others are within its reach, and what is unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identify.free_parameter import FreeParameter
from vsense_ros.identify.least_squares import DivergedError, Fit, Settings, cost, fit
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.cross_validation import passed, tells_its_pieces
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.road_prediction import Survey, survey
from vsense_ros.mismatch.search import Hypothesis
from vsense_ros.mismatch.simulation import LOST, Predictor
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import RoadEffect
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

THRESHOLD = 0.03  # least gain of an effect that recordings with nothing hidden do not give
# [s] of driving, of less of which more gain is asked for, in inverse proportion: of single manoeuvres of ten and twenty
# seconds with nothing hidden chance explains up to 1 s over their duration, two effects together 1.7 s (public split,
# `python -m blind --kind nothing alone`); this asks for 2.4 s.
SHORT = 80.0
# Share of a signature that stays when the base parameters are fitted to it, below which more gain is asked for: where
# they take up most of an effect, a tyre formula that is a little different takes up as much of another. Not more than
# this multiple: with nothing hidden no such effect has explained as much (public split).
OWN, ASKED_AT_MOST = 0.3, 1.5
# Least share that one more effect explains of what another leaves, but not of less than a good model does: the first
# where a signal is still off, because what an imperfect effect leaves looks like others; the second, in multiples of
# the least gain, where no other explains half as much.
FURTHER, CLEAR = 0.2, 4 / 3
# Least that it explains, over what is explained without it: an effect whose form is a tenth off on the real car
# leaves a hundredth of what it explains.
FORM = 0.01
DESCRIBED = 0.05  # least gain of a term without known physics: there are many of them
# Least that it explains besides, over what proven physics does: one of the same form gains a little as it is not drawn
# to the same size.
DISPLACED = 0.1
CERTAIN_SIZE = 1.28  # standard deviations that a size is away from zero: zero is outside its one-sided 90 % interval
NEGLIGIBLE = 0.2  # of a likely size, below which an effect that seems to explain something is not worth telling
LASTING = 1 / 3  # least share of the gain in training that an effect has where it was not fitted
# Most that it may spoil in windows that fit worse with it, over what it gains in the others: there may be few of these,
# where an effect shows in some manoeuvres alone. Effects that are there stay well below, what was refused above (public
# split and the seventh release).
SPOILT = 0.2
# Another explanation is as good with this share of the best one's gain beyond what they share, if it leaves no more of
# the cost than this multiple of what the best one leaves.
RIVAL, RIVAL_LEFT = 0.65, 1.5
# Where two are fitted together, most that one may add to the other, over what that adds to it, to be excluded by it:
# what is not there explains nothing that what is there does not.
SURPASSED = 0.25
SURE = 0.7  # share of the gain of several effects that those of them have alone about which nothing else is in doubt
LEFT_OVER = 2.0  # root mean square of all residuals after an effect, in deviations, with which it is not what lacks
# The same of the worst signal: something is left over, and a further effect is worth while. Where nothing is hidden,
# it is 0.89 at most in rich manoeuvres (20 cars of the public split) and 1.48 on everyday drives (6).
ASTRAY = 1.75
MENDED = 2 / 3  # most that an effect may leave of the worst signal's error if that stays further off than ASTRAY
# Most that signals and recordings may disagree in an effect: what its own size in each of them would gain besides, over
# what it gains. Where much would be gained again, it only resembles what is there. Effects that are there come near to
# it from below, and what looks like them from above (public split): the gap is thin.
AT_ODDS = 0.63
# Root mean square, in deviations, of a change that a signal does not tell: no multiple of it is data set.
UNTOLD = 0.1
MIGHT_BE_ZERO = "its size might as well be zero"
OUTDONE = "a term without known physics explains clearly more"
ANOTHER_ROAD = (
    "what was held out is of another road, and too short or too level to tell of this one; it may join what is fitted"
)
DISAGREED = "signals and recordings disagree in its size"
MANY = 4  # windows, of which one may disagree
REMARKABLE = 0.05  # by which a gain is smaller with that one, from where on a remark tells it
JOINT = 3  # iterations of a fit to all recordings, from where the base fit is
COMPARED = 0.5  # least share of what was held out that must be left to compare, where the explained car gets lost


# How probable it is that a name of the answer is right, from the public split of the examination by
# `python -m blind calibrate`: of answers whose lead is clear this share, the rest being physics outside the library
# that looks like an effect of it; and less by the logarithm of the lead. Of effects that the judge refuses, hardly any
# is there.
TRUSTED, BY_LEAD, REFUSED = 0.89, 8.0, 0.04
# Standard deviation of a size, relative, by what tyres and sensors of other cars have and the model has not: windows
# agree in it, so that their spread does not show it. How many intervals hold with it, the same command tells.
SIZE_OFF = 0.12
NORMAL_90 = 1.645  # standard deviations to either side that hold 90 % of a normal distribution


def least_gain(driven: float) -> float:
    """Of an effect, of so much driving [s]."""
    return THRESHOLD * max(1.0, SHORT / driven)


def confidence(gain: float, other: float) -> float:
    """How probable it is that an effect of the answer is there which explains `gain`, where the best that goes without
    it explains `other`."""
    lead = np.log(max(gain, 1e-3) / max(other, THRESHOLD))
    return float(TRUSTED / (1 + np.exp(-BY_LEAD * lead)))


def interval(value: float, spread: float) -> tuple[float, float]:
    """The 90 % interval of a size that windows agree in to a standard deviation of `spread`."""
    half = NORMAL_90 * float(np.hypot(spread, SIZE_OFF * value))
    return value - half, value + half


class Proof:
    """Recordings that no fit has seen."""

    def __init__(
        self,
        dataset: Dataset,
        vehicle: Vehicle,
        residuals: Residuals,
        base: Fit,
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.residuals: Residuals | None = None
        self._progress = progress
        self.base, self.fitted = base, residuals
        self._surveys: dict[int, tuple[Fit, Survey]] = {}  # by id of the fit
        # By ids of what was simulated and of the fit, which stays its own.
        self._compared: dict[tuple[int, int], tuple[Fit, list[Array], list[Array]]] = {}
        if dataset.windows:
            dataset = dataset.without(Predictor(vehicle, dataset).lost(base.parameter_set), LOST)
        self.remarks = dataset.remarks
        self.recordings = [windows[0].name for windows in dataset.by_recording()]  # that prove something
        if dataset.windows:
            self.residuals = Residuals(Predictor(vehicle, dataset))
            self.residuals.deviation |= residuals.deviation
            self.before = self.residuals(base.parameter_set)

    def compared(self, fitted: Fit) -> tuple[list[Array], list[Array]]:
        """Residuals of the base fit and of one with effects on what no fit has seen, simulated once: in each window
        until the car gets lost. If that leaves little, or nothing can be said of the fit, until the end, with those of
        the base fit from there on. What is on a road that no fit has seen is compared as its other pieces tell it."""
        assert self.residuals is not None
        if (there := self._survey(fitted)) is not None:
            return self.before, there.foretold(self.before)
        return self._until_lost(self.residuals, self.before, fitted)

    def simulated(self, fitted: Fit) -> list[dict[str, Array]]:
        """Signals of each window that no fit has seen, as they are compared."""
        assert self.residuals is not None
        there = self._survey(fitted)
        return there.simulated() if there is not None else self.residuals.predictor.simulated(fitted.parameter_set)

    def surveyed(self, fitted: Fit) -> bool:
        """Whether a fit has found a road and what it has not seen is of another, which is told by its pieces there."""
        return self._survey(fitted) is not None

    def _survey(self, fitted: Fit) -> Survey | None:
        if (
            self.residuals is None
            or not self.on_another_road
            or not any(parameter.place for parameter in fitted.free_parameters)
        ):
            return None
        if not tells_its_pieces(self.residuals.predictor.dataset):
            return None
        if id(fitted) not in self._surveys:
            self._surveys[id(fitted)] = fitted, survey(self.residuals, self.before, fitted)
        return self._surveys[id(fitted)][1]

    def trained(self, fitted: Fit) -> tuple[list[Array], list[Array]]:
        """The same on what was fitted."""
        return self._until_lost(self.fitted, self.base.residuals, fitted)

    def _until_lost(self, residuals: Residuals, whole: list[Array], fitted: Fit) -> tuple[list[Array], list[Array]]:
        """`compared` on what these residuals are of; `whole` are those of the base fit."""
        key = id(residuals), id(fitted)
        if key not in self._compared:
            until = residuals.predictor.lost_from(fitted.parameter_set)
            before = whole if np.isinf(until).all() else residuals.compared(self.base.parameter_set, until)
            after = residuals.compared(fitted.parameter_set, until)
            if sum(map(len, before)) < COMPARED * sum(map(len, whole)):
                before, after = whole, residuals(fitted.parameter_set, whole)
            self._compared[key] = fitted, before, after
        return self._compared[key][1:]

    def lost(self, fitted: Fit) -> list[str]:
        """Remarks on windows that say nothing of a setting, or not to their end."""
        return [
            f"{w.name}: from {lost:.0f} to {w.end:.0f} s what was found is not judged: {LOST}"
            for predictor in (r.predictor for r in (self.fitted, self.residuals) if r is not None)
            for w, lost in zip(predictor.dataset.windows, predictor.lost_from(fitted.parameter_set), strict=True)
            if np.isfinite(lost)
        ]

    def gain(self, hypothesis: Hypothesis) -> float | None:
        """Relative fall of what is minimised. None without held-out recordings."""
        return None if self.residuals is None else float(self._gains(hypothesis)[0])

    def lasting(self, hypothesis: Hypothesis) -> float:
        """What it gains where it was not fitted."""
        unseen = self.gain(hypothesis)
        return hypothesis.cv_gain if unseen is None else unseen

    def gain_of_most(self, hypothesis: Hypothesis) -> float | None:
        """The same without the one window of many that speaks most against it: at its limit a car goes other ways for a
        small difference."""
        return None if self.residuals is None else float(np.max(self._gains(hypothesis)))

    def against(self, hypothesis: Hypothesis) -> str:
        """A remark on the window without which the gain is clearly higher, if there is one."""
        if self.residuals is None:
            return ""
        whole, *rest = self._gains(hypothesis)
        if not rest or max(rest) < whole + REMARKABLE:
            return ""
        window = self.residuals.predictor.dataset.windows[int(np.argmax(rest))]
        return (
            f"{window.name}: from {window.begin:.0f} to {window.end:.0f} s speaks most against what was found (a car "
            f"at its limit goes other ways for a small difference); without that stretch {100 * max(rest):.0f} % of "
            "what was held out would be explained"
        )

    def _gains(self, hypothesis: Hypothesis) -> Array:
        """Of all windows, then of all but each if they are many; (1,) or (1 + windows,)."""
        before, after = self.compared(hypothesis.fit)
        rows = np.array([len(r) for r in after])
        share = rows / sum(len(r) for r in self.base.residuals)  # of what was fitted
        value = np.array([cost([r]) for r in before]) + share * self.base.prior_cost
        left = np.array([cost([r]) for r in after]) + share * hypothesis.fit.prior_cost
        windows = np.array([value, left, rows])
        sums = np.sum(windows, axis=1, keepdims=True)
        if np.sum(rows > 0) >= MANY:
            sums = np.hstack([sums, sums - windows])
        return np.asarray((sums[0] - sums[1]) / np.maximum(np.maximum(sums[0], sums[2]), 1.0))

    def proven(self, hypothesis: Hypothesis) -> float:
        """The smaller of what it gains where it was fitted and where it was not."""
        return _proven(hypothesis, {id(hypothesis): self.gain_of_most(hypothesis)})

    def at_odds(self, hypothesis: Hypothesis, known: Hypothesis | None = None) -> float:
        """How little windows and signals agree in what an explanation changes in the base fit, or in that of a `known`
        one: what would be gained besides if each signal of each window had its own multiple of the change, over what is
        gained. What a car has is the same everywhere; what looks like it is not.

        One of many windows is left out, that which agrees least: at its limit a car goes other ways for a small
        difference. What it would cost that free parameters are not where they were expected is gained as well: the base
        fit has turned some of them to stand in for what is missing.
        """
        at = self.base if known is None else known.fit
        found = _resized(at.residuals, hypothesis.fit.residuals, self.fitted.layout)
        compared = 1.0  # of what was fitted
        if self.residuals is not None:
            before, after = self.compared(hypothesis.fit)
            before = before if known is None else self.compared(known.fit)[1]
            found += _resized(before, after, self.residuals.layout)
            compared += self._share(hypothesis.fit, after)
        windows = np.array(found).reshape(-1, 2)
        whole = windows.sum(axis=0) + np.array([0.0, compared * (at.prior_cost - hypothesis.fit.prior_cost)])
        besides, gained = (whole - (windows if len(windows) >= MANY else np.zeros((1, 2)))).T
        return float(np.min(besides / np.maximum(gained, 1e-12)))

    def _share(self, fitted: Fit, found: list[Array]) -> float:
        """How much was `found` over what was fitted."""
        return sum(len(r) for r in found) / sum(len(r) for r in fitted.residuals)

    @cached_property
    def on_another_road(self) -> bool:
        """Whether most of the road of what no fit has seen is not that of what was fitted."""
        if self.residuals is None:
            return False
        both = (self.fitted.predictor.dataset.windows, self.residuals.predictor.dataset.windows)
        fitted, unseen = (set[float]().union(*map(passed, windows)) for windows in both)
        return 2 * len(fitted & unseen) < len(unseen)

    def astray(self) -> bool:
        """Whether more is left over than a good model leaves, or the fitted car gets lost on its own recordings."""
        return self.worst > ASTRAY or bool(self.fitted.predictor.dataset.dropped)

    @cached_property
    def worst(self) -> float:
        """Of the base fit the signal that is furthest from a good model, there or here, in deviations.

        Where only what no fit has seen is far off, of a fit to both, if that is better: at its limit a car goes other
        ways with base parameters that are a little different, and where some fit both, no physics is missing.
        """
        here = self.fitted.worst(self.base.residuals)
        there = self.residuals.worst(self.before) if self.residuals is not None else 0.0
        return max(here, there) if self._worst_of_both is None else min(there, self._worst_of_both)

    @property
    def fits_together(self) -> bool:
        """Whether what no fit has seen is far off for the base fit, but not for base parameters fitted to all."""
        return self._worst_of_both is not None and self._worst_of_both <= ASTRAY

    @cached_property
    def _worst_of_both(self) -> float | None:
        """`worst` of base parameters fitted to all recordings; None unless only what no fit has seen is off."""
        if self.residuals is None or not (
            self.residuals.worst(self.before) > ASTRAY >= self.fitted.worst(self.base.residuals)
        ):
            return None
        dataset = self.fitted.predictor.dataset
        whole = dataset.joined(self.residuals.predictor.dataset)
        residuals = Residuals(Predictor(self.fitted.predictor.vehicle, whole))
        residuals.deviation |= self.fitted.deviation
        start = self.fitted.predictor.start
        try:
            found = fit(
                residuals,
                start,
                self.base.free_parameters,
                begin=self.base.offsets,
                settings=Settings(iterations=JOINT),
                progress=self._progress,
            ).residuals
        except DivergedError:
            return np.inf
        count = len(dataset.windows)
        return max(self.fitted.worst(found[:count]), self.residuals.worst(found[count:]))

    def unmended(self, hypothesis: Hypothesis) -> str:
        """The signal that is furthest from a good model, unless it comes near one or at least much closer, where it is:
        in training or on what the fit has not seen. Nothing where every signal is near: there the effect gains by what
        base parameters need no longer stand in for."""
        if self.worst <= ASTRAY:
            return ""
        residuals = self.fitted
        before, after = self.trained(hypothesis.fit)
        if self.residuals is not None:
            unseen = self.compared(hypothesis.fit)
            if self.residuals.worst(unseen[0]) > residuals.worst(before):
                residuals, (before, after) = self.residuals, unseen
        worst, off = residuals.furthest(before)
        left = residuals.deviations(after)[worst] / residuals.deviations(before)[worst]
        return "" if left < max(min(1.0, ASTRAY / off), MENDED) else worst


@dataclass(frozen=True)
class Judged:
    """A verdict and what it rests on."""

    verdict: str
    leader: Hypothesis | None  # what explains most, if it is proven; a term where the physics is unknown
    rivals: tuple[Hypothesis, ...]  # the leader, and what is within its reach
    ranked: tuple[Hypothesis, ...]  # single effects, each at its best place, best first
    hypotheses: tuple[Hypothesis, ...]  # all that were fitted, of known physics
    held_out: dict[int, float | None]  # gains of most windows by id of the explanation
    refused: dict[int, str]  # what speaks against each of those ranked, by its id; empty where nothing does
    besides: tuple[str, ...] = ()  # ids of effects of which one may be there as well, nobody knows which
    in_doubt: tuple[Hypothesis, ...] = ()  # between which to choose, the best first; what they share may be sure

    def led_by(self, leader: Hypothesis, proof: Proof) -> Judged:
        """The same verdict with the leader fitted further."""
        return replace(
            self, leader=leader, rivals=(leader, *self.rivals[1:]) if self.rivals else (),
            held_out=self.held_out | {id(leader): proof.gain_of_most(leader)},
        )  # fmt: skip

    def confidence(self, hypothesis: Hypothesis, effect: str) -> float:
        """That an effect of an explanation is there: how far what it gains beyond the other effects of the explanation
        leads what any other effect would; next to nothing where the judge refused it."""
        rest = set(hypothesis.effects) - {effect}
        known = self._most(e for e in self.hypotheses if set(e.effects) == rest)
        others = (
            e for e in self.hypotheses
            if effect not in e.effects and rest < set(e.effects) and len(e.effects) == len(hypothesis.effects)
        )  # fmt: skip
        found = confidence(_proven(hypothesis, self.held_out) - known, self._most(others) - known)
        answer = {one for e in self.rivals for one in e.effects} | set(self.besides)
        return found if effect in answer else min(found, REFUSED)

    def other_places(self) -> tuple[str, ...]:
        """Where else the only effect of the leader would explain about as much, besides where it explains most."""
        if self.leader is None or len(self.leader.candidates) > 1:
            return ()
        own = {parameter.name for parameter in self.leader.candidates[0].free_parameters}
        most = _proven(self.leader, self.held_out)
        return tuple(
            e.candidates[0].where for e in self.hypotheses
            if e.effects == self.leader.effects
            and own.isdisjoint(parameter.name for parameter in e.candidates[0].free_parameters)
            and _as_good(_proven(e, self.held_out), most)
        )  # fmt: skip

    def adds(self, hypothesis: Hypothesis) -> float | None:
        """What an explanation gains besides the leader, where the two were fitted together."""
        if self.leader is None or set(hypothesis.effects) <= set(self.leader.effects):
            return None
        both = {*self.leader.effects, *hypothesis.effects}
        united = [e for e in self.hypotheses if set(e.effects) == both]
        return max(0.0, self._most(united) - _proven(self.leader, self.held_out)) if united else None

    def _most(self, hypotheses: Iterable[Hypothesis]) -> float:
        return max((_proven(e, self.held_out) for e in hypotheses), default=0.0)


def _as_good(gain: float, most: float, shared: float = 0.0) -> bool:
    """Whether a gain is within reach of another one, both of which are `shared` in part."""
    return gain - shared >= RIVAL * (most - shared) and 1 - gain <= RIVAL_LEFT * (1 - most)


def _resized(
    before: Sequence[Array], after: Sequence[Array], layout: Sequence[Sequence[str]]
) -> list[tuple[float, float]]:
    """Of each window what the best multiple of a change in each of its signals would gain besides, and what the change
    gains; squared deviations. Windows that are not compared over the same time do not count."""
    found = []
    for old, new, names in zip(before, after, layout, strict=True):
        if len(old) != len(new) or not len(new):
            continue
        was, rest = (rows.reshape(len(names), -1) for rows in (old, new))
        change = rest - was
        size = np.sum(change**2, axis=1)
        told = size > UNTOLD**2 * change.shape[1]
        besides = float(np.sum(np.sum(rest[told] * change[told], axis=1) ** 2 / size[told]))
        found.append((besides, cost([old]) - cost([new])))
    return found


def _proven(hypothesis: Hypothesis, held_out: Mapping[int, float | None]) -> float:
    """The smaller of what it gains where it was fitted and where it was not."""
    unseen = held_out[id(hypothesis)]
    return min(hypothesis.gain, hypothesis.cv_gain if unseen is None else unseen)


def _negligible(hypothesis: Hypothesis) -> list[Candidate]:
    """Those of its effects that have next to no size, or one that might as well be zero."""
    sizes, deviations = hypothesis.sizes, hypothesis.deviations

    def least(parameter: FreeParameter) -> float:
        return max(NEGLIGIBLE * parameter.likely, CERTAIN_SIZE * deviations[parameter.name])

    return [
        c
        for c in hypothesis.candidates
        if c.free_parameters and all(abs(sizes[k.name]) < least(k) for k in c.free_parameters)
    ]


def judge(
    hypotheses: Sequence[Hypothesis],
    described: Sequence[Hypothesis],
    proof: Proof,
    with_profile: Callable[[Hypothesis], Hypothesis | None] = lambda _: None,
    threshold: float = THRESHOLD,
) -> Judged:
    """`explanations` are effects, alone and several at once, and united those that are in doubt; `described` are terms
    without known physics. `with_profile` tells what an explanation with one size for all of the road becomes if that
    is another at every place."""
    return _Judge(hypotheses, described, proof, with_profile, threshold).judged()


@dataclass(frozen=True)
class _Leading:
    """What explains most."""

    likeliest: Hypothesis | None  # of what nothing else speaks against, whether or not signals agree in its size
    leader: Hypothesis | None  # the likeliest in whose size they do
    besides: frozenset[str] = frozenset()  # ids of effects of which one may be there as well, nobody knows which


class _Judge:
    """The arguments of `judge`, and what follows from them."""

    def __init__(
        self, hypotheses: Sequence[Hypothesis], described: Sequence[Hypothesis], proof: Proof,
        with_profile: Callable[[Hypothesis], Hypothesis | None], threshold: float,
    ) -> None:  # fmt: skip
        self.hypotheses, self.described, self.proof = hypotheses, described, proof
        self.with_profile, self.threshold = with_profile, threshold
        self.held_out = {id(e): proof.gain_of_most(e) for e in (*hypotheses, *described)}
        size = float(sum(len(r) for r in proof.base.residuals))
        self.least_whole = size / max(proof.base.value, size)
        self.best: dict[frozenset[str], Hypothesis] = {}  # by ids
        self.ranked: dict[str, Hypothesis] = {}  # single effects, by id
        for e in sorted(hypotheses, key=self.proven, reverse=True):
            self.best.setdefault(frozenset(e.effects), e)
            if len(e.candidates) == 1:
                self.ranked.setdefault(e.effects[0], e)
        self.described_from = DESCRIBED * max(1.0, threshold / THRESHOLD)
        self._objections: dict[int, str] = {}  # by id of the explanation

    def judged(self) -> Judged:
        leading, term = self.leading(), self.term()
        leader = leading.leader
        if leader is None or (term is not None and self.displaced(leader, term)):
            return self.nothing_known(leading, term)
        rivals = in_doubt = self.within_reach(leader)
        names = {frozenset(e.effects) for e in rivals}
        shared = frozenset.intersection(*names)
        besides = leading.besides - shared if len(names) == 1 else frozenset()
        if len(names) > 1 and shared:
            # What all rivals share is sure; what else there is, is not, and if it is the smaller part it may be left
            # open.
            alone = [e for e in self.hypotheses if set(e.effects) == shared and self.holds(e)]
            if alone and max(map(self.proven, alone)) > SURE * self.proven(leader):
                besides = frozenset.union(*names) - shared
                leader = max(alone, key=self.proven)
                rivals = self.within_reach(leader)
                names = {frozenset(e.effects) for e in rivals}
        return replace(
            self.said("named" if len(names) == 1 else "ambiguous", leader, *rivals),
            besides=tuple(sorted(besides)), in_doubt=in_doubt if len(in_doubt) > 1 else (),
        )  # fmt: skip

    def nothing_known(self, leading: _Leading, term: Hypothesis | None) -> Judged:
        """Whether something is left over all the same, which a term may describe."""
        disagreed = leading.likeliest is not None and leading.leader is None
        left_over = term is not None or disagreed or self.proof.astray()
        judged = self.said("unknown" if left_over else "no_mismatch", term)
        if leading.leader is None or term is None or not self.displaced(leading.leader, term):
            return judged
        outdone = {id(e) for e in self.ranked.values() if e.effects[0] in leading.leader.effects}
        return replace(
            judged, refused={e: why or (OUTDONE if e in outdone else "") for e, why in judged.refused.items()}
        )

    def said(self, verdict: str, leader: Hypothesis | None, *rivals: Hypothesis) -> Judged:
        """A verdict, with what speaks against each of the effects that were fitted alone."""
        refused = {
            id(e): self.objection(e) or ("" if self.agreed(e) else DISAGREED) for e in self.ranked.values()
        }  # fmt: skip
        return Judged(
            verdict, leader, rivals, tuple(self.ranked.values()), tuple(self.hypotheses), self.held_out, refused
        )

    def proven(self, e: Hypothesis) -> float:
        return _proven(e, self.held_out)

    def term(self) -> Hypothesis | None:
        """The term without known physics that explains most, if that is enough and nothing is worse with it as a whole
        where it was not fitted."""
        most = max(filter(self.mends_unseen, self.described), key=self.proven, default=None)
        return most if most is not None and self.proven(most) > self.described_from else None

    def mends_unseen(self, e: Hypothesis) -> bool:
        """Whether all of what was held out, if anything was, is better with an explanation."""
        unseen = self.proof.gain(e)
        return unseen is None or unseen > 0

    def displaced(self, leader: Hypothesis, term: Hypothesis) -> bool:
        """Whether a term explains clearly more than what is known."""
        more = self.proven(term) - self.proven(leader)
        return more > max(self.described_from, DISPLACED * self.proven(leader))

    def holds(self, e: Hypothesis) -> bool:
        return not self.objection(e)

    def objection(self, e: Hypothesis) -> str:
        """What speaks against an explanation, if anything does."""
        if id(e) not in self._objections:
            self._objections[id(e)] = self._objection(e)
        return self._objections[id(e)]

    def _objection(self, e: Hypothesis) -> str:
        proof, proven = self.proof, self.proven(e)
        least = self.threshold * float(np.clip(OWN / max(e.independent_share, 1e-3), 1.0, ASKED_AT_MOST))
        along_road = any(candidate.along_road for candidate in e.candidates)
        if along_road and proof.on_another_road and proven <= max(least, LASTING * e.gain) < e.score:
            return ANOTHER_ROAD
        if proven <= least:
            return "it explains no more than chance"
        # Of many sizes some may suit what was held out by chance.
        lasts = min(proven, e.cv_gain) if along_road else proven
        if lasts <= LASTING * e.gain or not self.mends_unseen(e):
            return "little of what it explains lasts where it was not fitted"
        if e.spoilt >= SPOILT:
            return "it spoils in some drives a good part of what it mends in others"
        if any(not issubclass(EVERY[c.effect], RoadEffect) for c in _negligible(e)):
            return MIGHT_BE_ZERO
        # That the road is not level or even, one size tells; what it is where may be another at every place.
        if _negligible(e) or proof.unmended(e):
            e = self.with_profile(e) or e
        if proof.fitted.level(e.fit.residuals) >= LEFT_OVER:
            return "it leaves too much over to be what lacks"
        if _negligible(e):
            return MIGHT_BE_ZERO
        if signal := proof.unmended(e):
            return f"it leaves the {signal.replace('_', ' ')} about as far off as it was"
        return ""

    def agreed(self, e: Hypothesis) -> bool:
        """Whether signals and recordings agree in each of its effects."""
        if len(e.effects) == 1:
            return self.proof.at_odds(e) < AT_ODDS
        known = (self.best.get(frozenset(e.effects) - {effect}) for effect in e.effects)
        return all(self.proof.at_odds(e, one) < AT_ODDS for one in known if one is not None)

    def surpassed(self, e: Hypothesis, by: Hypothesis) -> bool:
        """Whether the two were fitted together and one adds next to nothing to what it is surpassed by."""
        united = self.best.get(frozenset((*by.effects, *e.effects)))
        if united is None:
            return False
        adds, added = (
            (self.proven(united) - self.proven(one)) / max(1 - self.proven(one), self.least_whole) for one in (e, by)
        )
        return adds > self.threshold and added < SURPASSED * adds

    def leading(self) -> _Leading:
        """One effect, or several where each that joins explains enough besides."""
        single = next(filter(self.holds, self.ranked.values()), None)
        leading = _Leading(single, single if single is not None and self.agreed(single) else None)
        for count in (2, 3):
            leading = self._joined_by_one(leading, count)
        return leading

    def _joined_by_one(self, leading: _Leading, count: int) -> _Leading:
        """What leads where explanations of so many effects are heard, too."""
        explained = max((self.proven(e) for e in self.hypotheses if len(e.candidates) < count), default=0.0)

        def adds(e: Hypothesis) -> float:
            return self.proven(e) - explained

        left, clear = max(1 - explained, self.least_whole), CLEAR * self.threshold
        least = max(min(FURTHER, clear) * left, FORM * explained)
        # What speaks against an explanation takes long to find: only of those that can matter.
        several = [e for e in self.hypotheses if len(e.candidates) == count and adds(e) > least / 2]
        several.sort(key=self.proven, reverse=True)
        best, leader = next(filter(self.holds, several), None), leading.leader
        if best is None or adds(best) <= least:
            return leading
        share = adds(best) / left
        unfinished = leader is None or self.proof.fitted.worst(leader.fit.residuals) > ASTRAY
        outstanding = unfinished and share > FURTHER
        if not outstanding and share <= clear:
            return leading
        added = set(best.effects) - set(leader.effects if leader is not None else ())
        alike = [] if outstanding else [e for e in several if adds(e) >= adds(best) / 2 and self.holds(e)]
        if all(added & set(e.effects) or self.surpassed(e, best) for e in alike):
            return _Leading(best, best) if self.agreed(best) else _Leading(best, leader)
        if self.agreed(best) and (sure := set(best.effects) - added):
            return replace(leading, besides=frozenset().union(*(e.effects for e in alike if sure <= set(e.effects))))
        return leading

    def within_reach(self, leader: Hypothesis) -> tuple[Hypothesis, ...]:
        """A leader and its rivals. What excludes another explanation is what it gains beyond what the two share: that
        it is itself unproven does not."""

        def is_rival(e: Hypothesis) -> bool:
            shared = frozenset(e.effects) & frozenset(leader.effects)
            known = self.proven(self.best[shared]) if shared in self.best else 0.0
            return _as_good(self.proven(e), self.proven(leader), known) and not self.surpassed(e, leader)

        alike = (e for e in self.hypotheses if len(e.candidates) == len(leader.candidates) and e is not leader)
        return leader, *sorted(filter(is_rival, alike), key=self.proven, reverse=True)
