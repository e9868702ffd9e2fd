"""Limits of the monitor, from recordings with nothing hidden, and what a recording looks like against them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.monitor import WINDOW, Limits, Quantity, Range
from vsense_ros.observer.observer import Observer
from vsense_ros.observer.run import map_origin
from vsense_ros.recording import Recording

Array = NDArray[np.float64]

MARGINS = (
    1.25,
    1.5,
    2.0,
    2.5,
    3.0,
    4.0,
)  # of which the least is taken that lets every recording pass the others' limits


@dataclass(frozen=True)
class Watch:
    """A recording as the monitor saw it: statistics (k, 2, n) of its windows at `t` (k,) [s], and what it said."""

    name: str
    seconds: float
    quantities: tuple[Quantity, ...]
    t: Array
    statistics: Array
    beyond: dict[str, float]  # what left its limits, by when it did first [s]


@dataclass(frozen=True)
class Calibration:
    """Limits, and how many recordings, each left out, would have left those of the others with each margin tried."""

    limits: Limits
    false_alarms: dict[float, int]


def watch(
    recording: Recording,
    vehicle: Vehicle,
    limits: Limits | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Watch:
    """Run the observer on a recording, and look at the monitor whenever it has judged.

    Raises `InputError` where there is no window to be judged.
    """
    observer = Observer(vehicle, map_origin(recording))
    stamps: list[int] = []
    kept: list[Array] = []

    def keep(stamp: int, statistics: Array) -> None:
        stamps.append(stamp)
        kept.append(statistics.copy())

    monitor = observer.watch(limits, keep)
    topics = tuple(topic for topic in observer.topics if topic in recording)
    total = max(sum(len(recording[topic]) for topic in topics), 1)
    beyond: dict[str, float] = {}
    for i, sample in enumerate(recording.samples(topics)):
        observer.add(sample)
        if len(stamps) and limits is not None:
            for name, since in monitor.beyond.items():
                beyond.setdefault(name, (since - recording.start) * 1e-9)
        if i % 500 == 0:
            progress(i / total)
    if not kept:
        raise InputError(
            f"{recording.name or 'recording'}: nowhere {WINDOW:g} s of driving in which the observer had converged"
        )
    t = (np.array(stamps) - recording.start) * 1e-9
    return Watch(recording.name, recording.duration, tuple(monitor.quantities), t, np.array(kept), beyond)


def calibrate(watched: Sequence[Watch], vehicle: Vehicle) -> Calibration:
    """Limits from at least two recordings with nothing hidden.

    They are as far from the middle of what all recordings have as the extremes, times a margin: the least with which
    every recording, left out, stays within the limits of the others. Raises `InputError` for a single recording.
    """
    if len(watched) < 2:
        raise InputError("expected at least two recordings, so that each can be held against the limits of the others")
    false_alarms: dict[float, int] = {}
    for margin in MARGINS:
        alarms = 0
        for i, left_out in enumerate(watched):
            low, high, rms = _limits([one for j, one in enumerate(watched) if j != i], margin)
            mean, square = left_out.statistics[:, 0], left_out.statistics[:, 1]
            alarms += bool(np.any(mean < low) or np.any(mean > high) or np.any(square > rms))
        false_alarms[margin] = alarms
        if not alarms:
            break
    low, high, rms = _limits(watched, margin)
    ranges = {
        quantity.name: Range(unit=quantity.unit, low=low[i], high=high[i], rms=rms[i] if np.isfinite(rms[i]) else None)
        for i, quantity in enumerate(watched[0].quantities)
        if np.isfinite(low[i])
    }
    names, seconds = [one.name for one in watched], sum(one.seconds for one in watched)
    limits = Limits(
        vehicle=vehicle.name, recordings=names, seconds=seconds, margin=margin, window=WINDOW, quantities=ranges
    )
    return Calibration(limits, false_alarms)


def _limits(watched: Sequence[Watch], margin: float) -> tuple[Array, Array, Array]:
    """Least and largest mean, and largest root mean square; infinite where there was nothing in any recording."""
    every = np.concatenate([one.statistics for one in watched])
    seen = np.isfinite(every).any(axis=0)
    low, high = np.nanmin(np.where(seen, every, 0.0), axis=0), np.nanmax(np.where(seen, every, 0.0), axis=0)
    middle, half = (low + high) / 2, (high - low) / 2 * margin
    low, high = np.where(seen, middle - half, -np.inf), np.where(seen, middle + half, np.inf)
    return low[0], high[0], high[1]
