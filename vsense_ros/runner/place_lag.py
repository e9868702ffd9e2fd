"""By how much fixes are later than the velocities over ground of the same car.

A place is what velocities add up to, p(t) = c + k t + ∫ v, if c and k are where the car began and the bias of v. One
that is late by τ is behind by τ v, so that τ is the regression of p - ∫ v on -v: in a bend or while the speed changes
that is neither c nor k (Draper & Smith 1998, "Applied regression analysis", chapter 5). Both are of one antenna, whose
lever arm is in neither.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Event

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlaceLagSettings:
    """How the lag of fixes is estimated: decisions of this project."""

    window: float = 40.0  # [s] of the newest readings that are compared
    least: float = 5.0  # [s] in which both are there
    most: int = 4000  # [-] readings of each that are kept: the window at 100 Hz
    longest_gap: float = 1.3  # [s] between two readings; what is before a longer one is left out
    independent: float = 2.0  # [s] from one independent error of a fix to the next
    least_change: float = 1.0  # [m/s] root mean square change of the velocity that shows a lag
    most_apart: float = 3.0  # [m] root mean square of what is left: fixes that jump show none
    error: float = 0.01  # [s] standard deviation of what the equation leaves out


PLACE_LAG = PlaceLagSettings()


class _Heard:
    """The newest readings of one sensor, east and north, in order of arrival."""

    def __init__(self) -> None:
        self._stamps, self._values = array("q"), array("d")  # one after the other

    def add(self, stamp: int, east: float, north: float) -> None:
        """Take in a reading at a time [ns]."""
        self._stamps.append(stamp)
        self._values.append(east)
        self._values.append(north)
        if len(self._stamps) >= 2 * PLACE_LAG.most:
            del self._stamps[: -PLACE_LAG.most], self._values[: -2 * PLACE_LAG.most]

    def clear(self) -> None:
        """Forget all."""
        del self._stamps[:], self._values[:]

    def newest(self) -> tuple[NDArray[np.int64], Array]:
        """Stamps (n,) [ns] and values (n, 2)."""
        stamps, values = self._stamps[-PLACE_LAG.most :], self._values[-2 * PLACE_LAG.most :]
        return np.array(stamps, dtype=np.int64), np.array(values, dtype=float).reshape(-1, 2)


class PlaceLag:
    """The newest fixes and velocities of one car, east and north, in the order of arrival."""

    def __init__(self) -> None:
        self._heard = _Heard(), _Heard()  # fixes and velocities

    def hear(self, event: Event, *, is_place: bool) -> None:
        """Take in a reading with the stamp that its message says."""
        east, north = event.value.tolist()[:2]
        if east == east and north == north:
            self._heard[not is_place].add(event.stamp, east, north)

    def forget(self) -> None:
        """Times count anew."""
        for heard in self._heard:
            heard.clear()

    def lag(self) -> tuple[float, float] | None:
        """By how much fixes are later than velocities, with the standard deviation of that [s]; None where the newest
        readings do not show it."""
        s = PLACE_LAG
        fixes, velocities = (heard.newest() for heard in self._heard)
        if len(fixes[0]) < 3 or len(velocities[0]) < 3:
            return None
        begun = velocities[0].item(0)
        (at, place), (times, velocity) = (_without_gap(*heard, begun) for heard in (fixes, velocities))
        both = (at >= times[0]) & (at <= times[-1])
        at, place = at[both], place[both]
        if len(at) < 3 or at[-1] - at[0] < s.least:
            return None
        steps = np.diff(times)[:, None]
        way = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * steps * (velocity[1:] + velocity[:-1]), axis=0)])
        apart = place - _between(at, times, way)
        drive = np.column_stack([np.ones(len(at)), at - at.mean()])
        apart, speed = (
            x - drive @ np.linalg.lstsq(drive, x, rcond=None)[0] for x in (apart, _between(at, times, velocity))
        )
        changes = float(np.sum(speed**2))
        if changes < len(at) * s.least_change**2:
            return None
        seconds = -float(np.sum(apart * speed)) / changes
        left = float(np.mean(np.sum((apart + seconds * speed) ** 2, axis=1))) / 2
        if left > s.most_apart**2:
            return None
        each = max(s.independent * (len(at) - 1) / float(at[-1] - at[0]), 1.0)  # fixes that have one error
        return seconds, hypot(sqrt(left * each / changes), s.error)


def _without_gap(stamps: NDArray[np.int64], values: Array, begun: int) -> tuple[Array, Array]:
    """Times [s] after one [ns] and values (n, 2) of the newest readings without a gap, of those in order of arrival."""
    order = np.argsort(stamps, kind="stable")
    times = (stamps[order] - begun).astype(np.float64) * 1e-9
    values = values[order]
    there = np.diff(times, prepend=-np.inf) > 0
    there &= times > times[-1] - PLACE_LAG.window
    times, values = times[there], values[there]
    gaps = np.flatnonzero(np.diff(times) > PLACE_LAG.longest_gap)
    first = int(gaps[-1]) + 1 if len(gaps) else 0
    return times[first:], values[first:]


def _between(at: Array, times: Array, values: Array) -> Array:
    """Values (m, 2) at times (m,) between those (n,) at which they are known (n, 2)."""
    return np.column_stack([np.interp(at, times, axis) for axis in values.T])
