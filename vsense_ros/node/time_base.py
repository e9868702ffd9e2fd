"""Times of arrival in the time of the system or, during a replay, in that of the recording."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np


@dataclass(frozen=True)
class TimeBaseSettings:
    """How the time of a replay is reckoned from its clock messages: decisions of this project."""

    rate_ticks: int = 512  # clock messages from which the rate of the clock is taken
    offset_ticks: int = 64  # newest of them from which the offset is taken
    rate_every: int = 16  # ticks between two looks at the rate …
    # [ns] … beyond this wall time from the first: until then each tick counts, however many wait
    rate_often: int = 640_000_000
    rate_span: int = 80_000_000  # [ns] of wall time before the rate is believed; until then it is 1
    rate_noise: float = 0.02  # a rate this close to 1 is 1
    jump: int = 50_000_000  # [ns] by which the clock is off from where on it is taken to have jumped
    stall: int = 10_000_000_000  # [ns] by which a tick is late only where the clock was set back or paused
    patience: int = 900_000_000  # [ns] of wall time in which ticks that were held up are made up for
    quiet: int = 200_000_000  # [ns] of wall time without a tick, after which some may be waiting for this process
    settling: int = 50_000_000  # [ns] of wall time after the first tick, or one that stood still or went back
    held: int = 1_000_000_000  # [ns] of wall time for which arrivals are kept until the time is known


SETTINGS = TimeBaseSettings()


Item = TypeVar("Item")


class TimeBase:
    """Maps wall time to the time of `/clock`, between its ticks too. Thread-safe.

    A tick is only ever seen late, so of the recent ticks the one that makes the time latest is the best. A clock that
    was paused, jumped or runs at another rate starts the mapping anew. Ticks that come late by less than ten seconds
    are believed only once none has made up for them for nearly a second: a process that had no processor for a while
    gets them in one go, and what it measures may not be set back in time by that.
    """

    def __init__(self, simulated: bool) -> None:
        self.simulated = simulated
        # Wall and simulated time [ns] of each tick, oldest first. Only the columns from `_first` to `_end` are ticks:
        # the newest are moved to the front when the end of the array is reached, so that they always lie together.
        self._ticks = np.zeros((2, 4 * SETTINGS.rate_ticks), np.int64)
        self._first = self._end = 0
        self._newest = 0  # simulated time of the newest [ns]
        self._count = 0
        self._heard = 0  # wall time [ns] of the newest tick
        self._set_back = 0  # wall time [ns] of the newest tick that was the first, stood still or went back
        self._best = (0, 0)
        self._rate = 1.0
        self._late_since: int | None = None  # wall time [ns] from which on all ticks have come late
        self._lock = threading.Lock()

    def tick(self, simulated: int, wall: int | None = None) -> None:
        """A clock message arrived; `simulated` is the time in it [ns]."""
        wall = time.time_ns() if wall is None else wall
        with self._lock:
            self._heard = wall
            known = self._end > self._first
            late = self._at(wall) - simulated if known else 0
            if not known or simulated <= self._newest:
                self._begin_anew(wall)
            elif abs(late) > SETTINGS.jump * max(1.0, self._rate):
                self._late_since = wall if self._late_since is None else self._late_since
                if 0 < late < SETTINGS.stall * max(1.0, self._rate) and wall - self._late_since < SETTINGS.patience:
                    return
                self._begin_anew(wall if late > 0 else self._set_back)
            self._late_since = None
            self._append(wall, simulated)
            self._count += 1
            if wall - self._ticks[0, self._first] < SETTINGS.rate_often or self._count % SETTINGS.rate_every == 0:
                self._find_rate()
            self._best = self._promptest(max(self._first, self._end - SETTINGS.offset_ticks), self._end)

    def _append(self, wall: int, simulated: int) -> None:
        if self._end == self._ticks.shape[1]:
            self._ticks[:, : SETTINGS.rate_ticks - 1] = self._ticks[:, 1 - SETTINGS.rate_ticks :]
            self._first, self._end = 0, SETTINGS.rate_ticks - 1
        self._ticks[:, self._end] = wall, simulated
        self._newest = simulated
        self._end += 1
        self._first = max(self._first, self._end - SETTINGS.rate_ticks)

    def _begin_anew(self, set_back: int) -> None:
        self._first = self._end = 0
        self._rate = 1.0
        self._set_back = set_back

    def _promptest(self, first: int, end: int) -> tuple[int, int]:
        """The one of the ticks in these columns that makes the time latest, of equal ones the newest."""
        wall, simulated = self._ticks[:, first:end][:, ::-1] - self._ticks[:, self._first, None]
        place = end - 1 - int((simulated - self._rate * wall).argmax())
        return int(self._ticks[0, place]), int(self._ticks[1, place])

    def _find_rate(self) -> None:
        """From the promptest tick of the earlier half to that of the later: of ticks in one go only the last counts."""
        walls = self._ticks[0, self._first : self._end]
        first, last = int(walls[0]), int(walls[-1])
        if last - first < SETTINGS.rate_span:
            return
        split = self._first + int(walls.searchsorted((first + last) // 2, side="right"))
        if not self._first < split < self._end:  # the system's clock was set meanwhile
            return
        earlier_wall, earlier = self._promptest(self._first, split)
        later_wall, later = self._promptest(split, self._end)
        if later_wall <= earlier_wall:
            return
        rate = (later - earlier) / (later_wall - earlier_wall)
        self._rate = 1.0 if abs(rate - 1.0) < SETTINGS.rate_noise else rate

    def at(self, wall: int) -> int | None:
        """The time [ns] at the wall time `wall` [ns]; None before the clock's first tick."""
        if not self.simulated:
            return wall
        with self._lock:
            return self._at(wall) if self._end > self._first else None

    def settled(self, wall: int) -> bool:
        """True if the clock runs, and no ticks can be waiting for this process that would change its time."""
        return not self.simulated or (
            wall - self._set_back >= SETTINGS.settling and wall - self._heard <= SETTINGS.quiet
        )

    def now(self) -> int | None:
        """The time [ns]; None before the clock's first tick."""
        return self.at(time.time_ns())

    def _at(self, wall: int) -> int:
        ticked, simulated = self._best
        return simulated + round(self._rate * (wall - ticked))


class Arrivals(Generic[Item]):
    """Dates what arrives, also what a process that was held up reads before the clock's ticks have reached it.

    That is kept until the time has settled, for a second of wall time at most: then it is dated as well as can be, or
    dropped where there is no clock at all. Not thread-safe: it belongs to the thread that reads.
    """

    def __init__(self, size: Callable[[Item], int] = lambda _: 1) -> None:
        self.dropped = 0  # in units of `size`
        self._size = size
        self._held: deque[tuple[Item, int]] = deque()

    def add(self, item: Item, wall: int) -> None:
        """`item` arrived at the wall time `wall` [ns]."""
        self._held.append((item, wall))

    def dated(self, wall: int, time_base: TimeBase, *, at_the_end: bool = False) -> Iterator[tuple[Item, int]]:
        """What can be dated at the wall time `wall` [ns], oldest first, with times of arrival [ns]; at the end of the
        reading all of it."""
        while self._held and (at_the_end or time_base.settled(wall) or wall - self._held[0][1] > SETTINGS.held):
            item, arrived = self._held.popleft()
            at = time_base.at(arrived)
            if at is None:
                self.dropped += self._size(item)
            else:
                yield item, at
