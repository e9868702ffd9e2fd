"""Which messages reach a filter: no copies, nothing frozen, no clock that went elsewhere on its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum, auto
from math import isfinite
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.health import Health
from vsense_ros.estimation.punctuality import Punctuality
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.estimation.sensor_noise import SensorNoise
from vsense_ros.estimation.source import Source
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Sample

LONGEST_GAP = 5.0  # [s] between stamps of sensors whose clocks agree
BLIND = 3.5  # [s] without any measurement after which a filter starts anew: no model knows where a driver steers
FROZEN = 50  # equal messages in a row: noise makes two unlikely and so many impossible
_ARRIVAL_STEP = 100_000_000  # [ns] by which time goes on at most with messages that do not say when they arrived

Sensor = TypeVar("Sensor", bound=Source)


class Timing(Enum):
    """What the stamp of an event says."""

    USED = auto()  # it belongs to the stretch of time that the filter knows, or goes on from there
    REFUSED = auto()
    RESTART = auto()  # time has gone on, or back, for all sensors


class Intake(Generic[Sensor]):
    """The messages of all sensors, in order of arrival; `health` (one for each) says what became of them.

    `moving()` says whether the car moves, so that an inertial sensor of coarse resolution may not repeat itself.
    Messages of such a sensor that come faster than one in `merge` [s] are averaged, and their mean counts as one.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        on_map: Map,
        reach: float,
        moving: Callable[[], bool],
        merge: float = 0.0,
    ) -> None:
        self.sensors = tuple(sensors.values())
        self.health = [Health() for _ in self.sensors]
        self.on_map = on_map
        self.newest_arrival = 0  # [ns]
        self._readers = [Reader(i, sensor, on_map) for i, sensor in enumerate(self.sensors)]
        self._reach, self._moving, self._merge = int(reach * 1e9), moving, int(merge * 1e9)
        self._stated: dict[int, NDArray[np.float64]] = {}  # variances of the newest measurements
        self._together: dict[int, list[Event]] = {}  # that are to be averaged
        self._held: list[tuple[Event, int]] = []  # readings before the start, with the stamps of their messages
        self._noise = {i: SensorNoise() for i, sensor in enumerate(self.sensors) if sensor.noisy}
        self._punctuality = [Punctuality() for _ in self.sensors]
        self._doubtful: dict[int, list[tuple[int, int, Event]]] = {}  # that may be late, with stamps and arrivals
        self._released: dict[int, list[tuple[int, int, Event]]] = {}  # that turned out to be in time
        self._jumps: dict[int, int] = {}  # where sensors went whose clocks left the others'
        self._arrived = 0  # arrival of the message whose reading is judged [ns]
        self._silence = 0  # before it [ns]
        self._used = 0  # arrival of the newest message whose reading belonged to the stretch of time [ns]

    def read(self, index: int, sample: Sample) -> Event | None:
        """The measurement in a message of a sensor, if it can be true and is new."""
        return self.examine(index, sample.stamp, sample.received, self._readers[index].read(sample))

    def read_channel(self, index: int, channel: Channel) -> Iterator[Event | str]:
        """What is read of each message of a sensor's channel, for `examine`: a measurement, or why there is none."""
        return self._readers[index].read_channel(channel)

    def examine(self, index: int, stamp: int, received: int | None, event: Event | str) -> Event | None:
        """What was read of a message with a stamp and a time of arrival [ns], if it can be true and is new."""
        health, sensor = self.health[index], self.sensors[index]
        health.receive(self._arrival(stamp, received), sensor)
        late = self._punctuality[index].lateness(stamp)
        if not isinstance(event, Event):
            self.refuse(index, event)
        elif stamp <= health.last_stamp and stamp in health.stamps:
            self.refuse(index, "stamp repeated")
        elif sensor.noisy and self._frozen(index, event):
            self.refuse(index, "value frozen")
        elif late:
            self._jumps[index] = event.stamp  # where time is, is known all the same
            self._doubt(index, stamp, event, late)
        else:
            if index in self._doubtful:
                self._release_doubtful(index)
            return self._accepted(index, event)
        return None

    def _release_doubtful(self, index: int) -> None:
        """Readings of a sensor that were held turn out to be in time."""
        for stamp, arrived, held in self._doubtful.pop(index):
            if (kept := self._accepted(index, held)) is not None:
                self._released.setdefault(index, []).append((stamp, arrived, kept))

    def _doubt(self, index: int, stamp: int, event: Event, late: float) -> None:
        """Hold a reading that may be late by a time [s], until the next ones show whether it is."""
        doubtful = self._doubtful.setdefault(index, [])
        doubtful.append((stamp, self._arrived, event))
        if self._punctuality[index].is_burst:
            for _ in doubtful:
                self.refuse(
                    index, f"stamps up to {late:.2g} s late: those of arrival after a hold-up, not of measurement"
                )
            del self._doubtful[index]

    @property
    def has_released(self) -> bool:
        """True if there are any readings for `released`."""
        return bool(self._released)

    def released(self, index: int) -> Iterable[tuple[int, Event]]:
        """Readings of a sensor that were held and turned out to be in time, with the stamps of their messages [ns]."""
        return self._release(index) if index in self._released else ()

    def _release(self, index: int) -> Iterator[tuple[int, Event]]:
        newest = self._arrived, self._silence
        for stamp, arrived, event in self._released.pop(index):
            self._arrived, self._silence = arrived, arrived - self._used
            yield stamp, event
        self._arrived, self._silence = newest

    def _accepted(self, index: int, event: Event) -> Event | None:
        """The measurement that counts for a reading that can be true, if it is not the part of a mean."""
        health = self.health[index]
        if isfinite(event.value.dot(event.value)):
            health.complete_at = event.stamp
        else:
            health.lacks(event.value.tolist(), event.stamp)
        self._stated[index] = event.variance
        if health.noise is None:
            health.noise = self._readers[index].noise(event.variance)
        kept = event if health.period * 1e9 >= self._merge else self._averaged(index, event)
        noise = self._noise.get(index)
        if noise is not None and kept is not None:
            noise.hear(kept)
            health.noisier = noise.noisier
        return kept

    def hold(self, event: Event, stamp: int) -> list[tuple[Event, int]]:
        """Hold a reading of a message with a stamp [ns] until the noise of the sensors is known that have begun to
        send; then what was held, in order of arrival, with the variances that the readings show."""
        self._held.append((event, stamp))
        if any(noise.awaited(event.stamp) for noise in self._noise.values()):
            return []
        held, self._held = self._held, []
        for one, _ in held:
            if one.sensor in self._noise:
                self._noise[one.sensor].raise_variance(one)
        return held

    def take_noise_as_stated(self) -> None:
        """Give readings no more variance than what is stated, whatever they show: for who fits what a file states."""
        self._noise.clear()

    def _averaged(self, index: int, event: Event) -> Event | None:
        """The mean of the messages of a sensor that is too fast, once they are as many as come within `merge`."""
        health = self.health[index]
        if not self.sensors[index].noisy or not health.period:
            return event
        together = self._together.setdefault(index, [])
        if together and not 0 <= event.stamp - together[0].stamp < 2 * self._merge:
            together.clear()
        together.append(event)
        if event.stamp - together[0].stamp < self._merge - 0.5e9 * health.period:
            self.believe(index, event.stamp)
            health.used += 1
            return None
        values, variances = (np.array([getattr(e, name) for e in together]) for name in ("value", "variance"))
        count = np.isfinite(values).sum(axis=0)
        mean = np.nansum(values, axis=0) / np.where(count, count, np.nan)
        stamp = sum(e.stamp - together[0].stamp for e in together) // len(together) + together[0].stamp
        together.clear()
        return Event(index, stamp, mean, variances.max(axis=0))

    def _arrival(self, stamp: int, received: int | None) -> int:
        """When a message arrived; where that is not known, its stamp, as far as that goes on with the others."""
        newest = self.newest_arrival
        if received is None:
            received = min(stamp, newest + _ARRIVAL_STEP) if newest else stamp
        self._arrived, self._silence = received, received - newest
        if received > newest:
            self.newest_arrival = received
        return received

    def believe(self, index: int, stamp: int) -> None:
        """The stamp of a message is that of a measurement."""
        health = self.health[index]
        if stamp > health.last_stamp:
            health.last_stamp = stamp
        health.stamps.append(stamp)

    def _frozen(self, index: int, event: Event) -> bool:
        health, content = self.health[index], event.value.tobytes()
        health.same_in_a_row = health.same_in_a_row + 1 if content == health.last_content else 0
        health.last_content = content
        if health.same_in_a_row < FROZEN:
            return False
        turning = np.nanmax(np.abs(event.value[:3]), initial=0.0) > 1e-3
        return bool(turning or self._moving())

    def refuse(self, index: int, why: str) -> None:
        """A message that cannot be true."""
        health = self.health[index]
        health.invalid += 1
        health.complain(why)

    def timing(self, event: Event, oldest: int, newest: int) -> Timing:
        """Judge whether a stamp belongs to the stretch of time from `oldest` to `newest` [ns], or goes on from there.

        Where a stamp does not, time has gone on if there was as long a silence. Otherwise the other sensors show
        whether this clock is wrong: once all that still send are there too, the filter follows them. A clock that alone
        went elsewhere is never followed.
        """
        index, stamp = event.sensor, event.stamp
        if oldest <= stamp <= newest + self._reach:
            if self._jumps:
                self._jumps.pop(index, None)
            self._used = self._arrived
            return Timing.USED
        silent = abs(stamp - newest - self._silence) < self._reach
        agreed = silent or self._others_are_there(index, stamp)
        distance = (stamp - newest) * 1e-9
        if agreed and abs(distance) > BLIND:
            return Timing.RESTART
        if distance > 0:
            if agreed:
                self._used = self._arrived
                return Timing.USED
            self.refuse(index, f"stamp {distance:.3g} s ahead of all others")
            return Timing.REFUSED
        health = self.health[index]
        health.too_late += 1
        health.complain(f"measurement {-distance:.3g} s old, history is {self._reach * 1e-9:g} s")
        return Timing.REFUSED

    def _others_are_there(self, index: int, stamp: int) -> bool:
        """True if every other sensor that still sends went to the same time, or none has sent lately."""
        self._jumps[index] = stamp
        others = (i for i in range(len(self.sensors)) if i != index and self.sends(i))
        return all(i in self._jumps and abs(self._jumps[i] - stamp) < LONGEST_GAP * 1e9 for i in others)

    def is_in_order(self, index: int) -> bool:
        """True if messages of a sensor have lately come in the order of their stamps."""
        return self._punctuality[index].is_in_order

    def sends(self, index: int) -> bool:
        """True if a sensor was believed, and is not silent."""
        health = self.health[index]
        silence = self.newest_arrival - health.last_received
        return health.last_stamp > 0 and silence < self.sensors[index].timeout * 1e9

    def doubt(self, index: int) -> str:
        """What is doubtful about the noise that the newest messages of a sensor state, in words; empty for nothing."""
        variance = self._stated.get(index)
        return "" if variance is None else self._readers[index].stated(variance).doubt

    def forget_clocks(self) -> None:
        """Wait for clocks to agree anew."""
        self._jumps.clear()

    def restart(self, index: int) -> None:
        """Time is where the newest message of a sensor is: stamps from before mean nothing."""
        self.newest_arrival = self.health[index].last_received
        self._punctuality = [Punctuality() for _ in self.sensors]
        self._doubtful.clear()
        self._released.clear()
        self._used = self._arrived
        for health in self.health:
            health.last_stamp = 0
            health.stamps.clear()

    def count(self, event: Event, nis: float, limit: float, *, measured: bool) -> None:
        """Keep what became of an event, of a measurement its normalized innovation squared."""
        health = self.health[event.sensor]
        if not measured:
            health.used += 1
        elif nis <= limit:
            health.refused_in_a_row = 0
            health.used += 1
            health.innovation_ratio += 0.02 * (nis / len(event.value) - health.innovation_ratio)
        else:
            health.refused += 1
            health.refused_in_a_row += 1
            health.refused_to = event.stamp
            if health.refused_in_a_row == 1:
                health.refused_from = event.stamp
            health.complain(f"innovation {abs(nis) ** 0.5:.1f} standard deviations, limit {limit**0.5:.1f}")

    def out_of_patience(self, index: int, nis: float, limit: float) -> bool:
        """True if measurements were refused for so long that it may be the filter that is wrong."""
        return not nis <= limit and self.health[index].contradicts and isfinite(nis)


def by_topic(sensors: Sequence[Source]) -> dict[str, list[int]]:
    """Places of the sensors that listen to each topic."""
    indices: dict[str, list[int]] = {}
    for i, sensor in enumerate(sensors):
        indices.setdefault(sensor.topic, []).append(i)
    return indices
