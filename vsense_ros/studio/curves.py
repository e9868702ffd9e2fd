"""Curves on disk, read by levels of detail: an hour at 100 Hz is drawn as fast as a second.

A set of curves is a folder: `curves.json` describes it, and each array is a .npy file that is mapped into memory, so
that only what a screen shows is read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write

Array = NDArray[np.floating[Any]]

INDEX = "curves.json"
CURVES, GLANCE = "curves", "glance"  # sets of curves of a recording: all of it, and a first look at a large one


@dataclass(frozen=True)
class CurveSettings:
    """How many samples of a curve are kept and sent: decisions of this project."""

    factor: int = 16  # samples that one bin of a level holds, and bins that one bin of the next level holds
    shortest_level: int = 2048  # [samples] below which no coarser level is made
    gap: float = 5.0  # usual steps of a signal without a sample, from which on its line is broken
    most_gaps: int = 1000  # of one signal, the longest ones, at which its line is broken
    most_cuts: int = 64  # windows whose samples a set of curves remembers


SETTINGS = CurveSettings()

DISTANCE = "distance"  # the signal by which a time becomes a distance


@dataclass(frozen=True)
class View:
    """What a screen shows of a curve: `time` (n,) [s], and the least and the largest value (n,) from each time to the
    next. Where every sample is shown, the two are equal; NaN breaks the line."""

    time: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class _Cut:
    """The samples of a window: from `first` to before `stop` in level `level`, gathered from each of `begins` on, at
    `time`. Each gap begins after the stretch with an index in `breaks`."""

    level: int
    first: int
    stop: int
    begins: NDArray[np.intp] | None
    time: Array
    breaks: NDArray[np.intp]


class CurveWriter:
    """Writes a set of curves into a folder; the set is readable once `close` has been called."""

    def __init__(self, folder: Path, **facts: Any) -> None:
        self.folder, self.facts = folder, facts
        self.signals: dict[str, dict[str, Any]] = {}
        self._gaps: dict[str, list[list[float]]] = {}
        self._arrays = 0
        folder.mkdir(parents=True, exist_ok=True)

    def add_time(self, time: Array, *, broken: bool = True) -> str:
        """Write a time (n,) [s], in ascending order, that several signals share; returns its name for `add`. Lines are
        drawn across gaps if they are not `broken`."""
        name = f"t{len(self._gaps)}"
        time = np.asarray(time, dtype=np.float64)
        np.save(self.folder / f"{name}.npy", time)
        self._gaps[name] = _gaps(time) if broken else []
        return name

    def add(self, time: Array | str, values: Mapping[str, Array], **description: Any) -> None:
        """Add signals that share one time: an array (n,) [s], or the name that `add_time` gave; `values` maps names to
        (n,)."""
        name = time if isinstance(time, str) else self.add_time(time)
        for signal, value in values.items():
            file = f"v{self._arrays}"
            self._arrays += 1
            levels = self._save(file, np.asarray(value, dtype=np.float64))
            about = {"time": name, "file": file, "count": len(value), "levels": levels}
            self.signals[signal] = {**about, **description}

    def _save(self, file: str, value: Array) -> int:
        """Write an array and its levels; returns how many levels there are."""
        np.save(self.folder / f"{file}.npy", value)
        low = high = value
        level = 0
        while len(low) >= SETTINGS.shortest_level:
            starts = np.arange(0, len(low), SETTINGS.factor)
            low, high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
            level += 1
            np.save(self.folder / f"{file}.{level}.npy", np.stack([low, high]))
        return level

    def close(self) -> None:
        """Write the description, which makes the set readable."""
        content = {**self.facts, "signals": self.signals, "gaps": self._gaps}
        with atomic_write(self.folder / INDEX) as file:
            json.dump(content, file)


def _gaps(time: Array) -> list[list[float]]:
    """Begin and end [s] of the longest stretches without a sample."""
    steps = np.diff(time)
    if not len(steps):
        return []
    rows = np.flatnonzero(steps > SETTINGS.gap * np.median(steps))
    rows = np.sort(rows[np.argsort(-steps[rows], kind="stable")[: SETTINGS.most_gaps]])
    return [[float(time[i]), float(time[i + 1])] for i in rows]


class CurveSet:
    """A set of curves that was written by `CurveWriter`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.content: dict[str, Any] = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise InputError(f"{folder.name}: these curves are no longer there; run the step again") from None
        self.signals: dict[str, dict[str, Any]] = self.content["signals"]
        self._gaps = {name: np.reshape(gaps, (-1, 2)) for name, gaps in self.content.get("gaps", {}).items()}
        self._arrays: dict[str, Array] = {}
        self._cuts: dict[tuple[str, int, float, float, int], _Cut] = {}

    def _array(self, name: str) -> Array:
        if name not in self._arrays:
            self._arrays[name] = np.load(self.folder / f"{name}.npy", mmap_mode="r")
        return self._arrays[name]

    def time(self, name: str) -> Array:
        """Times (n,) [s] of a signal."""
        return self._array(self._described(name)["time"])

    def value(self, name: str) -> Array:
        """Values (n,) of a signal."""
        return self._array(self._described(name)["file"])

    def _described(self, name: str) -> dict[str, Any]:
        if name not in self.signals:
            raise InputError(f"there is no signal {name!r} in these curves")
        return self.signals[name]

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return max((float(self.time(name)[-1]) for name in self.signals if len(self.time(name))), default=0.0)

    def view(self, name: str, begin: float, end: float, bins: int) -> View:
        """The curve from `begin` to `end` [s] in at most about `bins` stretches, whose extremes are kept; one sample
        more on each side lets the line leave the screen."""
        about = self._described(name)
        key = (about["time"], about["levels"], begin, end, bins)
        if key not in self._cuts:
            if len(self._cuts) >= SETTINGS.most_cuts:
                self._cuts.clear()
            self._cuts[key] = self._cut(*key)
        cut = self._cuts[key]
        if cut.begins is None:
            low = high = _with_breaks(np.asarray(self.value(name)[cut.first : cut.stop]), cut.breaks)
        else:
            levels = self._array(f"{about['file']}.{cut.level}") if cut.level else [self.value(name)] * 2
            low = _with_breaks(np.fmin.reduceat(levels[0][: cut.stop], cut.begins), cut.breaks)
            high = _with_breaks(np.fmax.reduceat(levels[1][: cut.stop], cut.begins), cut.breaks)
        return View(cut.time, low, high)

    def _cut(self, time_name: str, levels: int, begin: float, end: float, bins: int) -> _Cut:
        """The samples of a window, which all signals with one time share."""
        time = self._array(time_name)
        first = max(0, int(np.searchsorted(time, begin)) - 1)
        last = min(len(time), int(np.searchsorted(time, end, side="right")) + 1)
        level, step, begins = 0, 1, None
        if last - first <= 2 * bins:
            stop, shown = last, np.asarray(time[first:last])
        else:
            while level < levels and (last - first) // (step * SETTINGS.factor) >= 2 * bins:
                level, step = level + 1, step * SETTINGS.factor
            begins = np.unique(np.linspace(first // step, (last - 1) // step, bins).astype(np.intp))
            stop, shown = (last - 1) // step + 1, np.asarray(time[np.minimum(begins * step, len(time) - 1)])
        gaps = self._gaps.get(time_name, np.zeros((0, 2)))
        gaps = gaps[(gaps[:, 1] > begin) & (gaps[:, 0] < end)]
        before = np.searchsorted(shown, gaps[:, 0], side="right") - 1
        rows = np.flatnonzero((before >= 0) & (before + 1 < len(shown)))
        rows = rows[(np.ptp(gaps[rows], axis=1) > 0.5 * (shown[before[rows] + 1] - shown[before[rows]]))]
        breaks = before[rows] + 1
        return _Cut(level, first, stop, begins, np.insert(shown, breaks, gaps[rows, 0]), breaks)

    def at(self, name: str, time: float) -> float:
        """Value of a signal at the sample that is nearest to a time [s]; NaN without samples."""
        times = self.time(name)
        if not len(times):
            return float("nan")
        right = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
        nearest = right - 1 if right >= len(times) or time - times[right - 1] < times[right] - time else right
        return float(self.value(name)[nearest])

    def sampled(self, name: str, time: Array) -> Array:
        """Values (n,) of a signal at times (n,) [s], interpolated; NaN outside of its samples and in its gaps."""
        value = np.interp(time, self.time(name), self.value(name), left=np.nan, right=np.nan)
        for begin, end in self._gaps.get(self._described(name)["time"], ()):
            value[(time > begin) & (time < end)] = np.nan
        return np.asarray(value)

    def pairs(self, x: str, y: str, most: int) -> tuple[Array, Array, Array]:
        """Times [s] and values of two signals at the times of the first, at most `most` of each."""
        time = self.time(x)
        rows = np.unique(np.linspace(0, len(time) - 1, min(most, len(time))).astype(np.intp))
        shown = np.asarray(time[rows])
        other = np.interp(shown, self.time(y), self.value(y))
        return shown, np.asarray(self.value(x)[rows]), np.asarray(other)

    def to_distance(self, time: Array) -> Array:
        """Distance driven (n,) [m] at times (n,) [s]; raises `InputError` where no speed was recorded."""
        self._described(DISTANCE)
        return np.asarray(np.interp(time, self.time(DISTANCE), self.value(DISTANCE)))

    def to_time(self, distance: Array) -> Array:
        """Times (n,) [s] at which the car had driven a distance (n,) [m], the first ones where it stood."""
        driven, first = np.unique(self.value(DISTANCE), return_index=True)
        return np.asarray(np.interp(distance, driven, np.asarray(self.time(DISTANCE))[first]))


def _with_breaks(value: Array, breaks: NDArray[np.intp]) -> Array:
    return np.insert(value, breaks, np.nan) if len(breaks) else value


@lru_cache(maxsize=64)
def _opened(folder: Path, changed: int) -> CurveSet:
    return CurveSet(folder)


def open_curves(folder: Path) -> CurveSet:
    """The set of curves in a folder, read anew when it has changed."""
    index = folder / INDEX
    return _opened(folder, index.stat().st_mtime_ns if index.exists() else 0)


def driven(time: Array, speed: Array) -> Array:
    """Distance driven (n,) [m], by the trapezoidal rule, of a speed (n,) [m/s]; a speed that is absent counts as 0."""
    known = np.nan_to_num(np.abs(speed))
    steps = 0.5 * (known[1:] + known[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])
