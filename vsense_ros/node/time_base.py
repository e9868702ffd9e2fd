"""Times of arrival in the time of the system or, during a replay, in that of the recording."""

from __future__ import annotations

import threading
import time
from collections import deque

_WINDOW = 64  # clock messages
_RATE_SPAN = 500_000_000  # [ns] of wall time before the rate of the clock is believed
_JUMP = 50_000_000  # [ns]


class TimeBase:
    """Maps wall time to the time of `/clock`, between its ticks too. Thread-safe.

    A tick is only ever seen late, so of the recent ticks the one that makes the time latest is the best. A clock that
    was paused, jumped or runs at another rate starts the mapping anew.
    """

    def __init__(self, simulated: bool) -> None:
        self.simulated = simulated
        self._ticks: deque[tuple[int, int]] = deque(maxlen=_WINDOW)  # wall, simulated [ns]
        self._lock = threading.Lock()

    def tick(self, simulated: int, wall: int | None = None) -> None:
        """A clock message arrived; `simulated` is the time that it tells [ns]."""
        wall = time.time_ns() if wall is None else wall
        with self._lock:
            if self._ticks and abs(self._at(wall) - simulated) > _JUMP * max(1.0, self._rate()):
                self._ticks.clear()
            self._ticks.append((wall, simulated))

    def at(self, wall: int) -> int | None:
        """The time [ns] at the wall time `wall` [ns]; None before the clock's first tick."""
        if not self.simulated:
            return wall
        with self._lock:
            return self._at(wall) if self._ticks else None

    def now(self) -> int | None:
        """The time [ns]; None before the clock's first tick."""
        return self.at(time.time_ns())

    def _rate(self) -> float:
        (first_wall, first), (last_wall, last) = self._ticks[0], self._ticks[-1]
        return (last - first) / (last_wall - first_wall) if last_wall - first_wall >= _RATE_SPAN else 1.0

    def _at(self, wall: int) -> int:
        rate = self._rate()
        return max(simulated + round(rate * (wall - ticked)) for ticked, simulated in self._ticks)
