"""Values that a faster table repeats until a slower source brings new ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.setting import JUDGEMENT, setting


@dataclass(frozen=True)
class HeldSettings:
    """By which values that are held are distinguished from those that rest."""

    least_runs: int = setting(12, "-", "of equal values, of fewer of which nothing is said", JUDGEMENT)
    most_changes: float = setting(0.7, "-", "share of rows that bring a new value, above which none is held")
    regular: float = setting(0.9, "-", "share of runs that have the usual length, or a multiple of it")
    usual: float = setting(0.6, "-", "share of runs that have the usual length")
    exact: int = setting(4, "-", "rows of a run, below which two clocks make no difference of one", JUDGEMENT)
    one_step: float = setting(
        0.95, "-", "share of changes by one step, from which on a coarse signal creeps", JUDGEMENT
    )


SETTINGS = HeldSettings()


def first_of_each(values: NDArray[np.float64], every: int) -> NDArray[np.bool_]:
    """The rows (n,) of (n, m) values at which a source brought new ones, which each stand in `every` rows.

    Where the source rests, the same value comes again after as many rows.
    """
    rows = np.arange(len(values))
    known = np.nan_to_num(values)
    changed = np.concatenate([[True], (known[1:] != known[:-1]).any(axis=1)])
    since = rows - np.maximum.accumulate(np.where(changed, rows, 0))
    fresh: NDArray[np.bool_] = changed | (since % every == 0)
    return fresh


def period_of_updates(values: NDArray[np.float64]) -> int | None:
    """In how many rows of (n, m) values each one stands, the same everywhere; None where each row may bring a new one.

    A signal that is quantised, or stands still at times, repeats itself irregularly; one that is held does so by the
    clock. One that is quantised and rises evenly seems to, and is known by changing by one step at a time.
    """
    if len(values) < 4 * SETTINGS.least_runs:
        return None
    changed = (values[1:] != values[:-1]).any(axis=1)  # an absent value is none that is held
    at = np.flatnonzero(changed)
    if len(at) < SETTINGS.least_runs or len(at) > SETTINGS.most_changes * len(values):
        return None
    runs = np.diff(at)
    length = int(np.median(runs))
    if length < 2:
        return None
    slack = 0 if length < SETTINGS.exact else 1
    beside = np.abs(runs - length * np.maximum(np.rint(runs / length), 1))
    usual = np.abs(runs - length) <= slack
    if np.mean(beside <= slack) < SETTINGS.regular or np.mean(usual) < SETTINGS.usual:
        return None
    return None if _one_step_at_a_time(values) else length


def _one_step_at_a_time(values: NDArray[np.float64]) -> bool:
    """True if each column of (n, m) values hardly changes by more than its smallest change."""
    changes = np.abs(np.diff(values, axis=0))
    changes[~(changes > 0)] = np.nan
    return all(
        np.mean(of < 1.5 * of.min()) >= SETTINGS.one_step
        for column in changes.T
        if len(of := column[np.isfinite(column)])
    )
