"""Limits of the monitor, from recordings with nothing hidden, and what a recording looks like against them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.monitor import WINDOW, Limits, Quantity, Range
from vsense_ros.runner.runner import Runner

Array = NDArray[np.float64]

LEAST, MOST = 1.25, 4.0  # margins: one that chance alone asks for, and one beyond which limits would say nothing
CHANCE = 4.5  # standard deviations of a window's mean, or root mean square, that chance alone may come to in an hour
SHARE = 0.9  # of the quantities need no more than the margin that all get


@dataclass(frozen=True)
class Watch:
    """A recording as the monitor saw it: statistics (k, 2, n) of its windows at `t` (k,) [s], and what it said."""

    name: str
    seconds: float
    quantities: tuple[Quantity, ...]
    t: Array
    statistics: Array
    beyond: dict[str, float]  # what left its limits, by when it did first [s]
    content: bytes  # digest of what the observer heard, the same for a copy of the recording
    independent: Array | None = None  # (n,) values of a window that are independent of each other, NaN: not known


@dataclass(frozen=True)
class Calibration:
    """Limits, and the margin that each quantity would need for every recording, left out, to stay within the limits of
    the others; quantities that have no limits, with the reason; names of recordings that are the same drive."""

    limits: Limits
    needed: dict[str, float]
    without: dict[str, str]
    repeated: list[list[str]]

    @property
    def unsure(self) -> list[str]:
        """Quantities that differ more between the recordings than their margin allows for."""
        return [name for name, needed in self.needed.items() if needed > self.limits.quantities[name].margin]


def watch(
    recording: Recording,
    vehicle: Vehicle,
    limits: Limits | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Watch:
    """Run the observer on a recording, and look at the monitor whenever it has judged.

    Raises `InputError` where there is no window to be judged.
    """
    runner = Runner(vehicle, recording.map_origin)
    stamps: list[int] = []
    kept: list[Array] = []

    def keep(stamp: int, statistics: Array) -> None:
        stamps.append(stamp)
        kept.append(statistics.copy())

    monitor = runner.watch(limits, keep)
    topics = tuple(topic for topic in runner.topics if topic in recording)
    total = max(sum(len(recording[topic]) for topic in topics), 1)
    beyond: dict[str, float] = {}
    start = recording.first_stamp
    for i, sample in enumerate(recording.samples(topics)):
        runner.add(sample)
        if len(stamps) and limits is not None:
            for name, since in monitor.beyond.items():
                beyond.setdefault(name, (since - start) * 1e-9)
        if i % 500 == 0:
            progress(i / total)
    if not kept:
        raise InputError(
            f"{recording.name or 'recording'}: nowhere {WINDOW:g} s of driving in which the observer had converged"
        )
    t = (np.array(stamps) - start) * 1e-9
    quantities, content = tuple(monitor.quantities), recording.digest(topics)
    independent = monitor.independent.copy()
    return Watch(recording.name, recording.duration, quantities, t, np.array(kept), beyond, content, independent)


def calibrate(watched: Sequence[Watch], vehicle: Vehicle) -> Calibration:
    """Limits from at least two recordings with nothing hidden.

    They are as far from the middle of what all recordings have as the extremes, times a margin: the least with which
    every recording, left out, stays within the limits of the others, and no less than nine in ten quantities need. A
    few short drives differ by less than chance makes of many windows: limits are nowhere closer than that.
    A drive that is given more than once counts once: left out, it would still be among the others.
    Raises `InputError` for a single drive.
    """
    same: dict[bytes, list[Watch]] = {}
    for one in watched:
        same.setdefault(one.content, []).append(one)
    watched = [first for first, *_ in same.values()]
    repeated = [[one.name for one in drive] for drive in same.values() if len(drive) > 1]
    if len(watched) < 2:
        said = f"; the same drive was given more than once: {', '.join(repeated[0])}" if repeated else ""
        raise InputError(
            f"expected at least two recordings, so that each can be held against the limits of the others{said}"
        )
    needs = np.array([_needed(one, [other for other in watched if other is not one]) for one in watched])
    needed = needs.max(axis=0)
    low, high = _extremes(watched)
    judged = np.flatnonzero(np.isfinite(needed) & np.isfinite(low[0]))
    common = float(np.quantile(needed[judged], SHARE)) if len(judged) else LEAST
    margins = np.clip(np.maximum(needed, common), LEAST, MOST)
    middle, half = (low + high) / 2, np.fmax((high - low) / 2 * margins, _by_chance(watched))
    ranges = {
        watched[0].quantities[i].name: Range(
            unit=watched[0].quantities[i].unit,
            low=middle[0, i] - half[0, i],
            high=middle[0, i] + half[0, i],
            rms=middle[1, i] + half[1, i] if np.isfinite(middle[1, i]) else None,
            margin=margins[i],
        )
        for i in judged
    }
    names, seconds = [one.name for one in watched], sum(one.seconds for one in watched)
    limits = Limits(vehicle=vehicle.name, recordings=names, seconds=seconds, window=WINDOW, quantities=ranges)
    of_judged = {watched[0].quantities[i].name: float(needed[i]) for i in judged}
    without = {
        quantity.name: _why_without(watched, i, needs[:, i])
        for i, quantity in enumerate(watched[0].quantities)
        if quantity.name not in ranges
    }
    return Calibration(limits, of_judged, without, repeated)


def _why_without(watched: Sequence[Watch], i: int, needs: Array) -> str:
    """Why quantity `i` has no limits, with the recordings that are the reason; `needs` (k,) is the margin that each
    would need, left out."""
    lacking = [one.name for one in watched if not np.isfinite(one.statistics[:, 0, i]).any()]
    if lacking:
        by_component = watched[0].quantities[i].unit == "deviations"
        late = ", absent or late: what comes late is not looked at by component" if by_component else ""
        return f"not known in {'any recording' if len(lacking) == len(watched) else ', '.join(lacking)}{late}"
    beyond_all = ~np.isfinite(needs)  # what is left without one of these never changes
    steady = [one.name for j, one in enumerate(watched) if np.delete(beyond_all, j).any()]
    return f"never changes in {', '.join(steady)}"


def _extremes(watched: Sequence[Watch]) -> tuple[Array, Array]:
    """Least and largest of the windows' means and root mean squares, (2, n) each, NaN where there was nothing."""
    every = np.concatenate([one.statistics for one in watched])
    seen = np.isfinite(every).any(axis=0)
    filled = np.where(seen, every, 0.0)
    low, high = np.nanmin(filled, axis=0), np.nanmax(filled, axis=0)
    return np.where(seen, low, np.nan), np.where(seen, high, np.nan)


def _by_chance(watched: Sequence[Watch]) -> Array:
    """How far means and root mean squares (2, n) of a window may be from what they are on average although nothing is
    wrong, NaN where that is not known: a mean of k independent values has their deviation over √k, a root mean square
    of normal ones over √(2k)."""
    every = np.concatenate([one.statistics for one in watched])
    unknown = np.full(every.shape[2], np.nan)
    count = np.min([unknown if one.independent is None else one.independent for one in watched], axis=0)
    seen = np.isfinite(every)
    mean, rms = np.where(seen, every, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    spread = np.where(seen[:, 1].any(axis=0), rms, np.abs(mean)) / np.sqrt(np.where(count > 0, count, np.nan))
    return CHANCE * np.array([spread, spread / np.sqrt(2)])


def _needed(left_out: Watch, others: Sequence[Watch]) -> Array:
    """The margin with which a recording stays within the limits of others, of each quantity, (n,); infinite where
    theirs do not spread."""
    low, high = _extremes(others)
    least, largest = _extremes([left_out])
    middle, half = (low + high) / 2, (high - low) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.maximum(largest - middle, middle - least)[0] / half[0]
        square = (largest - middle)[1] / half[1]
    return np.fmax(np.where(np.isnan(mean), np.inf, mean), square)
