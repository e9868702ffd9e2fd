"""How the place on the map is known: measured by a sensor, dead-reckoned, or lost."""

from __future__ import annotations

from enum import Enum

_RECKONING = 1.0  # [s] without a position that is believed, or ten of its periods, from which on the place is reckoned
_LOST = 5.0  # [s] after which it is not to be used
_STEADY = 5.0  # [s] that positions must keep coming before it counts as known again


class Place(Enum):
    """How the place on the map is known."""

    KNOWN = "position known"
    RECKONED = "dead reckoning"
    LOST = "position not valid"
    NEVER = "no position yet"


class Placement:
    """How well the place of a car with a position sensor is known; times are stamps [ns]."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The filter begins anew."""
        self._first = self._last = 0  # of an unbroken row of positions
        self._period = 0.0  # [s]
        self._broken = False  # there was a row before

    def believed(self, stamp: int) -> None:
        """A position has been believed."""
        gap = (stamp - self._last) * 1e-9
        if not self._last or gap > self._longest:
            self._broken = self._last > 0
            self._first = stamp
        else:
            self._period = gap if not self._period else self._period + 0.05 * (gap - self._period)
        self._last = max(stamp, self._last)

    @property
    def _longest(self) -> float:
        return max(_RECKONING, min(10 * self._period, _LOST))

    def age(self, now: int) -> float:
        """Time since a position was believed [s]."""
        return (now - self._last) * 1e-9

    def at(self, now: int) -> Place:
        """How the place is known now; a sensor that comes and goes does not count as back at once."""
        if not self._last:
            return Place.NEVER
        age = self.age(now)
        if age > _LOST:
            return Place.LOST
        if age > self._longest or (self._broken and self._last - self._first < _STEADY * 1e9):
            return Place.RECKONED
        return Place.KNOWN
