"""Sets of effects that the evidence proposes, fitted in full.

At the base fit, whose parameters may stand in for what is missing, slopes tell little of what a set does where it is
fitted. So the model is made linear again where the likeliest set is likeliest, until that set stays.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.least_squares import Fit, Slopes, fit_each, prior_weight, products, slopes_by
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.evidence import EVIDENCE, Chosen, Products, SetEvidence, Size
from vsense_ros.mismatch.fitting import Fitting
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import Secants
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.model.effects import EVERY, Effect

Array = NDArray[np.float64]
Key = tuple[str, str]  # name and form of a free parameter


def key_of(parameter: FreeParameter) -> Key:
    """By which a free parameter is found again in another fit."""
    return parameter.name, parameter.form


@dataclass(frozen=True)
class Profile:
    """The profile of a candidate along the road by n places, as k unknowns that are normal with a deviation of one.

    They are the directions of a smooth road that the residuals depend on most, with Matérn's covariance of 3/2
    (Rasmussen & Williams 2006, section 4.2).
    """

    candidate: Candidate
    directions: Array  # (n, k) what is at the places with one of each unknown, in the unit of the size
    inverse: Array  # (k, n)

    @classmethod
    def of(cls, candidate: Candidate, secants: Secants, samples: Sequence[float]) -> Profile:
        """`samples` are how many independent samples an instant of each window counts for."""
        places = candidate.places
        at = np.array([p.place[1] for p in places if p.place is not None])
        apart = np.sqrt(3.0) * np.abs(at[:, None] - at) / EVIDENCE.smooth
        deviation = candidate.free_parameters[0].deviation
        root = np.linalg.cholesky(deviation**2 * ((1 + apart) * np.exp(-apart) + 1e-6 * np.eye(len(at))))
        information = np.zeros((len(at), len(at)))
        for window, share in enumerate(samples):
            slopes = np.column_stack([secants.column(p)[window] for p in places])
            information += share * products(slopes)
        values, vectors = np.linalg.eigh(root.T @ information @ root)
        most = max(EVIDENCE.directions, len(at) // 2)
        likely = vectors[:, values > EVIDENCE.visible][:, ::-1][:, :most]
        return cls(candidate, root @ likely, np.linalg.solve(root.T, likely).T)

    @property
    def size(self) -> FreeParameter:
        """What it is everywhere."""
        return self.candidate.free_parameters[0]

    def unknowns(self, at: Fit) -> Array:
        """(k,) where a fit is."""
        known = at.offset_by_name
        return np.asarray(self.inverse @ [known.get(p.name, 0.0) for p in self.candidate.places])

    def offsets(self, at: Fit, unknowns: Array) -> dict[str, float]:
        """What a fit has at each place, by name, moved to other unknowns (k,)."""
        known = at.offset_by_name
        moved = self.directions @ (unknowns - self.unknowns(at))
        return {p.name: known.get(p.name, 0.0) + float(by) for p, by in zip(self.candidate.places, moved, strict=True)}

    def slopes(self, at: Fit, secants: Secants, window: int) -> NDArray[np.floating]:
        """(rows, k) slopes of the residuals in a window: those of a fit that has the profile, otherwise of the base."""
        places, known = self.candidate.places, {p.name: i for i, p in enumerate(at.free_parameters)}
        if all(p.name in known for p in places):
            columns = at.slopes[window][:, [known[p.name] for p in places]] / np.array([p.deviation for p in places])
        else:
            columns = np.column_stack([secants.column(p)[window] for p in places])
        return np.asarray(columns @ self.directions)


class Proposing:
    """Proposes sets of the candidates that are `offered`, beside a hypothesis or, without one, the base fit."""

    def __init__(self, secants: Secants, fitting: Fitting, offered: Sequence[Candidate]) -> None:
        self.secants, self.fitting, self.residuals = secants, fitting, secants.residuals
        self.offered = [c for c in offered if not c.along_road]
        self.profiles = self._profiles([c for c in offered if c.along_road and not c.free_parameters[0].form])
        self.effects = {key_of(p): c.effect for c in self.offered for p in c.free_parameters}
        self.parameters = {key_of(p): p for c in self.offered for p in c.free_parameters}
        self._joint = {c.effect for c in self.offered if len(c.free_parameters) > 1}
        self.evidence: tuple[SetEvidence, Chosen] | None = None  # where the likeliest set is likeliest, with that set
        self.level: dict[Hypothesis, Hypothesis] = {}  # with one size for all of the road, what it is with a profile

    def _profiles(self, offered: Sequence[Candidate]) -> list[Profile]:
        """The profiles of the road that can be validated, where there is something left for them to explain."""
        if not offered or not self.fitting.validation.profiles_can_be_validated:
            return []
        if self.residuals.worst(self.secants.base.residuals) <= THRESHOLDS.noise_level:
            return []
        self.secants.simulate_new(offered)
        return [Profile.of(candidate, self.secants, self._samples) for candidate in offered]

    def proposed(self) -> list[Hypothesis]:
        """The likeliest set, what is instead of each of its effects, the same with one size for all of the road where a
        profile of it is in them, and the same of where the model was made linear before: one may be further from the
        truth there than the other. None if nothing is likelier than something."""
        at, columns = self.secants.base, self._columns_at_base()
        chosen: Chosen = frozenset()
        before: dict[tuple[Candidate, ...], tuple[Fit, Mapping[str, float]]] = {}
        rounds = max(1, min(EFFORT.rounds, int(EFFORT.linear_again / sum(self._durations))))
        for _ in range(rounds):
            evidence = self._evidence(at, columns)
            best = evidence.search(chosen)
            self.evidence = evidence, best
            probabilities = evidence.probabilities()
            last, at = at, self._moved(at, columns, evidence, best)
            same, chosen = best == chosen, best
            if same or not best:
                break
            for one in map(self._candidates, _instead(evidence, best, of_others=True)):
                before.setdefault(one, (self._with(last, columns, one), probabilities))
            at = replace(at, slopes=self.secants.all_slopes_at(at), weight=prior_weight(at.residuals))
            before[self._candidates(best)] = at, probabilities
            columns = self._columns_at(at, columns, evidence)
        if not chosen:
            return []
        at = replace(at, weight=prior_weight(at.residuals))
        sets = [self._candidates(one) for one in (chosen, *_instead(evidence, chosen))]
        varying = [one for one in sets if any(c.along_road for c in one)]
        level = [tuple(map(self._with_one_size, one)) for one in varying]
        joints = [(one, self._with(at, columns, one)) for one in (*sets, *level)]
        fitted = self._fitted(joints, probabilities)
        by_candidates = {hypothesis.candidates: hypothesis for hypothesis in fitted}
        self.level = {by_candidates[one]: by_candidates[other] for one, other in zip(level, varying, strict=True)}
        before.pop(sets[0], None)
        for one, (where, earlier) in before.items():
            fitted += self._fitted([(one, where)], earlier)
        return fitted

    def _with_one_size(self, candidate: Candidate) -> Candidate:
        """A candidate with one size for all of the road in place of a profile."""
        if not candidate.along_road:
            return candidate
        size = [key_of(candidate.free_parameters[0])]
        return next(c for c in self.offered if [key_of(p) for p in c.free_parameters] == size)

    def without_each(
        self, hypothesis: Hypothesis, known: Set[frozenset[str]] = frozenset(), only: str | None = None
    ) -> list[Hypothesis]:
        """A hypothesis without each of its effects, or without one of them only, fitted, but for sets of effects that
        are `known`, by id."""
        leaving = [c for c in hypothesis.candidates if only in (None, c.effect)]
        rests = [tuple(c for c in hypothesis.candidates if c is not out) for out in leaving]
        new = [rest for rest in rests if rest and frozenset(c.effect for c in rest) not in known]
        joints = [(rest, self._with(hypothesis.fit, {}, rest)) for rest in new]
        return self._fitted(joints, hypothesis.evident)

    def with_only(self, hypothesis: Hypothesis, effects: Set[str]) -> Hypothesis:
        """A hypothesis with some of its effects only, by id, fitted."""
        rest = tuple(c for c in hypothesis.candidates if c.effect in effects)
        (fitted,) = self._fitted([(rest, self._with(hypothesis.fit, {}, rest))], hypothesis.evident)
        return fitted

    def _fitted(
        self, joints: Sequence[tuple[tuple[Candidate, ...], Fit]], probabilities: Mapping[str, float]
    ) -> list[Hypothesis]:
        """Hypotheses of candidates and fits to go on from, side by side, with the probabilities of effects by id."""
        fits = fit_each(self.residuals, self.secants.start, [one for _, one in joints], self.secants.base.residuals)
        fitted = []
        for (candidates, _), of in zip(joints, fits, strict=True):
            share = of.equations.independent_share(candidates[-1].free_parameters)
            fitted.append(replace(self.fitting.hypothesis(candidates, of, share), evident=probabilities))
        return fitted

    def _evidence(self, at: Fit, columns: Mapping[Key, list[Slopes]]) -> SetEvidence:
        """The evidence of sets by the slopes of a fit and by those of further sizes, both per deviation."""
        usual = {parameter.name: parameter.deviation for parameter in self.secants.base.free_parameters}
        everywhere = [i for i, p in enumerate(at.free_parameters) if p.place is None]
        places = {key_of(at.free_parameters[i]): place for place, i in enumerate(everywhere)}
        places |= {key: len(places) + i for i, key in enumerate(columns)}
        own = [at.free_parameters[i] for i in everywhere]
        factors = np.array([self._unit(p) / p.deviation for p in own])
        sizes = []
        for key, p in self.parameters.items():
            effect = self.effects[key]
            little = EVIDENCE.form if p.form else THRESHOLDS.little_of(effect)
            if not p.form and p.name in usual:
                little = max(little, usual[p.name] / p.deviation)
            low, high = p.low / p.deviation - EVIDENCE.settled, p.high / p.deviation + EVIDENCE.settled
            joins = effect in self._joint
            little = min(little, EVIDENCE.most_little)
            sizes.append(Size(places[key], effect, p.name, low, high, little, joins, plane=bool(p.form)))
        present = [*(at.scaled_offsets[everywhere] / factors), *np.zeros(len(columns))]
        for profile in self.profiles:
            size, first = sizes[self._sizes.index(key_of(profile.size))], len(present)
            present += profile.unknowns(at).tolist()
            along = tuple(range(first, len(present)))
            sizes.append(replace(size, along=along, mistaken=EVERY[size.effect].mistaken_for))
        slopes = (
            np.column_stack([
                slopes[:, everywhere] * factors,
                *(column[window] for column in columns.values()),
                *(profile.slopes(at, self.secants, window) for profile in self.profiles),
            ])
            for window, slopes in enumerate(at.slopes)
        )  # fmt: skip
        products = Products.of(at.residuals, slopes, [len(names) for names in self.residuals.layout], self._durations)
        return SetEvidence(products, np.array(present), sizes)

    @cached_property
    def _durations(self) -> list[float]:
        return [w.end - w.begin - w.run_in for w in self.residuals.predictor.dataset.windows]

    @cached_property
    def _samples(self) -> list[float]:
        """Independent samples of each signal in each window, over its instants."""
        rows = [
            len(r) / max(len(names), 1)
            for r, names in zip(self.secants.base.residuals, self.residuals.layout, strict=True)
        ]
        return [EVIDENCE.samples * d / max(n, 1.0) for d, n in zip(self._durations, rows, strict=True)]

    @cached_property
    def _sizes(self) -> list[Key]:
        return list(self.parameters)

    def _unit(self, parameter: FreeParameter) -> float:
        """The deviation of a free parameter; of one that every car has a little of, where it is in a set."""
        return self.parameters.get(key_of(parameter), parameter).deviation

    def _columns_at_base(self) -> dict[Key, list[Slopes]]:
        """Secants at the base fit by all sizes that it does not have, per deviation, by window."""
        present = {key_of(p) for p in self.secants.base.free_parameters}
        self.secants.simulate_new(self.offered)
        return {
            key: [part * np.float32(p.deviation) for part in self.secants.column(p)]
            for key, p in self.parameters.items()
            if key not in present
        }

    def _columns_at(
        self, at: Fit, earlier: Mapping[Key, list[Slopes]], evidence: SetEvidence
    ) -> dict[Key, list[Slopes]]:
        """The same at another fit: simulated anew for effects of sets that are not far less likely than the best and
        those that they are mistaken for, where they were simulated last for all others."""
        present = {key_of(p) for p in at.free_parameters}
        sizes = evidence.sizes
        effects = {
            sizes[i].effect for one, weight in evidence.weights().items() if weight > EFFORT.unlikely for i in one
        }
        mistaken = {other for effect in effects for other in EVERY.get(effect, Effect).mistaken_for}
        likely = {key for key, effect in self.effects.items() if effect in effects | mistaken}
        known = {**self._columns_at_base(), **earlier}
        columns = {key: column for key, column in known.items() if key not in present}
        new = [p for key, p in self.parameters.items() if key in likely - present]
        secants = slopes_by(self.residuals, self.secants.start, at, new, EFFORT.secant)
        return columns | {key_of(p): secant for p, secant in zip(new, secants, strict=True)}

    def _candidates(self, chosen: Chosen) -> tuple[Candidate, ...]:
        """What a set stands for: an effect in each candidate."""
        keys = [key for i, key in enumerate(self._sizes) if i in chosen]
        effects = dict.fromkeys(self.effects[key] for key in keys)
        profiles = [p.candidate for i, p in enumerate(self.profiles, start=len(self._sizes)) if i in chosen]
        single = (self._candidate([key for key in keys if self.effects[key] == e]) for e in effects)
        return (*profiles, *single)

    def _candidate(self, keys: Sequence[Key]) -> Candidate:
        """The candidate with these sizes of an effect, in its usual form if they are of two."""
        offered = [c for c in self.offered if c.effect == self.effects[keys[0]]]
        exact = (c for c in offered if [key_of(p) for p in c.free_parameters] == list(keys))
        names = [name for name, _ in keys]
        return next(exact, None) or next(c for c in offered if [p.name for p in c.free_parameters] == names)

    def _with(
        self, at: Fit, columns: Mapping[Key, list[Slopes]], candidates: Collection[Candidate],
        offsets: Mapping[str, float] | None = None,
    ) -> Fit:  # fmt: skip
        """A fit with these candidates and no others, to go on from: where it is, or from other `offsets`."""
        sizes = [p for c in candidates for p in c.free_parameters]
        names, present = {p.name for p in sizes}, at.offset_by_name
        free = (*(p for p in self.secants.base.free_parameters if p.name not in names), *sizes)
        known = {key_of(p): i for i, p in enumerate(at.free_parameters)}
        by_name = {**present, **(offsets or {})}
        values = [by_name.get(p.name, 0.0) for p in free]

        def column(p: FreeParameter, window: int) -> Slopes:
            if key_of(p) in columns:
                return columns[key_of(p)][window]
            if key_of(p) not in known:
                return self.secants.column(p)[window] * np.float32(p.deviation)
            place = known[key_of(p)]
            return at.slopes[window][:, place] * np.float32(p.deviation / at.free_parameters[place].deviation)

        slopes = [np.column_stack([column(p, window) for p in free]) for window in range(len(at.slopes))]
        low, high = np.array([p.low for p in free]), np.array([p.high for p in free])
        return replace(at, free_parameters=free, offsets=np.clip(values, low, high), slopes=slopes)

    def _moved(self, at: Fit, columns: Mapping[Key, list[Slopes]], evidence: SetEvidence, best: Chosen) -> Fit:
        """A fit moved to where a set is likeliest by the slopes of another one, or a part of that way if the simulation
        finds that likelier."""
        unknowns = evidence.of(best).unknowns
        own = (p for p in at.free_parameters if p.place is None)
        likeliest = {p.name: float(unknowns[i]) * self._unit(p) for i, p in enumerate(own)}
        every = [*self.parameters.values(), *(profile.size for profile in self.profiles)]
        for i in best:
            likeliest[every[i].name] = float(unknowns[evidence.sizes[i].unknown]) * every[i].deviation
        for profile, size in zip(self.profiles, evidence.sizes[len(self._sizes) :], strict=True):
            likeliest |= profile.offsets(at, unknowns[list(size.along)])
        candidates = self._candidates(best)
        before, after = self._with(at, columns, candidates), self._with(at, columns, candidates, likeliest)
        tried = []
        for share in EFFORT.shares:
            offsets = before.offsets + share * (after.offsets - before.offsets)
            parameter_set = with_offsets(self.secants.start, before.free_parameters, offsets)
            tried.append(replace(before, offsets=offsets, parameter_set=parameter_set))
        self.residuals.prepare([one.parameter_set for one in tried[: self.residuals.at_once]])
        simulated = [replace(t, residuals=self.residuals(t.parameter_set, self.secants.base.residuals)) for t in tried]
        return max(simulated, key=lambda one: self._likelihood(evidence, one))

    def _likelihood(self, evidence: SetEvidence, at: Fit) -> float:
        """The logarithm of the likelihood of what a fit leaves in each signal of each window."""
        known = zip(at.residuals, self.residuals.layout, strict=True)
        costs = np.concatenate([(r.reshape(len(names), -1) ** 2).sum(axis=1) for r, names in known if len(r)])
        return evidence.likelihood(costs)


def _instead(evidence: SetEvidence, chosen: Chosen, of_others: bool = False) -> list[Chosen]:
    """The likeliest set with something else, or with an effect of the others, in place of each size of a set, where it
    is not far less likely."""
    others: list[Chosen] = []
    for size in chosen:
        exchanged = [o for o in evidence.known if size not in o and len(o) == len(chosen) and len(o - chosen) == 1]
        if of_others:
            effects = {evidence.sizes[i].effect for i in chosen}
            exchanged = [o for o in exchanged if all(evidence.sizes[i].effect not in effects for i in o - chosen)]
        best = max(exchanged, key=lambda other: evidence.of(other).evidence, default=None)
        if best is not None and evidence.of(best).evidence > evidence.of(chosen).evidence - EFFORT.least_likely:
            others.append(best)
    return others
