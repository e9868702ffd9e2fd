"""Which set of effects explains what a fit leaves, by its evidence: linear algebra on products that are made once.

Residuals r of a block (one signal of one window) become r + J δ when the unknowns change by δ. Their sum of squares,
SS = c + 2 gᵀδ + δᵀNδ with N = JᵀJ, g = Jᵀr and c = rᵀr, needs no further simulation. Three assumptions make a
probability of it:

- A block of n rows has m independent samples, as model errors last as long as a manoeuvre. They are normal, of an
  unknown variance that is expected to be one: log p(r | δ) = −(m + a)/2 · log((m/n · SS + a) / (m + a)), Student's t by
  block (Lange, Little & Taylor 1989), where a is how many samples the expectation counts for. A block that nothing
  explains cannot dominate.
- Every unknown is normal with mean zero. A size of the set has its typical value as deviation, any other a small share
  of that: every car has a little of everything, and small errors of form shall not become names (a continuous spike
  and slab, George & McCulloch 1993, Ishwaran & Rao 2005).
- Each size is there with the same small odds.

So a set only says which deviations are large. Its evidence is Laplace's (Kass & Raftery 1995), at the likeliest δ. What
one or two sizes more or fewer would change follows in closed form from the mean and the covariance there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.thresholds import THRESHOLDS

Array = NDArray[np.float64]
Chosen = frozenset[int]  # indices of sizes


@dataclass(frozen=True)
class EvidenceSettings:
    """What the evidence of sets rests on: decisions of this project."""

    samples: float = 0.5  # [1/s] independent samples in a signal: a manoeuvre lasts a few seconds
    expected: float = 0.5  # [1/s] what the expected variance counts, in samples
    form: float = 1e-3  # [-] deviation, over the typical size, of a form of an effect that is not the usual one
    most_little: float = 0.95  # [-] up to which a size is narrower where it is not in the set
    smooth: float = 100.0  # [m] over which the slope of a road stays about the same
    visible: float = 0.3  # [-] information on a direction of a profile, over that of its prior, from where on it counts
    directions: int = 16  # of a profile that are considered; on a long road one for every two places
    # [-] odds, over those of others, of a profile of the road, as its many sizes stand in for whatever acts along the
    # car, and once more of an effect beside one that is mistaken for it: how the surface bends where a car weaves is
    # known roughly, and looks like a sensor that is turned
    doubtful: float = 0.007
    odds: float = THRESHOLDS.odds  # [-] that a size is there
    most: int = 8  # sizes in a set
    tried: int = 16  # of the changes of a set that promise most, computed in full
    reweighted: int = 20  # times at most
    settled: float = 1e-3  # [deviations] of change at which reweighting ends


EVIDENCE = EvidenceSettings()


@dataclass(frozen=True)
class Products:
    """Products of residuals and their slopes by k unknowns, in units of which those are one deviation."""

    normal: Array  # (blocks, k, k)
    right: Array  # (blocks, k)
    costs: Array  # (blocks,)
    rows: Array  # (blocks,)
    durations: Array  # (blocks,) [s]

    @classmethod
    def of(
        cls, residuals: Sequence[Array], slopes: Iterable[NDArray[np.floating]], signals: Sequence[int],
        durations: Sequence[float],
    ) -> Products:  # fmt: skip
        """The products of windows with residuals (signals × instants,), slopes (signals × instants, k), so many
        `signals`, and `durations` [s]; windows without residuals are left out."""
        blocks = []
        for r, s, count, duration in zip(residuals, slopes, signals, durations, strict=True):
            if len(r):
                for rest, slope in zip(np.split(r, count), np.split(s.astype(np.float64), count), strict=True):
                    blocks.append((slope.T @ slope, slope.T @ rest, rest @ rest, float(len(rest)), duration))
        return cls(*(np.array(parts) for parts in zip(*blocks, strict=True)))


@dataclass(frozen=True)
class Size:
    """One size that may be in a set."""

    unknown: int  # index
    effect: str
    name: str  # of two sizes of the same name, which are forms of an effect, one is in a set
    low: float  # [deviations]
    high: float  # [deviations]
    little: float  # [-] its deviation where it is not in the set, over that where it is
    joins: bool = True  # if others of the effect may be in a set with it
    plane: bool = False  # if it is the slope of a plane, which a profile has in it
    along: tuple[int, ...] = ()  # indices of further unknowns that are large with it: a profile along the road
    mistaken: tuple[str, ...] = ()  # effects that such a profile is mistaken for


@dataclass(frozen=True)
class Posterior:
    """A set with the likeliest unknowns."""

    evidence: float  # logarithm
    unknowns: Array  # (k,) [deviations]
    covariance: Array  # (k, k)


class SetEvidence:
    """The evidence of sets of sizes. `present` (k,) are the unknowns where the products were made [deviations]."""

    def __init__(
        self, products: Products, present: Array, sizes: Sequence[Size], settings: EvidenceSettings = EVIDENCE
    ) -> None:
        self.products, self.present, self.sizes, self.settings = products, present, sizes, settings
        self._samples = settings.samples * products.durations
        self._expected = settings.expected * products.durations
        self.known: dict[Chosen, Posterior] = {}
        self._weights = np.ones(len(products.rows))

    @cached_property
    def _unknowns(self) -> NDArray[np.int64]:
        return np.array([size.unknown for size in self.sizes], int)

    @cached_property
    def _precisions(self) -> Array:
        """(sizes,) inverse prior variances of sizes that are not in a set."""
        return np.array([size.little for size in self.sizes]) ** -2.0

    def _precision(self, chosen: Chosen) -> Array:
        """(k,) inverse prior variances of the unknowns with a set."""
        precision = np.ones(len(self.present))
        for size in self.sizes:
            precision[[size.unknown, *size.along]] = size.little**-2.0
        for i in chosen:
            precision[[self.sizes[i].unknown, *self.sizes[i].along]] = 1.0
        return precision

    def _log_odds(self, chosen: Chosen) -> float:
        """Logarithm of the prior odds of a set against none."""
        odds, sizes = self.settings.odds, [self.sizes[i] for i in chosen]
        doubtful = sum(bool(one.along) + sum(size.effect in one.mistaken for size in sizes) for one in sizes)
        return len(chosen) * float(np.log(odds / (1 - odds))) + doubtful * float(np.log(self.settings.doubtful))

    def likelihood(self, costs: Array) -> float:
        """The logarithm of the likelihood of sums of squares (blocks,)."""
        m, a = self._samples, self._expected
        return float(-0.5 * np.sum((m + a) * np.log((m * costs / self.products.rows + a) / (m + a))))

    def _squares(self, change: Array) -> Array:
        """(blocks,) sums of squares after a change of the unknowns."""
        p = self.products
        return np.asarray(np.maximum(p.costs + 2 * p.right @ change + (p.normal @ change) @ change, 0.0))

    def of(self, chosen: Chosen) -> Posterior:
        """A set with its evidence."""
        if chosen not in self.known:
            self.known[chosen] = self._posterior(chosen)
        return self.known[chosen]

    def _posterior(self, chosen: Chosen) -> Posterior:
        """The likeliest unknowns with a set, by reweighted least squares, and Laplace's evidence there."""
        p, m, a = self.products, self._samples, self._expected
        precision = self._precision(chosen)
        weights = self._weights
        change: Array = np.zeros(len(self.present))
        for _ in range(self.settings.reweighted):
            information = np.tensordot(weights, p.normal, 1) + np.diag(precision)
            last = change
            change = np.asarray(np.linalg.solve(information, -(weights @ p.right) - precision * self.present), float)
            weights = (m + a) / (m * self._squares(change) / p.rows + a) * m / p.rows
            if np.abs(change - last).max() < self.settings.settled:
                break
        self._weights = weights
        unknowns = self.present + change
        likelihood = self.likelihood(self._squares(change))
        prior = 0.5 * np.sum(np.log(precision)) - 0.5 * np.sum(precision * unknowns**2)
        volume = -0.5 * np.linalg.slogdet(information)[1]
        evidence = float(prior + volume) + likelihood + self._log_odds(chosen)
        if not all(self.sizes[i].low <= unknowns[self.sizes[i].unknown] <= self.sizes[i].high for i in chosen):
            evidence = -np.inf
        return Posterior(evidence, unknowns, np.asarray(np.linalg.inv(information), float))

    def _may_be(self, chosen: Chosen) -> bool:
        """True if a set is not too large, has each effect in one form, and no plane beside a profile of the road."""
        names = [self.sizes[i].name for i in chosen]
        effects = Counter(self.sizes[i].effect for i in chosen)
        one = all(effects[self.sizes[i].effect] == 1 or self.sizes[i].joins for i in chosen)
        chosen_sizes = [self.sizes[i] for i in chosen]
        if any(size.plane for size in chosen_sizes) and any(size.along for size in chosen_sizes):
            return False
        return one and len(names) == len(set(names)) <= self.settings.most

    def neighbours(self, chosen: Chosen) -> list[Chosen]:
        """The sets that promise most of all that differ from this one by one or two sizes, more or fewer: what their
        evidence would be if the blocks kept their variances."""
        at = self.of(chosen)
        x, c = at.unknowns[self._unknowns], at.covariance[np.ix_(self._unknowns, self._unknowns)]
        inside = np.array([i in chosen for i in range(len(self.sizes))])
        precision = self._precision(chosen)
        new, old = np.where(inside, self._precisions, 1.0), precision[self._unknowns]
        more = new - old  # of precision
        normed = 0.5 * np.log(new / old)
        one = normed - 0.5 * np.log1p(more * np.diag(c)) - 0.5 * more * x**2 / (1 + more * np.diag(c))
        # Two at once, by the 2 × 2 matrix 1/more + c.
        with np.errstate(divide="ignore", invalid="ignore"):
            own = 1 / more + np.diag(c)
            determinant = np.outer(own, own) - c**2
            squares = np.outer(own, x**2)
            quadratic = (squares + squares.T - 2 * c * np.outer(x, x)) / determinant
            two = np.add.outer(normed, normed) - 0.5 * np.log(determinant * np.outer(more, more)) - 0.5 * quadratic
        along = {i for i, size in enumerate(self.sizes) if size.along}
        promised: dict[Chosen, float] = {}
        for i, gain in enumerate(one):
            promised[chosen ^ {i}] = float(gain)
        for i, j in np.argwhere(np.triu(np.isfinite(two), 1)):
            promised[chosen ^ {int(i), int(j)}] = float(two[i, j])
        for i in along:
            for j in range(len(self.sizes)):
                promised[chosen ^ {i, j}] = self._promised_by(at, precision, self._precision(chosen ^ {i, j}))
        ranked = sorted(promised, key=lambda other: promised[other] + self._log_odds(other), reverse=True)
        return [other for other in ranked if self._may_be(other)][: self.settings.tried]

    @staticmethod
    def _promised_by(at: Posterior, old: Array, new: Array) -> float:
        """By how much the logarithm of the evidence changes with the prior precisions (k,) of any unknowns, if the
        blocks keep their variances."""
        changed = np.flatnonzero(old != new)
        more, x = (new - old)[changed], at.unknowns[changed]
        wider = np.eye(len(changed)) + at.covariance[np.ix_(changed, changed)] * more
        quadratic = x @ (more * np.linalg.solve(wider, x))
        normed = np.sum(np.log(new[changed] / old[changed])) - np.linalg.slogdet(wider)[1]
        return float(0.5 * (normed - quadratic))

    def search(self, begin: Chosen = frozenset()) -> Chosen:
        """The best set that is found from one by changing one or two of its sizes at a time."""
        best = begin
        while True:
            around = self.neighbours(best)
            around += [best - {i} for i in best]
            likeliest = max(around, key=lambda other: self.of(other).evidence, default=best)
            if self.of(likeliest).evidence <= self.of(best).evidence:
                return best
            best = likeliest

    def weights(self) -> dict[Chosen, float]:
        """The probability of each set that was computed in full, of all of these, the likeliest first."""
        sets = sorted(self.known, key=lambda chosen: self.known[chosen].evidence, reverse=True)
        evidence = np.array([self.known[chosen].evidence for chosen in sets])
        relative = np.exp(evidence - evidence.max())
        return dict(zip(sets, (relative / relative.sum()).tolist(), strict=True))

    def probabilities(self) -> dict[str, float]:
        """How probable each effect is that is in any of these sets."""
        probabilities: dict[str, float] = {}
        for chosen, weight in self.weights().items():
            for effect in {self.sizes[i].effect for i in chosen}:
                probabilities[effect] = probabilities.get(effect, 0.0) + weight
        return probabilities
