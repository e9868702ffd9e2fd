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
FACTOR = 64  # samples that one bin of a level holds, and bins that one bin of the next level holds
SHORTEST_LEVEL = 2048  # [samples] below which no coarser level is made
DISTANCE = "distance"  # the signal by which a time becomes a distance


@dataclass(frozen=True)
class View:
    """What a screen shows of a curve: `time` (n,) [s], and the least and the largest value (n,) from each time to the
    next. Where every sample is shown, the two are equal."""

    time: Array
    low: Array
    high: Array


class CurveWriter:
    """Writes a set of curves into a folder; the set is readable once `close` has been called."""

    def __init__(self, folder: Path, **facts: Any) -> None:
        self.folder, self.facts = folder, facts
        self.signals: dict[str, dict[str, Any]] = {}
        self._times = self._arrays = 0
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, time: Array, values: Mapping[str, Array], **description: Any) -> None:
        """Add signals that share one time (n,) [s], in ascending order; `values` maps names to (n,)."""
        name = f"t{self._times}"
        self._times += 1
        np.save(self.folder / f"{name}.npy", np.asarray(time, dtype=np.float64))
        for signal, value in values.items():
            file = f"v{self._arrays}"
            self._arrays += 1
            self._save(file, np.asarray(value, dtype=np.float64))
            self.signals[signal] = {"time": name, "file": file, "count": len(value), **description}

    def _save(self, file: str, value: Array) -> None:
        np.save(self.folder / f"{file}.npy", value)
        low = high = value
        level = 0
        while len(low) >= SHORTEST_LEVEL:
            starts = np.arange(0, len(low), FACTOR)
            low, high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
            level += 1
            np.save(self.folder / f"{file}.{level}.npy", np.stack([low, high]))

    def close(self) -> None:
        """Write the description, which makes the set readable."""
        content = {**self.facts, "signals": self.signals}
        with atomic_write(self.folder / INDEX) as file:
            json.dump(content, file)


class CurveSet:
    """A set of curves that was written by `CurveWriter`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.content: dict[str, Any] = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise InputError(f"{folder.name}: these curves are no longer there; run the step again") from None
        self.signals: dict[str, dict[str, Any]] = self.content["signals"]
        self._arrays: dict[str, Array] = {}

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
        time, value = self.time(name), self.value(name)
        first = max(0, int(np.searchsorted(time, begin)) - 1)
        last = min(len(time), int(np.searchsorted(time, end, side="right")) + 1)
        if last - first <= 2 * bins:
            shown = np.asarray(value[first:last])
            return View(np.asarray(time[first:last]), shown, shown)
        level, step = 0, 1
        while (last - first) // (step * FACTOR) >= 2 * bins and (self.folder / self._level(name, level + 1)).exists():
            level, step = level + 1, step * FACTOR
        if level:
            low, high = self._array(self._level(name, level).removesuffix(".npy"))
        else:
            low = high = value
        begins = np.unique(np.linspace(first // step, (last - 1) // step, bins).astype(np.intp))
        stop = (last - 1) // step + 1
        return View(
            np.asarray(time[np.minimum(begins * step, len(time) - 1)]),
            np.fmin.reduceat(low[:stop], begins),
            np.fmax.reduceat(high[:stop], begins),
        )

    def _level(self, name: str, level: int) -> str:
        return f"{self.signals[name]['file']}.{level}.npy"

    def at(self, name: str, time: float) -> float:
        """Value of a signal at the sample that is nearest to a time [s]; NaN without samples."""
        times = self.time(name)
        if not len(times):
            return float("nan")
        right = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
        nearest = right - 1 if right >= len(times) or time - times[right - 1] < times[right] - time else right
        return float(self.value(name)[nearest])

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
