"""How long something took, however often: percentiles in memory that does not grow."""

from __future__ import annotations

from math import log

import numpy as np

_SHORTEST, _LONGEST = 1e-6, 1e3  # [s]
_WIDTH = log(1.01)  # of a class: a percentile is right to half a percent
_CLASSES = int(log(_LONGEST / _SHORTEST) / _WIDTH) + 2
_SHIFT = -log(_SHORTEST) / _WIDTH + 1


class Durations:
    """Counts of durations by classes of equal ratio; what is shorter than a microsecond, or negative, counts as one."""

    def __init__(self) -> None:
        self._counts = [0] * _CLASSES
        self.count = 0

    def add(self, seconds: float) -> None:
        """One more."""
        place = int(log(seconds) / _WIDTH + _SHIFT) if seconds > _SHORTEST else 0
        self._counts[min(place, _CLASSES - 1)] += 1
        self.count += 1

    def percentile(self, percent: float) -> float:
        """The duration [s] that so many are not longer than; not a number without any."""
        if not self.count:
            return float("nan")
        until = np.cumsum(self._counts)
        place = int(np.searchsorted(until, max(percent / 100 * self.count, 1)))
        return float(np.exp((place + 0.5 - _SHIFT) * _WIDTH)) if place else _SHORTEST
