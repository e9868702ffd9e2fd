"""Sets of effects that the evidence proposes, fitted in full.

At the base fit, whose parameters may stand in for what is missing, slopes tell little of what a set does where it is
fitted. So the model is made linear again where the likeliest set is likeliest, until that set stays.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.least_squares import Fit, Slopes, fit_each, prior_weight, slopes_by
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.evidence import EVIDENCE, Chosen, Products, SetEvidence, Size
from vsense_ros.mismatch.fitting import Fitting
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import Secants
from vsense_ros.model.effects import EVERY, Effect

Array = NDArray[np.float64]
Key = tuple[str, str]  # name and form of a free parameter


def key_of(parameter: FreeParameter) -> Key:
    """By which a free parameter is found again in another fit."""
    return parameter.name, parameter.form


class Proposing:
    """Proposes sets of the candidates that are `offered`, beside a hypothesis or, without one, the base fit."""

    def __init__(
        self, secants: Secants, fitting: Fitting, offered: Sequence[Candidate], beside: Hypothesis | None = None
    ) -> None:
        self.secants, self.fitting, self.residuals = secants, fitting, secants.residuals
        self.begin, self.beside = (secants.base, ()) if beside is None else (beside.fit, beside.candidates)
        present = {candidate.effect for candidate in self.beside}
        self.offered = [c for c in offered if not c.along_road and c.effect not in present]
        self.effects = {key_of(p): c.effect for c in self.offered for p in c.free_parameters}
        self.parameters = {key_of(p): p for c in self.offered for p in c.free_parameters}
        self._joint = {c.effect for c in self.offered if len(c.free_parameters) > 1}

    def proposed(self) -> list[Hypothesis]:
        """The likeliest set, and what is instead of each of its effects; none if nothing is likelier than something."""
        at, columns = self.begin, self._columns_at(self.begin)
        chosen: Chosen = frozenset()
        rounds = max(1, min(EFFORT.rounds, int(EFFORT.linear_again / sum(self._durations))))
        for _ in range(rounds):
            evidence = self._evidence(at, columns)
            best = evidence.search(chosen)
            at, same, chosen = self._moved(at, columns, evidence, best), best == chosen, best
            if same or not best:
                break
            at = replace(at, slopes=self.secants.all_slopes_at(at))
            columns = self._columns_at(at)
        if not chosen:
            return []
        at = replace(at, weight=prior_weight(at.residuals))
        sets = [self._candidates(chosen), *map(self._candidates, _instead(evidence, chosen))]
        joints = [(candidates, self._with(at, columns, candidates)) for candidates in sets]
        return self._fitted(joints, evidence.probabilities())

    def without_each(self, hypothesis: Hypothesis) -> list[Hypothesis]:
        """A hypothesis without each of its effects, fitted."""
        rests = [tuple(c for c in hypothesis.candidates if c is not out) for out in hypothesis.candidates]
        joints = [(rest, self._with(hypothesis.fit, {}, rest)) for rest in rests if rest]
        return self._fitted(joints, hypothesis.evident)

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
        places = {key_of(p): i for i, p in enumerate(at.free_parameters)}
        places |= {key: len(places) + i for i, key in enumerate(columns)}
        factors = np.array([self._unit(p) / p.deviation for p in at.free_parameters])
        sizes = []
        for key, p in self.parameters.items():
            effect = self.effects[key]
            little = EVIDENCE.form if p.form else EVERY.get(effect, Effect).little
            if not p.form and p.name in usual:
                little = max(little, usual[p.name] / p.deviation)
            low, high = p.low / p.deviation - EVIDENCE.settled, p.high / p.deviation + EVIDENCE.settled
            joins = effect in self._joint
            sizes.append(Size(places[key], effect, p.name, low, high, min(little, EVIDENCE.most_little), joins))
        slopes = [
            np.column_stack([own * factors, *(column[window] for column in columns.values())])
            for window, own in enumerate(at.slopes)
        ]
        present = np.append(at.scaled_offsets / factors, np.zeros(len(columns)))
        products = Products.of(at.residuals, slopes, [len(names) for names in self.residuals.layout], self._durations)
        return SetEvidence(products, present, sizes)

    @cached_property
    def _durations(self) -> list[float]:
        return [w.end - w.begin - w.run_in for w in self.residuals.predictor.dataset.windows]

    def _unit(self, parameter: FreeParameter) -> float:
        """The deviation of a free parameter; of one that every car has a little of, where it is in a set."""
        return self.parameters.get(key_of(parameter), parameter).deviation

    def _columns_at(self, at: Fit) -> dict[Key, list[Slopes]]:
        """Secants by all sizes that a fit does not have, per deviation, by window."""
        present = {key_of(p) for p in at.free_parameters}
        new = [p for key, p in self.parameters.items() if key not in present]
        if at is self.secants.base:
            self.secants.simulate_new(self.offered)
            return {key_of(p): [part * np.float32(p.deviation) for part in self.secants.column(p)] for p in new}
        secants = slopes_by(self.residuals, self.secants.start, at, new, EFFORT.secant)
        return {key_of(p): secant for p, secant in zip(new, secants, strict=True)}

    def _candidates(self, chosen: Chosen) -> tuple[Candidate, ...]:
        """What a set stands for: an effect in each candidate."""
        keys = [key for i, key in enumerate(self.parameters) if i in chosen]
        effects = dict.fromkeys(self.effects[key] for key in keys)
        return (*self.beside, *(self._candidate([key for key in keys if self.effects[key] == e]) for e in effects))

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
        likeliest = {p.name: float(unknowns[i]) * self._unit(p) for i, p in enumerate(at.free_parameters)}
        for i, p in enumerate(self.parameters.values()):
            if i in best:
                likeliest[p.name] = float(unknowns[evidence.sizes[i].unknown]) * p.deviation
        candidates = self._candidates(best)
        before, after = self._with(at, columns, candidates), self._with(at, columns, candidates, likeliest)
        tried = []
        for share in EFFORT.shares:
            offsets = before.offsets + share * (after.offsets - before.offsets)
            parameter_set = with_offsets(self.secants.start, before.free_parameters, offsets)
            tried.append(replace(before, offsets=offsets, parameter_set=parameter_set))
        self.residuals.prepare([one.parameter_set for one in tried[: self.residuals.at_once]])
        simulated = [replace(t, residuals=self.residuals(t.parameter_set, self.secants.base.residuals)) for t in tried]
        return max(simulated, key=lambda one: evidence.likelihood(self._costs(one.residuals)))

    def _costs(self, residuals: Sequence[Array]) -> Array:
        """Sums of squares of each signal of each window."""
        known = zip(residuals, self.residuals.layout, strict=True)
        return np.concatenate([(r.reshape(len(names), -1) ** 2).sum(axis=1) for r, names in known if len(r)])


def _instead(evidence: SetEvidence, chosen: Chosen) -> list[Chosen]:
    """The likeliest set with something else in place of each size of a set, where it is not far less likely."""
    others: list[Chosen] = []
    for size in chosen:
        exchanged = [o for o in evidence.known if size not in o and len(o) == len(chosen) and len(o - chosen) == 1]
        best = max(exchanged, key=lambda other: evidence.of(other).evidence, default=None)
        if best is not None and evidence.of(best).evidence > evidence.of(chosen).evidence - EFFORT.least_likely:
            others.append(best)
    return others
