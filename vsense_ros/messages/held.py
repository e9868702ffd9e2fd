"""Values that a faster table repeats until a slower source brings new ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEAST_RUNS = 12
_REGULAR = 0.9  # of the runs of equal values that have the same length, or a multiple of it


def period_of_updates(values: NDArray[np.float64]) -> int | None:
    """In how many rows of (n, m) values each one stands, the same everywhere; None where each row may bring a new one.

    A signal that is quantised, or stands still at times, repeats itself irregularly; one that is held does so by the
    clock.
    """
    if len(values) < 4 * _LEAST_RUNS:
        return None
    changed = (np.diff(np.nan_to_num(values, nan=np.inf), axis=0) != 0).any(axis=1)
    at = np.flatnonzero(changed)
    if len(at) < _LEAST_RUNS or len(at) > 0.7 * len(values):
        return None
    runs = np.diff(at)
    length = int(np.median(runs))
    if length < 2:
        return None
    slack = 0 if length < 4 else 1  # of two clocks
    beside = np.abs(runs - length * np.maximum(np.rint(runs / length), 1))
    usual = np.abs(runs - length) <= slack
    if np.mean(beside <= slack) < _REGULAR or np.mean(usual) < 0.6:
        return None
    return length
