"""Sums of whitened innovations over several times (Mehra 1970): if a filter is right, they are normal numbers.

No filter of a real car is quite right. What it leaves over of this axis of this car, on this road, is what the sums
usually are: their mean square with forgetting (covariance matching, Mehra 1972), which is estimated before an axis is
judged by them. A model that is usually off by three deviations accuses nobody of ten.
"""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import NDArray

from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]

WINDOWS = np.array([1, 2, 10, 50])  # blocks of the sums that are looked at: the first two for jumps
SHORT = 2  # which of them is that of 0.2 s
# Which blocks, of a ring of as many as are looked at, each sum is of when the newest is at a place of it.
_ADDED = 1.0 * ((np.arange(50)[:, None, None] - np.arange(50)) % 50 < WINDOWS[:, None])
_sum = np.add.reduce


class Sums:
    """Sums of the whitened innovations of a sensor over the last blocks: `totals` and `counts` (4, m) for each of
    `WINDOWS`, where m are its axes and the conditions behind them.

    `usual` (4, m) is the mean square of each sum, in variances that the filter states, 1 where it is less.

    It is called with every message: all views are made ahead, and beside its total each component has its number times
    its `alarm`², so that one product gives the limit of each squared sum.
    """

    def __init__(self, axes: int, conditions: int = 0) -> None:
        m = axes + conditions
        self.alarm = np.array([VOTE.alarm] * axes + [VOTE.alarm_of_conditions] * conditions)
        self._limit = self.alarm**2
        rows, blocks = np.tile(self._limit, (VOTE.rows, 2)), np.zeros((len(_ADDED), 2 * m))
        self._components, self._rows, self._blocks = m, rows, blocks
        self._values = [row[:m] for row in rows]
        self._first = [rows[:k] for k in range(VOTE.rows + 1)]
        self._sums, self._totals = list(blocks), [block[:m] for block in blocks]
        self._windows = np.zeros((len(WINDOWS), 2 * m))
        self.totals, self._limits = self._windows[:, :m], self._windows[:, m:]
        self._square, self._beyond = np.zeros((len(WINDOWS), m)), np.zeros((len(WINDOWS), m), dtype=bool)
        self._row, self._block, self._until, self.begun = 0, 0, 0, False
        self.usual, self._axes, self._seen = np.ones((len(WINDOWS), m)), axes, 0

    @property
    def counts(self) -> Array:
        """How many innovations each sum is of (4, m)."""
        return np.rint(self._limits / self._limit)

    def clear(self) -> None:
        """Forget everything."""
        self._row, self._blocks[:], self._windows[:], self.begun = 0, 0.0, 0.0, False

    def forget(self, component: int) -> None:
        """Forget the innovations of one component."""
        self._rows[:, component] = 0.0
        for part in (self._blocks, self._windows):
            part[:, [component, self._components + component]] = 0.0

    def add(self, stamp: int, whitened: Array) -> bool:
        """Take in a message (m,), NaN where a component was absent; True where it ends a block after which a sum is as
        far from zero as `VOTE.alarm`."""
        row, place = self._row, self._block
        self._values[row][:] = whitened
        self._row = row = row + 1
        if stamp < self._until and row < VOTE.rows:
            return False
        total = self._totals[place]
        _sum(self._first[row], axis=0, out=self._sums[place])
        if not isfinite(total.dot(total)):
            values = self._first[row][:, : self._components]
            there = values == values
            _sum(np.where(there, values, 0.0), axis=0, out=total)
            np.multiply(_sum(there, axis=0), self._limit, out=self._sums[place][self._components :])
        np.dot(_ADDED[place], self._blocks, out=self._windows)
        self._block = place + 1 if place + 1 < len(_ADDED) else 0
        self._row, self._until, self.begun = 0, stamp + VOTE.block, True
        np.divide(np.square(self.totals, out=self._square), self.usual, out=self._square)
        self._seen += 1
        if self._seen >= WINDOWS[SHORT]:
            self._average()
        return bool(np.count_nonzero(np.greater(self._square, self._limits, out=self._beyond)))

    def _average(self) -> None:
        """Take in what the sums of the axes are now; a single large one says little of what they usually are."""
        self._seen, axes = 0, slice(self._axes)
        usual, counts = self.usual[:, axes], self.counts[:, axes]
        square = self._square[:, axes] / np.maximum(counts, 1.0) * usual
        share = VOTE.block * WINDOWS.item(SHORT) / VOTE.memory
        change = np.where(counts > 0, np.minimum(square, VOTE.unusual * usual) - usual, 0.0)
        np.maximum(usual + share * change, 1.0, out=usual)

    def far(self) -> Array:
        """How far each sum is from zero (4, m) [usual deviations]."""
        return np.asarray(np.abs(self.totals) / np.sqrt(np.maximum(self.counts, 1.0) * self.usual))
