"""What decides about evidence, from what answers say of it: each number is where a curve over cars is best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from blind.score import Result
from vsense_ros.mismatch.answer_schema import Likely
from vsense_ros.mismatch.thresholds import THRESHOLDS, Thresholds

OWN = tuple(name for name in Thresholds.__dataclass_fields__ if name.startswith("little_"))
GAINS = np.array([0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.1])  # of an effect, of what the others leave
LITTLES = np.round(np.geomspace(0.01, 1.0, 21), 3)  # over a typical size
ODDS = np.round(np.geomspace(0.001, 0.3, 16), 4)
RIGHT = 0.95  # asked share of right names
SURE = 1e-4  # as which a smaller probability counts


@dataclass(frozen=True)
class Curve:
    """What a number was chosen by: a criterion over values of it, the larger the better."""

    name: str
    criterion: str  # in words
    values: np.ndarray
    found: np.ndarray  # the criterion
    best: float
    source: str


def curves(results: Sequence[Result], split: str) -> list[Curve]:
    """The curves of all numbers for which there are answers enough."""
    every = [*_littles(results, split), _least_gain(results, split), _odds(results, split)]
    return [curve for curve in every if curve is not None]


def _littles(results: Sequence[Result], split: str) -> list[Curve]:
    """What every car has a little of, from cars with nothing hidden: the deviation with which the likeliest sizes are
    likeliest, given how well each is known. What the prior has added to a size is taken away first."""
    sizes: dict[str, list[tuple[float, float]]] = {}
    quiet = [r.answer.explain for r in results if not r.label["hidden"] and r.answer.explain]
    for explain in quiet:
        for likely in explain.evidence:
            own = f"little_{likely.effect}"
            sizes.setdefault(own if own in OWN else "little", []).extend(_by_data_alone(likely))
    found = []
    for name, pairs in sizes.items():
        if pairs:
            value, variance = np.array(pairs).T
            total = LITTLES[:, None] ** 2 + variance
            likelihood = -0.5 * np.sum(np.log(total) + value**2 / total, axis=1)
            source = f"{split} split, {len(pairs)} sizes of {len(quiet)} cars with nothing hidden"
            found.append(
                Curve(name, "log-likelihood", LITTLES, likelihood, float(LITTLES[np.argmax(likelihood)]), source)
            )
    return found


def _by_data_alone(likely: Likely) -> list[tuple[float, float]]:
    """Likeliest values and variances of the sizes of an effect of which every car has a little, without that prior."""
    found = []
    for size in likely.sizes:
        information = size.deviation**-2 - size.prior**-2
        if np.isclose(size.prior, THRESHOLDS.little_of(likely.effect)) and information > 1.0:
            found.append((size.likeliest / size.deviation**2 / information, 1 / information))
    return found


def _least_gain(results: Sequence[Result], split: str) -> Curve | None:
    """The least gain of an effect of which the evidence is sure: the least from which on as many names are right as is
    asked; if none is enough, the one with most right names."""
    adds = [
        (one.adds, one.effect in r.right)
        for r in results
        if r.answer.explain
        for one in r.answer.explain.evidence
        if one.adds is not None and one.probability >= THRESHOLDS.trusted
    ]
    if not adds:
        return None
    gain, right = np.array(adds).T
    shares = np.array([right[gain > least].mean() if (gain > least).any() else 0.0 for least in GAINS])
    enough = np.flatnonzero(shares >= RIGHT)
    best = GAINS[enough[0] if len(enough) else int(np.argmax(shares))]
    source = f"{split} split, {len(adds)} effects of proposed sets of which {int(right.sum())} are there"
    return Curve("evident_gain", "share of names that are right", GAINS, shares, float(best), source)


def _odds(results: Sequence[Result], split: str) -> Curve | None:
    """The prior probability of a size with which the probabilities of effects are likeliest: other odds change the
    odds of each effect by the same factor, as long as the sets stay the same."""
    stated = [
        (one.probability, one.effect in r.right)
        for r in results
        if r.answer.explain
        for one in r.answer.explain.evidence
    ]
    if not stated:
        return None
    probability, right = np.array(stated).T
    probability = np.clip(probability, SURE, 1 - SURE)
    logit, before = _logit(probability), _logit(np.array(THRESHOLDS.odds))
    shifted = logit[None, :] + (_logit(ODDS) - before)[:, None]
    score = -np.sum(np.logaddexp(0, np.where(right > 0, -shifted, shifted)), axis=1)
    source = f"{split} split, {len(stated)} effects of which {int(right.sum())} are there"
    return Curve("odds", "log-likelihood", ODDS, score, float(ODDS[np.argmax(score)]), source)


def _logit(share: np.ndarray) -> np.ndarray:
    return np.log(share / (1 - share))


def found(curves: Sequence[Curve]) -> Mapping[str, tuple[float, str]]:
    """The numbers that are best by these curves, each with the data it came from."""
    return {one.name: (one.best, f"{one.source}, by `python -m blind calibrate`") for one in curves}
