"""Since when something is there that was not there when a recording began.

An effect that begins at a time τ does nothing before it and all that it does after it: its secant is cut off before τ.
That is exact for sensors, and right but for a moment for a car that soon forgets. Each recording has a time of its own.
For each effect the times are found that explain most, with all free parameters of the fit changed as they fit best (the
linear model), and those that explain about as much.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import Fit, products
from vsense_ros.mismatch.answer_schema import Begin
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.signals import SIGNALS, grid
from vsense_ros.mismatch.thresholds import THRESHOLDS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OnsetSettings:
    """Settings of the estimate of when a change set in."""

    rounds: int = 4  # in which the times of all recordings are estimated in turn, each with those of the others held
    block: float = 2.0  # [s] for which residuals of neighbouring instants are correlated, at most
    # Twice the log-likelihood ratio that the true time of a change stays within with 90 %: the largest values
    # of both sides of the walk about it are exponential, (1 − exp(−x/2))² = 0.9 (Siegmund, 1988).
    likelihood_ratio: float = -2 * np.log(1 - np.sqrt(0.9))


ONSET = OnsetSettings()

SMEARED = 0.5 / SIGNALS.cut_off  # [s] by which the filter of the signals moves an edge, at most


@dataclass(frozen=True)
class Onset:
    """An effect that begins within recordings, and what that explains."""

    candidate: Candidate
    size: float  # in its unit
    gain: float  # fall of the fit's value, over that value, or what a good model leaves
    always: float  # the same of the effect where it is there all the time
    begins: tuple[Begin, ...]  # of the recordings within which it begins
    left: list[Array]  # residuals that the linear model leaves, by window


class _Passage:
    """One recording, by instants in their order: what an effect does to the normal equations from each instant on.

    `onto` (n + 1, k) are the products with the slopes of the fit, `right` (n + 1,) those with its residuals, `own`
    (n + 1,) those with itself; the last row is of an effect that never begins.
    """

    def __init__(self, name: str, t: Array, onto: Array, right: Array, own: Array) -> None:
        order = np.argsort(t, kind="stable")
        self.name, self.t = name, t[order]
        self.onto, self.right, self.own = (_from_each_on(rows[order]) for rows in (onto, right, own))


def _from_each_on(rows: Array) -> Array:
    """Sums of the rows from each on, and zero."""
    return np.concatenate([np.cumsum(rows[::-1], axis=0)[::-1], np.zeros((1, *rows.shape[1:]))])


class OnsetSearch:
    """Looks for effects that begin within recordings, beside what a fit has found."""

    def __init__(self, residuals: Residuals, at: Fit) -> None:
        self.at, self._layout = at, residuals.layout
        self._windows = residuals.predictor.dataset.windows
        groups = residuals.predictor.dataset.places_by_recording()
        compared = ([index for index in group if self._layout[index]] for group in groups)
        self._groups = [group for group in compared if group]
        self._instants = [grid(window) for window in self._windows]
        self._whole = max(at.value, float(sum(len(r) for r in at.residuals)))  # no less than a good model leaves
        k = len(at.free_parameters)
        normal = sum(map(products, at.slopes), np.zeros((k, k)))
        self._inverse = np.linalg.inv(normal + at.weight * np.eye(k))
        self._gradient = sum((s.T @ r for s, r in zip(at.slopes, at.residuals, strict=True)), np.zeros(k))
        self._gradient = self._gradient + at.weight * at.scaled_offsets

    def best(self, secants: Iterable[tuple[Candidate, Sequence[Array]]]) -> Onset | None:
        """The effect that explains most if it begins within recordings; None where each explains as much from their
        beginning on. `secants` are by window (rows,), per deviation of the only size of each candidate."""
        onsets = (one for candidate, secant in secants if (one := self._onset_of(candidate, secant)) is not None)
        return max(onsets, key=lambda one: one.gain, default=None)

    def _onset_of(self, candidate: Candidate, secant: Sequence[Array]) -> Onset | None:
        passages = [self._passage(group, secant) for group in self._groups]
        first = [0] * len(passages)
        always = self._gains(passages, first, None)[0]
        climbed = [self._climbed(passages, start) for start in self._starts(passages)]
        begins = max(climbed, key=lambda one: float(self._gains(passages, one, None)[0]))
        if begins == first:
            return None
        gain, change, size = self._solved(passages, begins)
        parameter = candidate.free_parameters[0]
        value = size * parameter.deviation
        if not parameter.low <= value <= parameter.high:
            return None
        cut = self._cut(secant, passages, begins)
        left = [r + s @ change + size * m for r, s, m in zip(self.at.residuals, self.at.slopes, cut, strict=True)]
        bound = ONSET.likelihood_ratio * self._noise(secant, left)
        within = [self._begin(passages, begins, place, bound) for place in range(len(passages))]
        onsets = tuple(one for one in within if one is not None)
        return Onset(candidate, value, gain / self._whole, float(always) / self._whole, onsets, left)

    def _starts(self, passages: Sequence[_Passage]) -> Iterator[list[int]]:
        """Times to begin the search from: always, never, and in each recording that which explains most there by an
        effect of one sign, or of the other."""
        never = [len(passage.t) for passage in passages]
        yield [0] * len(passages)
        yield never
        alone = [self._explained(passages, never, place) for place in range(len(passages))]
        for sign in (1.0, -1.0):
            yield [int(np.argmax(np.where(sign * against >= 0, gains, 0.0))) for against, gains in alone]

    def _climbed(self, passages: Sequence[_Passage], start: Sequence[int]) -> list[int]:
        """Times from which no other time of one recording explains more."""
        begins = list(start)
        for _ in range(ONSET.rounds):
            before = list(begins)
            for place in range(len(passages)):
                begins[place] = int(np.argmax(self._gains(passages, begins, place)))
            if begins == before:
                break
        return begins

    def _passage(self, group: Sequence[int], secant: Sequence[Array]) -> _Passage:
        """The windows of one recording."""
        parts = []
        for index in group:
            signals = len(self._layout[index])
            m = secant[index].reshape(signals, -1)
            slopes = self.at.slopes[index].reshape(signals, m.shape[1], -1)
            rest = self.at.residuals[index].reshape(signals, -1)
            parts.append((np.einsum("st,stk->tk", m, slopes), np.sum(m * rest, axis=0), np.sum(m * m, axis=0)))
        onto, right, own = (np.concatenate(each) for each in zip(*parts, strict=True))
        t = np.concatenate([self._instants[index] for index in group])
        return _Passage(self._windows[group[0]].name, t, onto, right, own)

    def _gains(self, passages: Sequence[_Passage], begins: Sequence[int], free: int | None) -> Array:
        """What is explained with these times of beginning, of one recording (`free`) with each: squared deviations."""
        return self._explained(passages, begins, free)[1]

    def _explained(self, passages: Sequence[_Passage], begins: Sequence[int], free: int | None) -> tuple[Array, Array]:
        """What the size of the effect falls with, of the opposite sign, and what is explained."""
        onto, right, own = self._sums(passages, begins, free)
        against = right - onto @ (self._inverse @ self._gradient)
        alone = own + self.at.weight - np.sum((onto @ self._inverse) * onto, axis=1)
        return against, against**2 / np.maximum(alone, 1e-12)

    @staticmethod
    def _sums(passages: Sequence[_Passage], begins: Sequence[int], free: int | None) -> tuple[Array, Array, Array]:
        """(n, k), (n,) and (n,) products of the effect, where one recording may begin anywhere or none (n = 1)."""
        sums = []
        for name in ("onto", "right", "own"):
            fixed = sum(getattr(p, name)[i] for j, (p, i) in enumerate(zip(passages, begins, strict=True)) if j != free)
            sums.append(np.atleast_1d(fixed) if free is None else fixed + getattr(passages[free], name))
        if free is None:
            sums[0] = sums[0].reshape(1, -1)
        return sums[0], sums[1], sums[2]

    def _solved(self, passages: Sequence[_Passage], begins: Sequence[int]) -> tuple[float, Array, float]:
        """What is explained, the change (k,) of the free parameters of the fit, and the size [deviations]."""
        onto, right, own = (part[0] for part in self._sums(passages, begins, None))
        against = right - onto @ (self._inverse @ self._gradient)
        alone = own + self.at.weight - onto @ self._inverse @ onto
        size = -against / max(alone, 1e-12)
        return float(against**2 / max(alone, 1e-12)), -self._inverse @ (self._gradient + size * onto), float(size)

    def _cut(self, secant: Sequence[Array], passages: Sequence[_Passage], begins: Sequence[int]) -> list[Array]:
        """The secant without what is before the effect begins."""
        switched = list(secant)
        for group, passage, begin in zip(self._groups, passages, begins, strict=True):
            since = passage.t[begin] if begin < len(passage.t) else np.inf
            for index in group:
                on = np.tile(self._instants[index] >= since, len(self._layout[index]))
                switched[index] = np.where(on, secant[index], 0.0)
        return switched

    def _noise(self, secant: Sequence[Array], left: Sequence[Array]) -> float:
        """Variance of what blurs the time: of sums over blocks, so that it counts that neighbours err together."""
        square, size = 0.0, 0.0
        for m, r, names, t in zip(secant, left, self._layout, self._instants, strict=True):
            if not names:
                continue
            product = np.sum((m * r).reshape(len(names), -1), axis=0)
            blocks = np.array_split(product, max(1, round((t[-1] - t[0]) / ONSET.block)))
            square += sum(float(block.sum()) ** 2 for block in blocks)
            size += float(m @ m)
        return square / max(size, 1e-12)

    def _begin(self, passages: Sequence[_Passage], begins: Sequence[int], place: int, bound: float) -> Begin | None:
        """When it begins in a recording; None where it may have been there all the time, or not at all."""
        passage, at = passages[place], begins[place]
        gains = self._gains(passages, begins, place)
        likely = np.flatnonzero(gains >= gains[at] - bound)
        if likely[0] == 0 or likely[-1] == len(passage.t):
            return None
        within = float(passage.t[likely[0] - 1] - SMEARED), float(passage.t[likely[-1]] + SMEARED)
        return Begin(recording=passage.name, at=float(passage.t[at]), interval_90=within)


def onset(
    residuals: Residuals, at: Fit, secants: Iterable[tuple[Candidate, Sequence[Array]]], known: float = 0.0
) -> Onset | None:
    """What begins within recordings, if that is sure: it explains as much more as a term without known physics must
    than the same effect there all the time, and than the gain `known` of what describes the rest otherwise; its time is
    known in a recording; and the signal that is furthest off comes near a good model, or at least much closer to it."""
    best = OnsetSearch(residuals, at).best(secants)
    if best is None or not best.begins or best.gain - max(best.always, known) <= THRESHOLDS.least_term_gain:
        return None
    worst, off = residuals.furthest(at.residuals)
    if not worst:
        return None
    share = residuals.deviations(best.left)[worst] / residuals.deviations(at.residuals)[worst]
    return best if share < max(min(1.0, THRESHOLDS.signal_off / off), THRESHOLDS.mended) else None
