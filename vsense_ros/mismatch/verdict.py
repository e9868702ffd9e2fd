"""What may be said of explanations: whether one is proven, which others are within its reach, and what is unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from vsense_ros.mismatch.answer_schema import VerdictName
from vsense_ros.mismatch.confidence import confidence
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.objections import DISAGREED, OUTDONE, Objections, negligible
from vsense_ros.mismatch.thresholds import THRESHOLDS, Thresholds
from vsense_ros.mismatch.validation import Validation
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import RoadEffect


@dataclass(frozen=True)
class Ranked:
    """An effect that was fitted alone, and what speaks against it; empty where nothing does."""

    hypothesis: Hypothesis
    objection: str


@dataclass(frozen=True)
class Judged:
    """A verdict and what it rests on."""

    verdict: VerdictName
    leader: Hypothesis | None  # what explains most, if it is proven; a term where the physics is unknown
    rivals: tuple[Hypothesis, ...]  # the leader, and what is within its reach
    ranked: tuple[Ranked, ...]  # single effects, each at its best place, best first
    hypotheses: tuple[Hypothesis, ...]  # all that were fitted, of known physics
    proven: Mapping[Hypothesis, float]  # the smaller of the gains where an explanation was fitted and where it was not
    besides: tuple[str, ...] = ()  # ids of effects of which one may be there as well, nobody knows which
    partial: bool = False  # whether something more is left over, which nothing explains
    excluded: frozenset[Hypothesis] = frozenset()  # by more than what they gain
    in_doubt: tuple[Hypothesis, ...] = ()  # between which to choose, the best first; what they share may be sure
    improbable: frozenset[str] = frozenset()  # ids of effects that the evidence excludes
    thresholds: Thresholds = THRESHOLDS

    @property
    def sure(self) -> frozenset[str]:
        """Ids of the effects that every explanation has which remains."""
        if self.verdict not in ("named", "ambiguous") or not self.rivals:
            return frozenset()
        return frozenset.intersection(*(frozenset(e.effects) for e in self.rivals))

    def led_by(self, leader: Hypothesis, validation: Validation) -> Judged:
        """This verdict with the leader fitted further."""
        return replace(
            self, leader=leader, rivals=(leader, *self.rivals[1:]) if self.rivals else (),
            proven={**self.proven, leader: validation.proven(leader)},
        )  # fmt: skip

    def objection_to(self, hypothesis: Hypothesis) -> str:
        """What speaks against an effect that was fitted alone; empty where nothing does, and for all others."""
        return next((one.objection for one in self.ranked if one.hypothesis is hypothesis), "")

    def confidence(self, hypothesis: Hypothesis, effect: str) -> float:
        """How probable it is that an effect of an explanation is there: by how far what it gains of what the other
        effects of the explanation leave leads what any other effect would; next to nothing where it is refused."""
        rest = set(hypothesis.effects) - {effect}
        known = self._most(e for e in self.hypotheses if set(e.effects) == rest)
        others = self.instead_of(hypothesis, effect) - self.excluded
        left = max(1 - known, self.thresholds.least_gain)
        gain, other = (self.proven[hypothesis] - known) / left, (self._most(others) - known) / left
        certain = confidence(gain, other, self.thresholds)
        if gain > self.thresholds.evident_gain:
            certain = max(certain, self.thresholds.clear_name * hypothesis.evident.get(effect, 0.0))
        answer = {one for e in self.rivals for one in e.effects} | set(self.besides)
        return certain if effect in answer else min(certain, self.thresholds.refused)

    def instead_of(self, hypothesis: Hypothesis, effect: str) -> set[Hypothesis]:
        """Explanations that have any other effect in place of one of a hypothesis."""
        rest = set(hypothesis.effects) - {effect}
        return {
            e for e in self.hypotheses
            if effect not in e.effects and rest < set(e.effects) and len(e.effects) == len(hypothesis.effects)
        }  # fmt: skip

    @property
    def doubted(self) -> tuple[str, ...]:
        """Ids of effects of the leader that would be named although they are less likely present than not, or their
        size may be zero; what a road is like at each place may be known where its mean is not."""
        if self.leader is None:
            return ()
        zero = {
            c.effect for c in negligible(self.leader, self.thresholds) if not issubclass(EVERY[c.effect], RoadEffect)
        }
        return tuple(
            id for id in self.leader.effects
            if id in self.sure
            and (
                id in zero
                or id in self.improbable
                or self.confidence(self.leader, id) < self.thresholds.least_confidence
            )
        )  # fmt: skip

    def other_places(self) -> tuple[str, ...]:
        """Where else the only effect of the leader would explain about as much as where it explains most."""
        if self.leader is None or len(self.leader.candidates) > 1:
            return ()
        own = {parameter.name for parameter in self.leader.candidates[0].free_parameters}
        most = self.proven[self.leader]
        return tuple(
            e.candidates[0].where for e in self.hypotheses
            if e.effects == self.leader.effects
            and own.isdisjoint(parameter.name for parameter in e.candidates[0].free_parameters)
            and _as_good(self.proven[e], most, self.thresholds)
        )  # fmt: skip

    def without(self, hypothesis: Hypothesis, effect: str) -> Hypothesis | None:
        """The best of the other effects of an explanation, fitted without this one; None where that was not done."""
        rest = set(hypothesis.effects) - {effect}
        fitted = (e for e in self.hypotheses if rest and set(e.effects) == rest)
        return max(fitted, key=self.proven.__getitem__, default=None)

    def adds(self, hypothesis: Hypothesis) -> float | None:
        """What an explanation gains besides the leader, where the two were fitted together."""
        if self.leader is None or set(hypothesis.effects) <= set(self.leader.effects):
            return None
        both = {*self.leader.effects, *hypothesis.effects}
        joint = [e for e in self.hypotheses if set(e.effects) == both]
        return max(0.0, self._most(joint) - self.proven[self.leader]) if joint else None

    def _most(self, hypotheses: Iterable[Hypothesis]) -> float:
        return max((self.proven[e] for e in hypotheses), default=0.0)


def judge(
    hypotheses: Sequence[Hypothesis],
    terms: Sequence[Hypothesis],
    validation: Validation,
    with_profile: Callable[[Hypothesis], Hypothesis | None] = lambda _: None,
    least_gain: float | None = None,
    thresholds: Thresholds = THRESHOLDS,
    improbable: frozenset[str] = frozenset(),
) -> Judged:
    """The verdict on `hypotheses`, which are effects, alone and several at once, and on `terms` without known physics.

    `with_profile` is what an explanation with one size for all of the road becomes if that is another at every
    place. `least_gain` is what an effect needs to gain on so much driving; that of `thresholds` where it is not given.
    Effects that are `improbable` by the evidence, by id, are not named.
    """
    least = thresholds.least_gain if least_gain is None else least_gain
    return _Judge(hypotheses, terms, validation, with_profile, least, thresholds, improbable).judged()


def _as_good(gain: float, most: float, thresholds: Thresholds, shared: float = 0.0) -> bool:
    """True if a gain is within reach of the largest, of both of which `shared` is a part."""
    return gain - shared >= thresholds.rival_share * (most - shared) and not _leaves_more(gain, most, thresholds)


def _evident(e: Hypothesis, fewer: Hypothesis, thresholds: Thresholds) -> bool:
    """True if the evidence is sure of the effects that an explanation has beyond one with fewer."""
    further = set(e.effects) - set(fewer.effects)
    return all(e.evident.get(effect, 0.0) > thresholds.trusted for effect in further)


def _leaves_more(gain: float, most: float, thresholds: Thresholds) -> bool:
    """True if what a gain leaves is a multiple of what the largest leaves."""
    return 1 - gain > thresholds.rival_left * (1 - most)


@dataclass(frozen=True)
class _Leading:
    """What explains most."""

    likeliest: Hypothesis | None  # to which nothing else is objected, whether or not signals agree in its size
    leader: Hypothesis | None  # the likeliest in whose size they do
    besides: frozenset[str] = frozenset()  # ids of effects of which one may be there as well


class _Judge:
    """The arguments of `judge`, and what follows from them."""

    def __init__(
        self, hypotheses: Sequence[Hypothesis], terms: Sequence[Hypothesis], validation: Validation,
        with_profile: Callable[[Hypothesis], Hypothesis | None], least_gain: float, thresholds: Thresholds,
        improbable: frozenset[str],
    ) -> None:  # fmt: skip
        self.hypotheses, self.terms, self.validation, self.improbable = hypotheses, terms, validation, improbable
        self.least_gain, self.thresholds = least_gain, thresholds
        self.proven = {e: validation.proven(e) for e in (*hypotheses, *terms)}
        size = float(sum(len(r) for r in validation.base.residuals))
        self.least_whole = size / max(validation.base.value, size)
        self.best: dict[frozenset[str], Hypothesis] = {}  # by ids
        self.ranked: dict[str, Hypothesis] = {}  # single effects, by id
        for e in sorted(hypotheses, key=self.proven.__getitem__, reverse=True):
            self.best.setdefault(frozenset(e.effects), e)
            if len(e.candidates) == 1:
                first = self.ranked.setdefault(e.effects[0], e)
                # Of a road that the unseen recordings never come to, these prove neither form: the likelier is named.
                along = any(candidate.along_road for candidate in e.candidates)
                if along and max(self.proven[first], self.proven[e]) <= least_gain < e.score > first.score:
                    self.ranked[e.effects[0]] = e
        self.objections = Objections(validation, self.best, with_profile, least_gain, thresholds)
        self.holds, self.agreed = self.objections.holds, self.objections.agreed
        self.least_term_gain = thresholds.least_term_gain * max(1.0, least_gain / thresholds.least_gain)

    def judged(self) -> Judged:
        leading, term = self.leading(), self.term()
        leader = self.simpler(leading.leader)
        partial = leader is None and (leader := self.part(leading.likeliest)) is not None
        if leader is None or (term is not None and self.displaced(leader, term)):
            return self.nothing_known(replace(leading, leader=leader), term)
        rivals = in_doubt = self.within_reach(leader)
        names = {frozenset(e.effects) for e in rivals}
        shared = frozenset.intersection(*names)
        besides = leading.besides - shared if len(names) == 1 else frozenset()
        if len(names) > 1 and shared and (sure := self.sure_alone(shared, leader)) is not None:
            besides = frozenset.union(*names) - shared
            # What is a part of an explanation in doubt explains something besides, and nothing instead.
            instead = [e for e in self.within_reach(sure)[1:] if not any(set(e.effects) <= one for one in names)]
            leader, rivals = sure, (sure, *instead)
            names = {frozenset(e.effects) for e in rivals}
        judged = replace(
            self.said("named" if len(names) == 1 else "ambiguous", leader, *rivals),
            besides=tuple(sorted(besides)), partial=partial, in_doubt=in_doubt if len(in_doubt) > 1 else (),
        )  # fmt: skip
        return self.without_doubted(judged, term)

    def simpler(self, leader: Hypothesis | None) -> Hypothesis | None:
        """The leader; if it needs a size for every place of the road, rather the best explanation with no more effects
        that needs none and leaves no more than a good model does. Where a profile is free at every place, it stands in
        for whatever acts along the car."""
        if leader is None or not any(candidate.along_road for candidate in leader.candidates):
            return leader
        enough = (
            e for e in self.hypotheses
            if len(e.effects) <= len(leader.effects)
            and not any(candidate.along_road for candidate in e.candidates)
            and self.proven[e] > self.thresholds.rival_share * self.proven[leader]
            and self.validation.worst_after(e) <= self.thresholds.noise_level
        )  # fmt: skip
        likely = sorted(enough, key=lambda e: (len(e.effects), -self.proven[e]))
        return next((e for e in likely if self.holds(e) and self.agreed(e)), leader)

    def without_doubted(self, judged: Judged, term: Hypothesis | None) -> Judged:
        """The verdict in which no effect is named that is less likely present than not: the others are named, if they
        hold alone, with a remark on it; otherwise what explains as much in its place is its rival."""
        doubted, leader = judged.doubted, judged.leader
        if not doubted or leader is None:
            return judged
        rest = self.best.get(frozenset(leader.effects) - set(doubted))
        if rest is not None and self.agreed(rest) and (self.holds(rest) or not self.objections.to_part(rest)):
            named = replace(
                self.said("named", rest, rest), besides=tuple(sorted({*judged.besides, *doubted})),
                partial=judged.partial or not self.holds(rest), in_doubt=judged.in_doubt,
            )  # fmt: skip
            return self.without_doubted(named, term)
        likeliest = (
            max(judged.instead_of(leader, id) - judged.excluded, key=self.proven.__getitem__, default=None)
            for id in doubted
        )
        instead = [e for e in likeliest if e is not None and self.proven[e] > self.least_gain]
        if not instead:
            return self.nothing_known(_Leading(None, None), term)
        return replace(judged, verdict="ambiguous", rivals=(*judged.rivals, *instead))

    def part(self, likeliest: Hypothesis | None) -> Hypothesis | None:
        """What explains most where nothing explains all: effects of which each is needed, and mends what it changes.
        None where something explains more in whose size signals disagree."""
        limits = self.thresholds

        def needed(e: Hypothesis) -> bool:
            if len(e.effects) == 1:
                return True
            least = max(limits.clear_further_gain * self.least_gain, limits.form_error * self.proven[e])
            fewer = (self.best.get(frozenset(e.effects) - {effect}) for effect in e.effects)
            return all(self.proven[e] - self.proven[one] > least for one in fewer if one is not None)

        most = 0.0 if likeliest is None else self.proven[likeliest]
        likely = sorted(self.hypotheses, key=self.proven.__getitem__, reverse=True)
        enough = (e for e in likely if self.proven[e] > max(limits.partial_gain, self.least_gain, most))
        return next((e for e in enough if needed(e) and not self.objections.to_part(e) and self.agreed(e)), None)

    def sure_alone(self, shared: frozenset[str], leader: Hypothesis) -> Hypothesis | None:
        """The effects that all rivals share, if they hold without the rest, and that is the smaller part of what the
        leader explains: then it may be left open."""
        alone = [e for e in self.hypotheses if set(e.effects) == shared and self.holds(e)]
        best = max(alone, key=self.proven.__getitem__, default=None)
        if best is None or self.proven[best] <= self.thresholds.sure_share * self.proven[leader]:
            return None
        return best

    def nothing_known(self, leading: _Leading, term: Hypothesis | None) -> Judged:
        """The verdict that no known effect explains the difference; a term may describe what remains unexplained."""
        disagreed = leading.likeliest is not None and leading.leader is None
        unexplained = term is not None or disagreed or self.validation.something_unexplained()
        judged = self.said("unknown" if unexplained else "no_mismatch", term)
        if leading.leader is None or term is None or not self.displaced(leading.leader, term):
            return judged
        outdone = leading.leader.effects
        return replace(
            judged,
            ranked=tuple(
                replace(one, objection=one.objection or (OUTDONE if one.hypothesis.effects[0] in outdone else ""))
                for one in judged.ranked
            ),
        )

    def said(self, verdict: VerdictName, leader: Hypothesis | None, *rivals: Hypothesis) -> Judged:
        """A verdict, with what speaks against each of the effects that were fitted alone."""
        ranked = tuple(
            Ranked(e, self.objections.to(e) or ("" if self.agreed(e) else DISAGREED)) for e in self.ranked.values()
        )
        hypotheses, proven = tuple(self.hypotheses), self.proven
        excluded = frozenset(
            e for e in hypotheses if e not in rivals and leader is not None and self.exceeded(e, leader)
        )
        return Judged(
            verdict, leader, rivals, ranked, hypotheses, proven, excluded=excluded, thresholds=self.thresholds,
            improbable=self.improbable,
        )  # fmt: skip

    def term(self) -> Hypothesis | None:
        """The term without known physics that explains most, if that is enough and held-out recordings as a whole are
        better with it."""
        better = filter(self.objections.mends_unseen, self.terms)
        most = max(better, key=self.proven.__getitem__, default=None)
        return most if most is not None and self.proven[most] > self.least_term_gain else None

    def displaced(self, leader: Hypothesis, term: Hypothesis) -> bool:
        """True if a term explains clearly more than the known effects."""
        more = self.proven[term] - self.proven[leader]
        return more > max(self.least_term_gain, self.thresholds.term_advantage * self.proven[leader])

    def surpassed(self, e: Hypothesis, by: Hypothesis) -> bool:
        """True if the two were fitted together and one adds next to nothing to what it is surpassed by."""
        joint = self.best.get(frozenset((*by.effects, *e.effects)))
        if joint is None:
            return False
        adds, added = (
            (self.proven[joint] - self.proven[one]) / max(1 - self.proven[one], self.least_whole) for one in (e, by)
        )
        return adds > self.least_gain and added < self.thresholds.surpassed_share * adds

    def leading(self) -> _Leading:
        """One effect, or several where each that joins explains enough besides."""
        single = next(filter(self.holds, self.ranked.values()), None)
        leading = _Leading(single, single if single is not None and self.agreed(single) else None)
        most = max((len(e.candidates) for e in self.hypotheses), default=1)
        for count in range(2, most + 1):
            leading = self._joined_by_one(leading, count)
        return leading

    def _joined_by_one(self, leading: _Leading, count: int) -> _Leading:
        """What leads if explanations of so many effects are admitted, too."""
        limits = self.thresholds
        by_proof = self.proven.__getitem__
        fewer = max((e for e in self.hypotheses if len(e.candidates) < count), key=by_proof, default=None)
        explained = 0.0 if fewer is None else self.proven[fewer]
        adds = {
            e: self.proven[e] if fewer is None else self.validation.proven_beyond(e, fewer)
            for e in self.hypotheses
            if len(e.candidates) == count
        }
        left, clear = max(1 - explained, self.least_whole), limits.clear_further_gain * self.least_gain
        if fewer is not None and any(_evident(e, fewer, limits) for e in adds):
            clear = limits.evident_gain
        least = max(min(limits.further_share, clear) * left, limits.form_error * explained)
        # Objections take long to find: they are asked only of explanations that can matter.
        several = sorted((e for e, more in adds.items() if more > least / 2), key=by_proof, reverse=True)
        best = next(filter(self.holds, several), None)
        if best is None or adds[best] <= least:
            return leading
        share = adds[best] / left
        outstanding = share > limits.further_share and self._leaves_signals_off(leading.leader)
        if not outstanding and share <= clear:
            return leading
        alike = [] if outstanding else [e for e in several if adds[e] >= adds[best] / 2 and self.holds(e)]
        return self._led_by(best, leading, alike)

    def _leaves_signals_off(self, leader: Hypothesis | None) -> bool:
        """True if a signal is far from those of a good model with the leader, or there is no leader."""
        return leader is None or self.validation.fitted.worst(leader.fit.residuals) > self.thresholds.signal_off

    def _led_by(self, best: Hypothesis, leading: _Leading, alike: Sequence[Hypothesis]) -> _Leading:
        """What leads if the `best` explanation has one effect more than the leader, and those `alike` explain about as
        much: the best if all of these share the effect, or else the leader with a remark that there is another effect
        besides."""
        leader = leading.leader
        added = set(best.effects) - set(leader.effects if leader is not None else ())
        if all(added & set(e.effects) or self.surpassed(e, best) for e in alike):
            return _Leading(best, best) if self.agreed(best) else _Leading(best, leader)
        if self.agreed(best) and (sure := set(best.effects) - added):
            return replace(leading, besides=frozenset().union(*(e.effects for e in alike if sure <= set(e.effects))))
        return leading

    def within_reach(self, leader: Hypothesis) -> tuple[Hypothesis, ...]:
        """A leader and its rivals: those that nothing excludes that explains more. What excludes an explanation is what
        another gains beyond what the two share, be that the leader or one that the leader surpasses: that the excluded
        one is itself unproven does not."""
        alike = [e for e in self.hypotheses if len(e.candidates) == len(leader.candidates) and e is not leader]

        def is_rival(e: Hypothesis) -> bool:
            if self.excluded(e, leader):
                return False
            better = (by for by in alike if self.proven[by] > self.proven[e])
            return not any(self.excluded(e, by) and self.holds(by) for by in better)

        return leader, *sorted(filter(is_rival, alike), key=self.proven.__getitem__, reverse=True)

    def further_off(self, e: Hypothesis, by: Hypothesis) -> bool:
        """True if an explanation leaves signals further off than another one, and hardly any nearer. Where others leave
        large residuals in some signals, the difference between the two in others is little of the whole."""
        limits, shares = self.thresholds, self.validation.nearer(by, e)
        return bool(shares) and all(
            less > limits.further_share and more < limits.surpassed_share * less for less, more in shares
        )

    def excluded(self, e: Hypothesis, by: Hypothesis) -> bool:
        """True if an explanation is not within reach of another, adds next to nothing to it, leaves signals further
        off, or explains something else: then both may be present, and it adds to the other most of what it explains
        beyond what the two share."""
        shared = frozenset(e.effects) & frozenset(by.effects)
        known = self.proven[self.best[shared]] if shared in self.best else 0.0
        if not _as_good(self.proven[e], self.proven[by], self.thresholds, known):
            return True
        return self.exceeded(e, by)

    def exceeded(self, e: Hypothesis, by: Hypothesis) -> bool:
        """True if an explanation is excluded by another one for more than that it gains less."""
        if self.surpassed(e, by):
            return True
        shared = frozenset(e.effects) & frozenset(by.effects)
        known = self.proven[self.best[shared]] if shared in self.best else 0.0
        gains = self.proven[e] - known >= self.thresholds.rival_share * (self.proven[by] - known)
        if gains and _leaves_more(self.proven[e], self.proven[by], self.thresholds):
            return True
        joint = self.best.get(frozenset((*by.effects, *e.effects)))
        own = self.thresholds.rival_share * (self.proven[e] - known)
        if joint is not None and self.proven[joint] - self.proven[by] > max(own, self.least_gain):
            return True
        return self.proven[by] >= self.proven[e] and self.further_off(e, by)
