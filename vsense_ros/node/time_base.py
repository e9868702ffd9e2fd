"""Times of arrival in the time of the system or, during a replay, in that of the recording."""

from __future__ import annotations

import threading
import time
from collections import deque
from itertools import islice

_RATE_TICKS = 512  # clock messages from which the rate of the clock is taken
_OFFSET_TICKS = 64  # newest of them from which the offset is taken
_RATE_SPAN = 80_000_000  # [ns] of wall time before the rate is believed; until then it is 1
_RATE_NOISE = 0.02  # a rate this close to 1 is 1
_JUMP = 50_000_000  # [ns]
_STALL = 1_000_000_000  # [ns] by which a tick is late only where the clock was set back or paused
_PATIENCE = 200_000_000  # [ns] of wall time in which ticks that were held up are made up for


class TimeBase:
    """Maps wall time to the time of `/clock`, between its ticks too. Thread-safe.

    A tick is only ever seen late, so of the recent ticks the one that makes the time latest is the best. A clock that
    was paused, jumped or runs at another rate starts the mapping anew. Ticks that come late by less than a second are
    believed only once none has made up for them: a process that had no processor for a while gets them in one go, and
    what it measures may not be set back in time by that.
    """

    def __init__(self, simulated: bool) -> None:
        self.simulated = simulated
        self._ticks: deque[tuple[int, int]] = deque(maxlen=_RATE_TICKS)  # wall, simulated [ns], newest first
        self._best = (0, 0)
        self._rate = 1.0
        self._late_since: int | None = None  # wall time [ns] from which on all ticks have come late
        self._lock = threading.Lock()

    def tick(self, simulated: int, wall: int | None = None) -> None:
        """A clock message arrived; `simulated` is the time that it tells [ns]."""
        wall = time.time_ns() if wall is None else wall
        with self._lock:
            if self._ticks and abs(late := self._at(wall) - simulated) > _JUMP * max(1.0, self._rate):
                self._late_since = wall if self._late_since is None else self._late_since
                if 0 < late < _STALL * max(1.0, self._rate) and wall - self._late_since < _PATIENCE:
                    return
                self._ticks.clear()
                self._rate = 1.0
            self._late_since = None
            self._ticks.appendleft((wall, simulated))
            first_wall, first = self._ticks[-1]
            if wall - first_wall >= _RATE_SPAN:
                rate = (simulated - first) / (wall - first_wall)
                self._rate = 1.0 if abs(rate - 1.0) < _RATE_NOISE else rate
            self._best = max(
                islice(self._ticks, _OFFSET_TICKS), key=lambda t: t[1] - first - self._rate * (t[0] - first_wall)
            )

    def at(self, wall: int) -> int | None:
        """The time [ns] at the wall time `wall` [ns]; None before the clock's first tick."""
        if not self.simulated:
            return wall
        with self._lock:
            return self._at(wall) if self._ticks else None

    def now(self) -> int | None:
        """The time [ns]; None before the clock's first tick."""
        return self.at(time.time_ns())

    def _at(self, wall: int) -> int:
        ticked, simulated = self._best
        return simulated + round(self._rate * (wall - ticked))
