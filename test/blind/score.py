"""Scores of answers against labels, with Wilson intervals (95 %)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from statistics import median

import numpy as np
from scipy.optimize import minimize

from blind import reading
from blind.observing import Observed
from blind.oracle import DETECTABLE, Best
from blind.tool import Answer
from vsense_ros.mismatch.answer_schema import EffectEntry

CONFIDENCES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 1.01)  # bins of what is stated
QUIET = ("no_mismatch", "not_assessable")
SEVERAL = "several"  # kind of case, and name of the set that these are


@dataclass(frozen=True)
class Result:
    """One case with its label, the tool's answer and what was possible."""

    label: dict
    answer: Answer
    best: Best | None  # None: no oracle asked, or it failed
    observed: Observed | None = None  # None: no observer was run, as where nothing is named

    @property
    def kind(self) -> str:
        return self.label["kind"]

    @property
    def scored_with(self) -> str:
        """What it is scored with: cases of the same manoeuvres, or all with several defects at once."""
        return SEVERAL if self.kind == SEVERAL else str(self.label["manoeuvres"])

    @property
    def truth(self) -> set[str]:
        return {hidden["id"] for hidden in self.label["hidden"]}

    @property
    def right(self) -> set[str]:
        """Names that are not wrong: the hidden, and what cannot be distinguished from them."""
        return self.truth | set(self.label["acceptable"])

    @property
    def verdict(self) -> str:
        return reading.verdict(self.answer.explain)

    @property
    def ranked(self) -> list[str]:
        return reading.ranked(self.answer.explain)

    @property
    def named(self) -> list[str]:
        """Names that leave no choice beside them."""
        return self.accepted if self.verdict == "named" else []

    @property
    def accepted(self) -> list[str]:
        return reading.accepted(self.answer.explain)

    @property
    def answer_set(self) -> list[str]:
        return reading.answer_set(self.answer.explain)

    @property
    def wrong(self) -> bool:
        """A name is said that is not right, or more names than are hidden, or a choice in which none is right."""
        if self.verdict == "ambiguous":
            return not set(self.answer_set) & self.right or not set(self.accepted) <= self.right
        return not set(self.accepted) <= self.right or len(self.accepted) > len(self.truth)

    @property
    def detectable(self) -> bool:
        return self.best is None or self.best.detectable


def wilson(hits: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a share."""
    if n == 0:
        return 0.0, 1.0
    share, square = hits / n, z * z
    centre = (share + square / (2 * n)) / (1 + square / n)
    half = z * sqrt(share * (1 - share) / n + square / (4 * n * n)) / (1 + square / n)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def share(values: Iterable[bool]) -> dict:
    """A share with its interval and number."""
    values = list(values)
    hits, n = sum(values), len(values)
    low, high = wilson(hits, n)
    return {"value": hits / n if n else None, "low": low, "high": high, "n": n}


def number(values: Iterable[float], what=median) -> dict:
    values = [v for v in values if v is not None and np.isfinite(v)]
    return {"value": float(what(values)) if values else None, "n": len(values)}


def rightly_named(result: Result) -> tuple[EffectEntry, dict[str, float]] | None:
    """The effect that is stated first and what its parameters should be; None where it is not the hidden one."""
    hidden = result.label["hidden"][0]
    if result.ranked[:1] != [hidden["id"]]:
        return None
    return reading.effects(result.answer.explain)[0], hidden["parameters"]


def parameter_error(result: Result) -> float | None:
    """Relative error of the estimated parameters of a rightly named effect, over the comparable ones."""
    stated = rightly_named(result)
    if stated is None or not stated[1]:
        return None
    return _off(*stated)


def said_rightly(result: Result) -> list[tuple[EffectEntry, dict]]:
    """Those of several hidden effects that are named, each with its label."""
    hidden = {one["id"]: one for one in result.label["hidden"]}
    entries = {entry.id: entry for entry in reading.effects(result.answer.explain)}
    return [(entries[name], hidden[name]) for name in result.accepted if name in hidden]


def size_errors(result: Result) -> list[float]:
    """Relative error of the estimated parameters of each rightly named of several effects, where they are
    comparable."""
    return [_off(entry, label["parameters"]) for entry, label in said_rightly(result) if label["parameters"]]


def _off(effect: EffectEntry, expected: dict[str, float]) -> float:
    found = reading.parameters(effect)
    wrong = sum((found.get(name, 0.0) - value) ** 2 for name, value in expected.items())
    return sqrt(wrong / sum(value**2 for value in expected.values()))


def places_right(result: Result) -> list[bool]:
    """For each rightly named of several effects that has one place: True if wheel, axle, sensor or axis is right."""
    found = []
    for entry, label in said_rightly(result):
        stated = reading.parameters(entry)
        if label["where"] and len(label["parameters"]) == 1 and stated:
            found.append(max(stated, key=lambda name: abs(stated[name])) in label["parameters"])
    return found


def of_several(results: list[Result]) -> dict:
    """All scores of the cases with several defects at once."""
    hidden = [r for r in results if r.truth]
    quiet = [r for r in results if not r.truth]
    possible = [(r, name) for r in hidden for name in sorted(r.truth) if r.best is None or r.best.detects(name)]
    explained = [recovery(r) for r in hidden]
    watched = [r.observed for r in hidden if r.accepted and r.observed is not None]
    return {
        "precision_of_names": share(name in r.right for r in hidden for name in r.accepted),
        "recall_of_detectable": share(name in r.named for r, name in possible),
        "recall_with_sure_of_ambiguous": share(name in r.accepted for r, name in possible),
        "within_reach_of_detectable": share(name in {*r.accepted, *r.answer_set} for r, name in possible),
        "detectable": share(r.best is None or r.best.detects(name) for r in hidden for name in r.truth),
        "named": share(r.verdict == "named" for r in hidden),
        "answers_with_a_wrong_name": share(not set(r.accepted) <= r.right for r in hidden if r.accepted),
        "where_right": share(right for r in hidden for right in places_right(r)),
        "size_error_median": number(error for r in hidden for error in size_errors(r)),
        "explained_share_median": number(explained),
        "explained_share_p10": number(explained, lambda values: np.quantile(values, 0.1)),
        "observer_better": share(one.improved for one in watched),
        "observer_likelier": share(one.likelier for one in watched),
        "false_names_with_nothing_hidden": share(r.verdict not in QUIET for r in quiet),
        "not_assessable": share(r.verdict == "not_assessable" for r in results),
        "no_answer": share(not r.answer.explain for r in results),
        "cpu_seconds_per_100_s": number(_cpu_per_100_s(results)),
    }


def _cpu_per_100_s(results: list[Result]) -> Iterable[float]:
    return (100 * r.answer.cpu / s for r in results if (s := reading.driven(r.answer.explain)))


def intervals_hold(result: Result) -> list[bool]:
    """For each comparable parameter of a rightly named effect: true if it lies in the reported 90 % interval."""
    stated = rightly_named(result)
    if stated is None:
        return []
    effect, expected = stated
    limits = reading.intervals(effect)
    return [limits[name][0] <= value <= limits[name][1] for name, value in expected.items() if name in limits]


def recovery(result: Result) -> float | None:
    """(before − after) / (before − best) on held-out recordings, errors of each signal over what they were before:
    each fit is compared where its car is not lost.

    None where not even the true effect makes the fit better by 2 % of a signal.
    """
    if result.best is None:
        return None
    gained, possible = 0.0, 0.0
    for signal, (before, after) in reading.errors(result.answer.explain).items():
        if before > 0 and signal in result.best.left:
            gained += 1 - after / before
            possible += 1 - result.best.left[signal]
    return gained / possible if possible > 0.02 else None


def located_right(result: Result) -> bool | None:
    """True if wheel, axle, sensor or axis of a rightly named effect is the hidden one; None where there is none."""
    hidden = result.label["hidden"][0]
    if not hidden["where"] or len(hidden["parameters"]) != 1 or result.ranked[:1] != [hidden["id"]]:
        return None
    found = reading.parameters(reading.effects(result.answer.explain)[0])
    return bool(found) and max(found, key=lambda name: abs(found[name])) in hidden["parameters"]


def of_set(results: list[Result]) -> dict:
    """All scores of one manoeuvre set."""
    single = [r for r in results if r.kind == "effect" and r.detectable]
    answers = [r for r in results if r.verdict in ("named", "ambiguous")]
    spoken = [r for r in single if r.verdict in ("named", "ambiguous")]
    doubles = [r for r in results if r.kind == "double" and r.detectable]
    kinds = {kind: [r for r in results if r.kind == kind] for kind in ("nothing", "outside", "inseparable")}
    recoveries = [recovery(r) for r in single]
    where = [found for r in single if (found := located_right(r)) is not None]
    return {
        "top1": share(r.verdict in ("named", "ambiguous") and r.ranked[:1] == list(r.truth) for r in single),
        "top2": share(r.verdict in ("named", "ambiguous") and r.truth <= set(r.ranked[:2]) for r in single),
        "wrong_among_answers": share(r.wrong for r in answers),
        "false_alarms": share(r.verdict not in QUIET for r in kinds["nothing"]),
        "answer_set_coverage": share(r.truth <= set(r.answer_set) for r in spoken),
        "answer_set_size": number((len(r.answer_set) for r in spoken), np.mean),
        "inseparable_covered": share(
            r.verdict == "ambiguous" and r.right <= set(r.answer_set) for r in kinds["inseparable"] if r.answer_set
        ),
        "unknown_recall": share(r.verdict == "unknown" for r in kinds["outside"]),
        "unknown_of_detectable": share(r.verdict == "unknown" for r in kinds["outside"] if r.detectable),
        "recovery_median": number(recoveries),
        "recovery_p10": number(recoveries, lambda values: np.quantile(values, 0.1)),
        "parameter_error_median": number(parameter_error(r) for r in single),
        "intervals_hold": share(held for r in single for held in intervals_hold(r)),
        "where_right": share(where),
        "doubles_both": share(r.truth <= set(r.named) for r in doubles),
        "detectable": share(r.detectable for r in results if r.kind == "effect"),
        "no_answer": share(not r.answer.explain for r in results),
        "cpu_seconds": number(r.answer.cpu for r in results),
        "cpu_seconds_per_100_s": number(_cpu_per_100_s(results)),
    }


def confusion(results: list[Result]) -> dict[str, dict[str, int]]:
    """What was said (a name, or the verdict) where one effect was hidden, nothing, or something outside the library."""
    table: dict[str, Counter] = {}
    for r in results:
        if r.kind in ("effect", "nothing", "outside"):
            said = r.ranked[0] if r.verdict in ("named", "ambiguous") and r.ranked else r.verdict
            table.setdefault(next(iter(r.truth), "nothing"), Counter())[said] += 1
    return {truth: dict(table[truth].most_common()) for truth in sorted(table)}


def shuffled(results: list[Result], seed: int = 0) -> list[Result]:
    """Answers with the labels of other cases of the same set: what chance gives."""
    mixed: list[Result] = []
    for name in sorted({r.scored_with for r in results}):
        group = [r for r in results if r.scored_with == name]
        order = np.random.default_rng(seed).permutation(len(group))
        mixed += [
            Result(group[j].label, r.answer, group[j].best, r.observed) for r, j in zip(group, order, strict=True)
        ]
    return mixed


def leads(results: list[Result]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every single effect that was fitted: its gain over the best other or the smallest that counts, whether
    it is there, and whether the answer has it. Cases with several effects are left out."""
    found, right, stated = [], [], []
    for r in results:
        if r.kind not in ("effect", "nothing", "outside"):
            continue
        gains = {effect.id: min(reading.gains(effect)) for effect in reading.effects(r.answer.explain)}
        for name, gain in gains.items():
            others = [other for one, other in gains.items() if one != name]
            found.append(max(gain, 1e-3) / max([DETECTABLE, *others]))
            right.append(name in r.truth)
            stated.append(name in r.answer_set)
    return np.array(found), np.array(right, bool), np.array(stated, bool)


def reliability(results: list[Result]) -> list[dict]:
    """How often effects are there that are stated with about the same confidence, by bins of it that are not empty: of
    all cases, every effect that was fitted and has a confidence."""
    pairs, found = _stated(results), []
    for low, high in pairwise(CONFIDENCES):
        inside = [(stated, right) for stated, right in pairs if low <= stated < high]
        if inside:
            mean = float(np.mean([stated for stated, _ in inside]))
            found.append(
                {"from": low, "to": min(high, 1.0), "stated": mean, "right": share(right for _, right in inside)}
            )
    return found


def brier(results: list[Result]) -> float:
    """Mean squared difference of stated confidence and what is there, of the same effects as `reliability` (Brier,
    1950): 0 if each is known, 0.25 if each is stated with 0.5."""
    return float(np.mean([(stated - right) ** 2 for stated, right in _stated(results)] or [np.nan]))


def _stated(results: list[Result]) -> list[tuple[float, bool]]:
    """Confidence of each effect that was fitted, and whether it is there."""
    return [(effect.confidence, effect.id in r.right) for r in results for effect in reading.effects(r.answer.explain)]


def relative_errors(results: list[Result]) -> np.ndarray:
    """Relative error of every comparable parameter of a rightly named effect, over its estimate."""
    found = []
    for r in results:
        if r.kind == "effect" and r.detectable:
            effect, expected = rightly_named(r) or (None, {})
            stated = reading.parameters(effect) if effect else {}
            found += [abs(1 - value / stated[name]) for name, value in expected.items() if stated.get(name)]
    return np.array(found)


def trust(leads: np.ndarray, right: np.ndarray) -> tuple[float, float]:
    """Share of names that are right where the lead is clear, and by how much the log odds of the rest fall with the
    lead's logarithm, of greatest likelihood with a weak prior, so that answers without a wrong one give a finite
    slope."""

    def cost(x):
        odds = x[1] * np.log(leads)
        sure = -np.logaddexp(0, -x[0]) - np.logaddexp(0, -odds)  # log of how probable a right name is
        return -np.sum(np.where(right, sure, np.log(-np.expm1(sure)))) + 0.02 * np.sum(np.square(x))

    clear, slope = minimize(cost, [1.0, 4.0], method="Nelder-Mead").x
    return float(1 / (1 + np.exp(-clear))), float(slope)


def calibrated(leads: np.ndarray, right: np.ndarray, stated: np.ndarray, split: str) -> dict[str, tuple[float, str]]:
    """Thresholds of the tool that follow from its answers, by name, each with the data it came from. The arguments are
    those that `leads` gives, of the cases of a split."""
    clear, by_lead = trust(leads[stated], right[stated])
    names = f"{split} split, {stated.sum()} names of which {(right & stated).sum()} are right"
    found = {"clear_name": (round(clear, 2), names), "by_lead": (round(by_lead, 1), names)}
    if (~stated).any():
        refused = (
            f"{split} split, {(~stated).sum()} effects that were refused, of which {(right & ~stated).sum()} are there"
        )
        found["refused"] = (round(float(np.mean(right[~stated])), 2), refused)
    return {name: (value, f"{source}, by `python -m blind calibrate`") for name, (value, source) in found.items()}


def all_sets(results: list[Result]) -> dict[str, dict]:
    """Scores by set."""
    names = sorted({r.scored_with for r in results})
    return {n: (of_several if n == SEVERAL else of_set)([r for r in results if r.scored_with == n]) for n in names}
