"""Late measurements at their time: a filter's recent past, gone back to and driven forward again.

It knows nothing of what the filter estimates: `memory` is all it keeps.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from vsense_ros.estimation.filter import Array, Filter, Given, Innovation, Kept, Measured, Step

_stamp_of = attrgetter("stamp")
_AT_ONCE = 64  # events that are repeated in one call at most
_BETWEEN = 100_000_000  # [ns] from one place that can be gone back to, to the next, beyond the reach of late messages


@dataclass(slots=True)
class Event:
    """A measurement, or values of inputs, that belongs to a time."""

    sensor: int  # place of its channel
    stamp: int  # of the measurement, latency taken off [ns]
    value: Array  # (m,), NaN where absent
    variance: Array  # (m,)
    counted: bool = False  # it has been reported
    whole: Array | None = None  # (m,) the measurement before what is not believed of it was made absent

    def without(self, components: list[int]) -> None:
        """Make some components absent; `whole` keeps them."""
        if self.whole is None:
            self.whole = self.value
        self.value = self.value.copy()
        self.value[components] = np.nan


class Channel(NamedTuple):
    """What the events of one sensor are to the filter: measurements that it knows by a name, of which normalized
    innovations squared up to `limit` are believed, or values of its inputs from `first_input` on. Events `by_hand` are
    neither: `act` alone knows what they do."""

    name: str
    limit: float
    first_input: int | None = None
    by_hand: bool = False


@dataclass(slots=True)
class Instant:
    """The filter after all that happened at one time. The newest is the filter itself, which is `kept` when it moves
    on."""

    stamp: int
    latest: int  # stamp of its events, of which inputs may be newer than the instant
    kept: Kept
    events: list[Event] = field(default_factory=list)


class Checkpoint(NamedTuple):
    """A place in the past before the reach of late messages, and how many events there were up to it."""

    instant: Instant
    events: int


class Checkpoints:
    """The past beyond the reach of late messages: what happened in as much as `remembered` [ns], and filters that can
    be gone back to, tenths of a second apart. Instants that are not needed any more are appended to `spare`."""

    def __init__(self, remembered: int, spare: list[Instant]) -> None:
        self._remembered, self._spare = remembered, spare
        self._kept: deque[Checkpoint] = deque()
        self._events: deque[Event] = deque()  # that followed the first checkpoint
        self._counted = 0  # all events that have been retired

    def __bool__(self) -> bool:
        return bool(self._kept)

    def __getitem__(self, place: int) -> Instant:
        """The instant at a place; -1 is the newest."""
        return self._kept[place].instant

    def clear(self) -> None:
        """Forget everything."""
        self._spare += [checkpoint.instant for checkpoint in self._kept]
        self._kept.clear()
        self._events.clear()
        self._counted = 0

    def retire(self, instant: Instant, newest: int) -> None:
        """Take over an instant that late messages do not reach; the newest one is at the time `newest` [ns]."""
        kept, events = self._kept, self._events
        if not self._remembered:
            self._spare.append(instant)
            return
        events.extend(instant.events)
        self._counted += len(instant.events)
        if kept and instant.stamp < kept[-1].instant.stamp + _BETWEEN:
            self._spare.append(instant)
            return
        kept.append(Checkpoint(instant, self._counted))
        while len(kept) > 1 and kept[1].instant.stamp < newest - self._remembered:
            self._spare.append(kept.popleft().instant)
        while len(events) > self._counted - kept[0].events:
            events.popleft()

    def before(self, since: int) -> int:
        """The place of the newest checkpoint not after a time [ns], or of the oldest; negative."""
        place = -1
        while -place < len(self._kept) and self._kept[place].instant.stamp > since:
            place -= 1
        return place

    def events_after(self, place: int) -> Iterable[Event]:
        """All that was retired after a checkpoint."""
        lost = self._counted - self._kept[place].events
        return islice(self._events, len(self._events) - lost, None)

    def go_back(self, place: int) -> Instant:
        """Forget what was retired after a checkpoint, and return its instant without events."""
        checkpoint = self._kept[place]
        for _ in range(self._counted - checkpoint.events):
            self._events.pop()
        self._counted = checkpoint.events
        checkpoint.instant.events = []  # which have been counted
        self._spare += [later.instant for later in islice(self._kept, len(self._kept) + place + 1, None)]
        for _ in range(-place):
            self._kept.pop()
        return checkpoint.instant


class Timeline:
    """The past `reach` [s] of a filter, in steps no longer than `longest_step` [s]; as far as `remembered` [s] it can
    be gone back to by `rewind`, tenths of a second apart.

    Measurements at most `merge` [s] after an instant belong to it. `act(event)` lets an event act on the filter at its
    present time and reports it; by default the filter corrects, or takes inputs, and `corrected(event, nis,
    innovation)` is called once for each event, with the innovation if the filter has not gone on since. `in_one_go()`
    says whether events that are repeated may act all at once, without `act`. `afterwards()` is called when something
    has happened, `fault()` when the filter is not valid or cannot be moved; by default it goes back to the newest
    instant that is valid.
    """

    def __init__(
        self,
        filter: Filter,
        channels: Sequence[Channel],
        *,
        reach: float,
        longest_step: float,
        merge: float = 0.0,
        remembered: float = 0.0,
        corrected: Callable[[Event, float, Innovation | None], None] = lambda event, nis, innovation: None,
        act: Callable[[Event], None] | None = None,
        in_one_go: Callable[[], bool] = lambda: True,
        afterwards: Callable[[], None] = lambda: None,
        fault: Callable[[], None] | None = None,
    ) -> None:
        self.filter, self.channels = filter, tuple(channels)
        self.reach, self._step, self._merge = (int(time * 1e9) for time in (reach, longest_step, merge))
        self._corrected, self._act, self._in_one_go = corrected, act or self._happen, in_one_go
        self._afterwards, self._fault = afterwards, fault or self.recover
        self._history: list[Instant] = []
        self._spare: list[Instant] = []
        self._checkpoints = Checkpoints(int(remembered * 1e9), self._spare)
        self._ahead: list[Event] = []  # what is to be done again after a late measurement
        self.stamp = 0  # time of the state when all that is ahead has been done again [ns]

    def begin(self, stamp: int) -> None:
        """The filter is at this time [ns], and nothing is known from before it."""
        self.clear()
        self.stamp = stamp
        self._take_instant(stamp)

    def clear(self) -> None:
        """Forget everything."""
        self._spare += self._history
        self._history.clear()
        self._ahead.clear()
        self._checkpoints.clear()

    @property
    def begun(self) -> bool:
        """True if there is a state to go on from."""
        return bool(self._history)

    def forget_past(self) -> None:
        """From before the present instant nobody can come here again."""
        del self._history[:-1]
        self._checkpoints.clear()

    @property
    def oldest(self) -> int:
        """Stamp before which nothing is kept [ns]."""
        reached, first = self.stamp - self.reach, self._history[0].stamp
        return reached if reached > first else first

    @property
    def present(self) -> int:
        """Stamp of the state of the filter [ns], from which what is ahead goes on."""
        return self._history[-1].stamp

    def add(self, event: Event) -> bool:
        """Use an event that is not older than `oldest`; True if it came late. What follows a late one is done again
        when the newest state is next needed: `catch_up`."""
        ahead = self._ahead
        latest = ahead[-1].stamp if ahead else self._history[-1].latest
        if event.stamp < latest - self._merge:
            self._insert(event)
            return True
        if ahead:
            self.catch_up()
        self._occur(event)
        return False

    def catch_up(self) -> None:
        """Do again what came after a late measurement."""
        while self._ahead:
            del self._ahead[: self._repeat(self._ahead)]
            if self._ahead:
                self._occur(self._ahead.pop(0))

    def go_on(self, stamp: int) -> None:
        """Predict to a time [ns] at which nothing was measured. The filter stays where it is if that is not later."""
        self.catch_up()
        if stamp > self._history[-1].latest:
            self._move(stamp)
            self._afterwards()

    def recover(self) -> bool:
        """Go on from the newest valid state before this instant, with less trust in it; False if there is none."""
        for instant in reversed(self._history[:-1]):
            self.filter.memory[:] = instant.kept.memory
            if self.filter.is_valid():
                self.filter.inflate()
                return True
        return False

    def rewind(self, since: int) -> list[Event]:
        """Go back to a time [ns], or as far as is remembered, and return what is ahead, in the order in which it will
        be done again when the newest state is next needed."""
        self.catch_up()
        place, events = self._before(since)
        if place < 0:
            self._spare += self._history
            self._history[:] = [self._checkpoints.go_back(place)]
        else:
            self._spare += self._history[place + 1 :]
            del self._history[place + 1 :]
        if events:
            self.filter.memory[:] = self._history[-1].kept.memory
            self._afterwards()
        self._ahead[:0] = events
        return self._ahead

    def again(self, since: int, act: Callable[[Event], None]) -> bool:
        """Let everything since a time [ns], or as far as is remembered, happen once more by `act`, in which a filter
        may have changed since; then be as before. False if the filter could not go all the way."""
        self.catch_up()
        place, events = self._before(since)
        instant = self._checkpoints[place] if place < 0 else self._history[place]
        filter, went = self.filter, True
        before, scratch, now = filter.memory.copy(), filter.backup(), instant.stamp
        if events:
            filter.memory[:] = instant.kept.memory
        for event in events:
            if event.stamp > now + self._merge and self.channels[event.sensor].first_input is None:
                count = max(1, -(-(event.stamp - now) // self._step))
                if not filter.advance(Step(scratch, count, (event.stamp - now) * 1e-9 / count)):
                    went = False
                    break
                now = event.stamp
            act(event)
        filter.memory[:] = before
        return went

    def _before(self, since: int) -> tuple[int, list[Event]]:
        """The newest place not after a time: in the history, or with a negative index in the checkpoints; and all that
        happened after it."""
        history = self._history
        place = len(history) - 1
        while place > 0 and history[place].stamp > since:
            place -= 1
        later: Iterable[Event] = chain.from_iterable(instant.events for instant in history[place + 1 :])
        if history[place].stamp <= since or not self._checkpoints:
            return place, sorted(later, key=_stamp_of)
        place = self._checkpoints.before(since)
        return place, sorted(chain(self._checkpoints.events_after(place), history[0].events, later), key=_stamp_of)

    def _retire_old(self, newest: int) -> None:
        """Take what is beyond the reach of late messages out of the history."""
        history, reached = self._history, newest - self.reach
        while len(history) > 2 and history[0].stamp < reached:
            self._checkpoints.retire(history.pop(0), newest)

    def _happen(self, event: Event) -> None:
        channel, innovation = self.channels[event.sensor], None
        if channel.first_input is not None:
            self.filter.give(Given(channel.first_input, event.value))
        else:
            innovation = self.filter.correct(channel.name, event.value, event.variance, channel.limit)
        if not event.counted:
            event.counted = True
            self._corrected(event, 0.0 if innovation is None else innovation.nis, innovation)

    def _occur(self, event: Event) -> None:
        """Let an event happen, not before those of the newest instant. An input holds from where it comes on: the
        filter need not be brought to the very time it was read."""
        instant, stamp = self._history[-1], event.stamp
        if stamp > instant.stamp + self._merge and self.channels[event.sensor].first_input is None:
            instant = self._move(stamp)
        self._act(event)
        instant.events.append(event)
        if stamp > instant.latest:
            instant.latest = stamp
        self._afterwards()

    def _move(self, stamp: int) -> Instant:
        """Predict from the newest instant to a new one at a later time [ns]."""
        instant = self._history[-1]
        if not self.filter.advance(self._way(instant, stamp)):
            self._fault()
            instant.kept.memory[:] = self.filter.memory
        self._retire_old(stamp)
        return self._take_instant(stamp)

    def _way(self, instant: Instant, stamp: int) -> Step:
        """From an instant to a time [ns]."""
        time = stamp - instant.stamp
        count = -(-time // self._step) if time > self._step else 1
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
        history, channels, merge = self._history, self.channels, self._merge
        instant = history[-1]
        instants = [instant]
        plan: list[tuple[Step | None, Measured | Given]] = []
        for event in islice(events, _AT_ONCE):
            name, limit, first_input, by_hand = channels[event.sensor]
            if by_hand:
                break
            way, stamp = None, event.stamp
            if first_input is not None:
                plan.append((way, Given(first_input, event.value)))
            else:
                if stamp > instant.stamp + merge:
                    way = self._way(instant, stamp)
                    instant = self._take_instant(stamp)
                plan.append((way, Measured(name, event.value, event.variance, limit)))
            instants.append(instant)
        if not plan:
            return 0
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
                self._corrected(event, squared, None)
        self._retire_old(newest.stamp)
        return done

    def _take_instant(self, stamp: int) -> Instant:
        """Begin an instant with the filter's present state, in the memory of one that is not needed any more."""
        history = self._history
        instant = self._spare.pop() if self._spare else Instant(0, 0, self.filter.backup())
        instant.stamp = instant.latest = stamp
        instant.events = []
        if stamp > self.stamp:
            self.stamp = stamp
        history.append(instant)
        return instant
