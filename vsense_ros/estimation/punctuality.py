"""Stamps of arrival after a hold-up: readings whose time of measurement nobody knows.

A driver that stamps what it receives, and gets no processor for a second, stamps a second of readings at one time.
Their values are right and their times are not. A sensor that sends at a steady rate shows it: nothing for a while, then
readings much closer together than its period.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PunctualitySettings:
    """What a hold-up looks like in the stamps of a sensor: decisions of this project."""

    first: int = 32  # [-] intervals from which the period is known well enough
    slowest: float = 0.5  # [s] period of a sensor that is judged; of a slower one a few readings are too much to lose
    share: float = 0.03  # [-] of the newest interval in the period and its irregularity
    irregular: float = 0.5  # [-] mean deviation of the intervals, in periods, of a sensor that sends when it likes
    close: float = 0.25  # [-] periods, below which an interval is no period
    far: float = 4.0  # [-] periods, above which an interval is a gap
    regular: tuple[float, float] = (0.5, 1.5)  # [-] periods of an interval in which the driver waited for the reading
    lateness: float = 0.05  # [s] by which a stamp may be late, and
    periods: float = 1.5  # [-] periods by which it may be
    forgiven: float = 0.05  # [-] share of the time by which lateness is forgotten, as readings get lost, too
    fewest: int = 1  # [-] regular intervals in a row after which stamps are believed again, and
    enough: float = 0.05  # [s] of them, but …
    after_burst: float = 0.3  # [s] … of them where readings have come in a burst within …
    remembered: float = 10.0  # [s] … this time
    longest: float = 0.5  # [s] of doubt about a sensor whose readings do not come in a burst, and
    longest_burst: float = 5.0  # [s] about one whose readings do: it sends at another rate from now on


SETTINGS = PunctualitySettings()


class Punctuality:
    """Judges the stamps of one sensor, each by those before it.

    A reading after a gap may be late, or the first after a silence: the next ones show which, by coming in a burst or
    by the clock. Stamps in another order than that of arrival are none of arrival.
    """

    def __init__(self) -> None:
        self.period = 0.0  # [s]; 0 while it is not known
        self._irregularity = 0.0  # mean deviation of an interval from the period [periods]
        self._count = 0
        self._last = 0  # newest stamp [ns]
        self._earliest = 0.0  # time at which the newest reading may have been made at the earliest [ns]
        self._in_a_row: int | None = None  # regular intervals since a stamp was too late; None if none was
        self._since = 0  # stamp with which doubt began [ns]
        self._burst = 0  # stamp of the newest reading that followed another too closely, while in doubt [ns]
        self._out_of_order = 0  # stamp of the newest reading that came after a later one [ns]
        self.is_burst = False  # True: readings have followed each other too closely since one was too late

    def lateness(self, stamp: int) -> float:
        """By how much a new stamp [ns] may be later than the measurement [s], where that is too much; else 0."""
        interval = (stamp - self._last) * 1e-9
        if not self._last:
            self._last = stamp
            self._believe(stamp)
            return 0.0
        if interval < 0:
            self._out_of_order = self._last
            self._believe(self._last)
        if interval <= 0:
            return 0.0
        period, self._last = self.period, stamp
        if self._out_of_order and not self.is_in_order:
            self._believe(stamp)
            return 0.0
        if self._count < SETTINGS.first or period > SETTINGS.slowest or self._irregularity > SETTINGS.irregular:
            self._learn(interval)
            self._believe(stamp)
            return 0.0
        ratio = interval / period
        late = self._late(stamp, interval)
        if SETTINGS.close < ratio < SETTINGS.far:
            self._learn(interval)
        if not (late > SETTINGS.lateness and late > SETTINGS.periods * period):
            self._in_a_row, self.is_burst = None, False
            return 0.0
        regular = self._doubt(stamp, ratio)
        doubted = (stamp - self._since) * 1e-9
        if doubted > (SETTINGS.longest_burst if self.is_burst else SETTINGS.longest):
            self._count = 0
            self._believe(stamp)
            return 0.0
        if regular >= self._needed(stamp):
            self._believe(stamp)
            return 0.0
        return late

    @property
    def is_in_order(self) -> bool:
        """True if the newest stamps have come in the order of time."""
        return not self._out_of_order or not self._is_recent(self._out_of_order, self._last)

    def _believe(self, stamp: int) -> None:
        """Take a stamp [ns] for the time of its measurement."""
        self._earliest, self._in_a_row, self.is_burst = float(stamp), None, False

    def _late(self, stamp: int, interval: float) -> float:
        """By how much a stamp [ns] is later than one period after the earliest time of the reading before [s]."""
        longest, now = SETTINGS.far * self.period, float(stamp)
        forgiven = SETTINGS.forgiven * (interval if interval < longest else longest)
        earliest = self._earliest + (self.period + forgiven) * 1e9
        self._earliest = earliest if earliest < now else now
        return (stamp - self._earliest) * 1e-9

    def _doubt(self, stamp: int, ratio: float) -> int:
        """The number of regular intervals in a row, given the newest one in periods."""
        lowest, highest = SETTINGS.regular
        if self._in_a_row is None:
            self._in_a_row, self._since = 0, stamp
        elif lowest <= ratio <= highest:
            self._in_a_row += 1
        else:
            self._in_a_row = 0
            if ratio < lowest:
                self._burst, self.is_burst = stamp, True
        return self._in_a_row

    def _needed(self, stamp: int) -> float:
        """Regular intervals in a row after which stamps are believed again."""
        needed = SETTINGS.after_burst if self._is_recent(self._burst, stamp) else SETTINGS.enough
        return max(SETTINGS.fewest, needed / self.period)

    @staticmethod
    def _is_recent(seen: int, stamp: int) -> bool:
        """True if something was seen at a stamp [ns] that is still remembered at another."""
        return seen > 0 and (stamp - seen) * 1e-9 < SETTINGS.remembered

    def _learn(self, interval: float) -> None:
        """Let an interval [s] count in the period and in its irregularity."""
        self._count += 1
        far, period = SETTINGS.far, self.period
        share = max(SETTINGS.share, 1.0 / self._count)
        if period:
            deviation = abs(interval / period - 1.0)
            self._irregularity += share * ((deviation if deviation < far else far) - self._irregularity)
            interval = interval if interval < far * period else far * period
        self.period += share * (interval - period)
