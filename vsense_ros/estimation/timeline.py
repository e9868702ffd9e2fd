"""Late measurements at their time: a filter's recent past, gone back to and driven forward again.

It knows nothing of what the filter estimates: `memory` is all it keeps.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

from vsense_ros.estimation.filter import Array, Filter, Given, Innovation, Kept, Measured, Step

_stamp_of = attrgetter("stamp")


@dataclass(slots=True)
class Event:
    """A measurement, or values of inputs, that belongs to a time."""

    sensor: int  # place of its channel
    stamp: int  # of the measurement, latency taken off [ns]
    value: Array  # (m,), NaN where absent
    variance: Array  # (m,)
    counted: bool = False  # it has been told of


class Channel(NamedTuple):
    """What the events of one sensor are to the filter: measurements that it knows by a name, of which normalized
    innovations squared up to `limit` are believed, or values of its inputs from `first_input` on."""

    name: str
    limit: float
    first_input: int | None = None


@dataclass(slots=True)
class Instant:
    """The filter after all that happened at one time. The newest is the filter itself, which is `kept` when it moves
    on."""

    stamp: int
    latest: int  # stamp of its events, of which inputs may be newer than the instant
    kept: Kept
    events: list[Event] = field(default_factory=list)


class Timeline:
    """The past `reach` [s] of a filter, in steps no longer than `longest_step` [s].

    Measurements at most `merge` [s] after an instant belong to it. `act(event)` lets an event act on the filter at its
    present time and tells of it; by default the filter corrects, or takes inputs, and `found(event, nis, innovation)`
    is called once for each event, with the innovation if the filter has not gone on since. `in_one_go()` says whether
    events that are repeated may act all at once, without `act`. `afterwards()` is called when something has happened,
    `fault()` when the filter is not valid or cannot be moved; by default it goes back to the newest instant that is
    valid.
    """

    def __init__(
        self,
        filter: Filter,
        channels: Sequence[Channel],
        *,
        reach: float,
        longest_step: float,
        merge: float = 0.0,
        found: Callable[[Event, float, Innovation | None], None] = lambda event, nis, innovation: None,
        act: Callable[[Event], None] | None = None,
        in_one_go: Callable[[], bool] = lambda: True,
        afterwards: Callable[[], None] = lambda: None,
        fault: Callable[[], None] | None = None,
    ) -> None:
        self.filter, self.channels = filter, tuple(channels)
        self.reach, self._step, self._merge = (int(time * 1e9) for time in (reach, longest_step, merge))
        self._found, self._act, self._in_one_go = found, act or self._happen, in_one_go
        self._afterwards, self._fault = afterwards, fault or self.recover
        self._history: list[Instant] = []
        self._spare: list[Instant] = []
        self._ahead: list[Event] = []  # what is to be done again after a late measurement
        self.stamp = 0  # time of the state when all that is ahead has been done again [ns]

    def begin(self, stamp: int) -> None:
        """The filter is at this time [ns], and nothing is known from before it."""
        self.clear()
        self.stamp = stamp
        self._new_instant(stamp)

    def clear(self) -> None:
        """Forget everything."""
        self._spare += self._history
        self._history.clear()
        self._ahead.clear()

    @property
    def begun(self) -> bool:
        """Whether there is anything to go on from."""
        return bool(self._history)

    def forget_past(self) -> None:
        """From before the present instant nobody can come here again."""
        del self._history[:-1]

    @property
    def oldest(self) -> int:
        """Stamp before which nothing is kept [ns]."""
        return max(self.stamp - self.reach, self._history[0].stamp)

    def add(self, event: Event) -> bool:
        """Use an event that is not older than `oldest`; True if it came late. What follows a late one is done again
        when the newest state is next needed: `catch_up`."""
        latest = self._ahead[-1].stamp if self._ahead else self._history[-1].latest
        if event.stamp < latest - self._merge:
            self._insert(event)
            return True
        self.catch_up()
        self._occur(event)
        return False

    def catch_up(self) -> None:
        """Do again what came after a late measurement."""
        while self._ahead:
            del self._ahead[: self._repeat(self._ahead)]
            if self._ahead:
                self._occur(self._ahead.pop(0))

    def recover(self) -> bool:
        """Go on from the newest valid state before this instant, with less trust in it; False if there is none."""
        for instant in reversed(self._history[:-1]):
            self.filter.memory[:] = instant.kept.memory
            if self.filter.is_valid():
                self.filter.inflate()
                return True
        return False

    def _happen(self, event: Event) -> None:
        channel, innovation = self.channels[event.sensor], None
        if channel.first_input is not None:
            self.filter.give(Given(channel.first_input, event.value))
        else:
            innovation = self.filter.correct(channel.name, event.value, event.variance, channel.limit)
        if not event.counted:
            event.counted = True
            self._found(event, 0.0 if innovation is None else innovation.nis, innovation)

    def _occur(self, event: Event) -> None:
        """Let an event happen, not before those of the newest instant."""
        instant, stamp = self._history[-1], event.stamp
        if self._is_later(event, instant):
            if not self.filter.advance(self._way(instant, stamp)):
                self._fault()
                instant.kept.memory[:] = self.filter.memory
            instant = self._new_instant(stamp)
        self._act(event)
        instant.events.append(event)
        if stamp > instant.latest:
            instant.latest = stamp
        self._afterwards()

    def _is_later(self, event: Event, instant: Instant) -> bool:
        """Whether an event has an instant of its own. An input holds from where it comes on: the filter need not be
        brought to the very time it was read."""
        return event.stamp > instant.stamp + self._merge and self.channels[event.sensor].first_input is None

    def _way(self, instant: Instant, stamp: int) -> Step:
        """From an instant to a time [ns]."""
        time = stamp - instant.stamp
        count = max(1, -(-time // self._step))
        return Step(instant.kept, count, time * 1e-9 / count)

    def _insert(self, event: Event) -> None:
        """Put a late event in its place, and the filter before it."""
        kept = len(self._history)
        while kept > 1 and self._history[kept - 1].latest > event.stamp:
            kept -= 1
        if kept < len(self._history):
            undone = self._history[kept:]
            del self._history[kept:]
            self._spare += undone
            self._ahead[:0] = sorted((e for instant in undone for e in instant.events), key=_stamp_of)
            self.filter.memory[:] = self._history[-1].kept.memory
            self._afterwards()
        insort(self._ahead, event, key=_stamp_of)

    def _repeat(self, events: list[Event]) -> int:
        """Let events happen in one go, up to one that needs a closer look; returns how many did."""
        if not self._in_one_go():
            return 0
        history, instants = self._history, [self._history[-1]]
        plan: list[tuple[Step | None, Measured | Given]] = []
        for event in events:
            channel, instant, way = self.channels[event.sensor], instants[-1], None
            if self._is_later(event, instant):
                way = self._way(instant, event.stamp)
                instant = self._new_instant(event.stamp)
            if channel.first_input is None:
                plan.append((way, Measured(channel.name, event.value, event.variance, channel.limit)))
            else:
                plan.append((way, Given(channel.first_input, event.value)))
            instants.append(instant)
        done, moved, nis = self.filter.repeat(plan)
        newest = instants[done + moved]
        while history[-1] is not newest:
            self._spare.append(history.pop())
        for event, instant, squared in zip(events[:done], instants[1:], nis, strict=False):
            instant.events.append(event)
            if event.stamp > instant.latest:
                instant.latest = event.stamp
            if not event.counted:
                event.counted = True
                self._found(event, squared, None)
        return done

    def _new_instant(self, stamp: int) -> Instant:
        """Begin an instant with the filter's present state, in the memory of one that is not needed any more."""
        history = self._history
        if len(history) > 2 and history[0].stamp < stamp - self.reach:
            self._spare.append(history.pop(0))
        instant = self._spare.pop() if self._spare else Instant(0, 0, self.filter.backup())
        instant.stamp = instant.latest = stamp
        instant.events = []
        if stamp > self.stamp:
            self.stamp = stamp
        history.append(instant)
        return instant
