"""The clock of a sensor or an adapter, tied to the times at which its messages arrive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class SensorClockSettings:
    """When a clock is believed to have been set: decisions of this project."""

    drift: float = 1e-4  # [-] allowed difference in speed of the sensor's clock and ours
    restart: int = 10_000_000_000  # [ns] of difference between the clocks, from which on one of them was set
    # [ns] when all messages are this late …
    late: int = 200_000_000
    late_for: int = 1_000_000_000  # [ns] … for this long, our clock was set


SETTINGS = SensorClockSettings()


class SensorClock:
    """Ties a counter of `tick` [ns] that wraps after `wrap` ticks to the times of arrival.

    Transmission only ever delays, so the smallest difference between arrival and counter is the best; it may grow
    slowly, so that the sensor's clock can be the slower one. Where every message comes late for a while, it is the
    clock of the arrivals that was set forward; one that was set back shows at once. `note(sentence, received)` is
    called when the counter is tied anew.
    """

    def __init__(
        self,
        tick: int,
        wrap: int,
        note: Callable[[str, int], object],
        settings: SensorClockSettings = SETTINGS,
    ) -> None:
        self._settings = settings
        self._tick, self._wrap, self._note = tick, wrap, note
        self._late_since: int | None = None  # arrival of the first of the messages that all came late [ns]
        self._last: int | None = None
        self._elapsed = 0  # [ns] on the sensor's clock
        self._offset = 0.0

    def stamp(self, ticks: int, received: int) -> int:
        """Time of measurement [ns] of a message with a counter that has arrived at a time [ns]."""
        settings = self._settings
        step = 0 if self._last is None else (ticks - self._last) % self._wrap * self._tick
        offset = received - (self._elapsed + step)
        if self._last is None or offset - self._offset <= settings.late:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = received
        was_set = self._late_since is not None and received - self._late_since >= settings.late_for
        if self._last is None or was_set or abs(offset - self._offset) > settings.restart:
            if self._last is not None:
                self._note("clock was set to another time", received)
            self._late_since = None
            self._elapsed, self._offset = 0, float(received)
        else:
            self._elapsed += step
            self._offset = min(float(offset), self._offset + settings.drift * step)
        self._last = ticks
        return self._elapsed + round(self._offset)
