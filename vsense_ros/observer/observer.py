"""The observer: messages in, estimates out, whatever the order and the state of the messages.

It keeps a short history of the filter, so that a measurement that arrives late is used at the time it was made: the
filter goes back there and works its way forward again. It refuses what cannot be true, says so, and carries on.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.model.coordinates import YAW, X, Y
from vsense_ros.model.effects.base import ON_MAP
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.steering import INPUT as STEERING_INPUT
from vsense_ros.model.sensors.wheel_torques import INPUT as TORQUE_INPUT
from vsense_ros.model.vehicle import Vehicle, left_out_of_observer
from vsense_ros.observer.compiled_step import Backup, Replayed
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.estimate import Estimate, estimate_samples
from vsense_ros.observer.health import PATIENCE, Health
from vsense_ros.observer.monitor import Limits, Monitor
from vsense_ros.observer.reading import Event, Map, Reader
from vsense_ros.observer.road_map import Survey
from vsense_ros.observer.spi import Spi
from vsense_ros.observer.standstill import Standstill

Array = NDArray[np.float64]

_INPUTS = {"steering": STEERING_INPUT, "wheel_torques": TORQUE_INPUT}
_TELL_SPEED = {"wheel_speeds", "gnss_velocity"}
_ALIGNMENT_SPEED = 2.0  # [m/s] above it the course tells the heading
_DISAGREEMENT = 5.0  # [m/s] between first speeds, beyond which one of them is wrong
_SAME_SPEED = 0.2  # of a speed by which another may differ from it
_STANDING = 0.2  # [m/s] below it the car does
_ANYWHERE = 100.0  # [m] standard deviation of a position of which nothing is known
_LONGEST_GAP = 5.0  # [s] without any measurement after which the filter starts anew
_FROZEN = 50  # equal messages in a row: noise makes two unlikely and so many impossible
_MOVING = 1.0  # [m/s] below it an inertial sensor of coarse resolution may well repeat itself
_ARRIVAL_STEP = 100_000_000  # [ns] by which time goes on at most with messages that do not tell when they arrived


_stamp_of = attrgetter("stamp")


@dataclass(slots=True)
class _Instant:
    """The filter after all that happened at one time.

    The newest instant is the filter itself, which is `kept` when it moves on.
    """

    stamp: int
    latest: int  # stamp of its events, of which inputs may be newer than the instant
    kept: Backup
    events: list[Event] = field(default_factory=list)


class Observer:
    """The filter of one vehicle on a stream of messages.

    `vehicle` names the sensors; those whose messages do not come simply do not contribute. `map_origin` (latitude,
    longitude [deg], height [m]) fixes the map frame; by default it is where the first GNSS fix was made.

    Raises `InputError` if nothing in the sensor set could tell the car's speed, or its steering angle.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        map_origin: tuple[float, float, float] | None = None,
        kind: type[ErrorEkf] | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.sensors = sensors_of(vehicle)
        if kind is None:
            kind = Spi if vehicle.observer.parameters else ErrorEkf
        self.filter = kind(vehicle, self.sensors)
        self.left_out = left_out_of_observer(vehicle)
        self.names = tuple(self.sensors)
        self._list = tuple(self.sensors.values())
        self._by_topic: dict[str, list[int]] = {}
        for i, sensor in enumerate(self._list):
            self._by_topic.setdefault(sensor.topic, []).append(i)
        self.health = [Health() for _ in self._list]
        on_map = Map(map_origin)
        self._survey = Survey.of(vehicle, on_map)
        self._readers = [Reader(i, sensor, on_map) for i, sensor in enumerate(self._list)]
        # Of each sensor the inputs that it sets (None if it measures), and the largest innovation that is believed,
        # squared and normalized.
        self._sets = [_INPUTS.get(sensor.kind) for sensor in self._list]
        self._limits = [sensor.gate**2 * len(sensor.deviations()) ** 0.5 for sensor in self._list]
        self.started = self.heading_known = False
        self._standstill = Standstill()
        self._history: list[_Instant] = []
        self._spare: list[_Instant] = []
        self._ahead: list[Event] = []  # what is to be done again after a late measurement
        self._first: dict[int, Event] = {}  # newest measurement of each sensor before the start
        self._gathered: dict[int, int] = {}  # when these arrived [ns]
        self._jumps: dict[int, int] = {}  # where sensors went whose clocks left the others'
        self._first_stamp = 0
        self._newest = 0  # time of the state when all that is ahead has been done again [ns]
        self._newest_arrival = 0
        self._silence = 0  # before the newest message [ns]
        self._faults = 0
        self._restarts = 0
        self._started_at = 0
        self.monitor: Monitor | None = None
        settings = vehicle.observer
        self._merge = int(settings.merge_window * 1e9)
        self._reach = int(settings.history * 1e9)
        self._step = int(settings.longest_step * 1e9)

    @property
    def topics(self) -> dict[str, str]:
        """Topics to subscribe to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self._list}

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]; 0 before the start."""
        return self._newest

    @property
    def converged(self) -> bool:
        """Whether velocity, yaw rate and side slip are known well enough to be used."""
        if not self.started or not self.heading_known:
            return False
        deviation = np.sqrt(self.filter.estimated()[1].diagonal()[[14, 15, 19]])
        return bool(self.stamp - self._started_at > 1e9 and np.all(deviation < (0.5, 0.5, 0.02)))

    def watch(self, limits: Limits | None = None, on_statistics: Callable[[int, Array], None] | None = None) -> Monitor:
        """Watch from now on whether the model fits; arguments as of `Monitor`. Raises `InputError` for limits that are
        not of this vehicle and its sensors."""
        if limits is not None and limits.vehicle != self.vehicle.name:
            raise InputError(
                f"the limits of the monitor are those of the vehicle {limits.vehicle!r}, this is {self.vehicle.name!r}"
            )
        self.monitor = Monitor(self.filter, self.sensors, self._limits, lambda: self.converged, limits, on_statistics)
        return self.monitor

    def add(self, sample: Sample) -> None:
        """Use a message of any topic; messages of unknown topics are ignored. Never raises for bad content."""
        for index in self._by_topic.get(sample.topic, ()):
            health = self.health[index]
            health.last_received = self._arrival(sample)
            event = self._readers[index].read(sample)
            if not isinstance(event, Event):
                self._refuse(index, event)
            elif sample.stamp <= health.last_stamp and sample.stamp in health.stamps:
                self._refuse(index, "stamp repeated")
            elif self._frozen(index, event):
                self._refuse(index, "value frozen")
            else:
                if not self.started:
                    self._believe(index, sample.stamp)
                    self._gather(event)
                elif self._timely(event):
                    self._believe(index, sample.stamp)
                    self._use(event)

    # Messages

    def _arrival(self, sample: Sample) -> int:
        """When a message arrived; where it does not tell, its stamp, as far as that goes on with the others."""
        received, newest = sample.received, self._newest_arrival
        if received is None:
            received = min(sample.stamp, newest + _ARRIVAL_STEP) if newest else sample.stamp
        self._silence = received - newest
        self._newest_arrival = max(newest, received)
        return received

    def _believe(self, index: int, stamp: int) -> None:
        health = self.health[index]
        health.last_stamp = max(health.last_stamp, stamp)
        health.stamps.append(stamp)

    def _frozen(self, index: int, event: Event) -> bool:
        if self._list[index].kind != "imu":
            return False
        health, content = self.health[index], event.value.tobytes()
        health.same_in_a_row = health.same_in_a_row + 1 if content == health.last_content else 0
        health.last_content = content
        if health.same_in_a_row < _FROZEN:
            return False
        turning = np.nanmax(np.abs(event.value[:3]), initial=0.0) > 1e-3
        return bool(turning or abs(self.filter.state[14]) > _MOVING)

    def _refuse(self, index: int, why: str) -> None:
        health = self.health[index]
        health.invalid += 1
        health.complain(why)

    def _timely(self, event: Event) -> bool:
        """Whether a stamp belongs to the stretch of time that the filter knows, or goes on from there.

        Where a stamp does not, time has gone on if there was as long a silence. Otherwise the other sensors tell
        whether this clock is wrong: once all that still send are there too, the filter follows them. A clock that alone
        went elsewhere is never followed.
        """
        index, stamp, newest = event.sensor, event.stamp, self.stamp
        oldest = max(newest - self._reach, self._history[0].stamp)
        if oldest <= stamp <= newest + self._reach:
            if self._jumps:
                self._jumps.pop(index, None)
            return True
        silent = abs(stamp - newest - self._silence) < self._reach
        agreed = silent or self._others_are_there(index, stamp)
        distance = (stamp - newest) * 1e-9
        if agreed and abs(distance) > _LONGEST_GAP:
            self._restart(event)
            return False
        if distance > 0:
            if agreed:
                return True
            self._refuse(index, f"stamp {distance:.3g} s ahead of all others")
            return False
        health = self.health[index]
        health.too_late += 1
        health.complain(f"measurement {-distance:.3g} s old, history is {self._reach * 1e-9:g} s")
        return False

    def _others_are_there(self, index: int, stamp: int) -> bool:
        """Whether every other sensor that still sends went to the same time, or none has sent lately."""
        self._jumps[index] = stamp
        others = (i for i in range(len(self._list)) if i != index and self._sends(i))
        return all(i in self._jumps and abs(self._jumps[i] - stamp) < _LONGEST_GAP * 1e9 for i in others)

    def _sends(self, index: int) -> bool:
        """Whether a sensor was believed, and is not silent."""
        health = self.health[index]
        silence = self._newest_arrival - health.last_received
        return health.last_stamp > 0 and silence < self._list[index].timeout * 1e9

    # Start

    def _gather(self, event: Event) -> None:
        """Collect what came until it tells how the car moves, then start; never without a speed, since a start at a
        wrong one is worse than none."""
        stamp, fastest = event.stamp, self.filter.largest[14]
        for speed in _first_speeds({self._list[event.sensor].kind: event}, self.vehicle):
            if not abs(speed) < fastest:
                self._refuse(event.sensor, f"speed {speed:.3g} m/s before the start, limit {fastest:g}")
                return
        # What is far apart in time, one of them by a wrong clock, does not describe the same start. A clock that
        # differs from several others, of which there was news lately, is wrong; else the newest message counts.
        gap, now = _LONGEST_GAP * 1e9, self._newest_arrival
        near = {i for i, e in self._first.items() if abs(e.stamp - stamp) < gap}
        others = [i for i in self._first if i != event.sensor and now - self._gathered[i] < gap]
        if len(others) > 1 and not near.intersection(others):
            return
        self._first = {i: e for i, e in self._first.items() if i in near}
        if not self._first:
            self._first_stamp = stamp
        self._first[event.sensor] = event
        self._gathered[event.sensor] = now
        kinds = {self._list[i].kind: e for i, e in self._first.items()}
        speeds = _first_speeds(kinds, self.vehicle)
        waited = (stamp - self._first_stamp) * 1e-9
        if "steering" in {s.kind for s in self._list} and "steering" not in kinds and waited < _LONGEST_GAP:
            return
        if not speeds:
            return
        if "gnss_velocity" in {s.kind for s in self._list} and "gnss_velocity" not in kinds and waited < 1.0:
            return
        if np.ptp(np.abs(speeds)) > _DISAGREEMENT and waited < _LONGEST_GAP:
            return
        self._start(stamp, speeds[0], kinds)

    def _start(self, stamp: int, speed: float, kinds: dict[str, Event]) -> None:
        f = self.filter
        f.start(speed)
        if (wheels := kinds.get("wheel_speeds")) is not None and speed > _MOVING:  # at rest, their noise would be slip
            f.state[24:28] = np.where(np.isfinite(wheels.value), wheels.value, f.state[24:28])
        if (imu := kinds.get("imu")) is not None and abs(imu.value[2]) < f.largest[19]:
            f.state[19] = imu.value[2]
        for kind, part in _INPUTS.items():
            if kind in kinds:
                f.inputs[part] = np.nan_to_num(kinds[kind].value)
        self.heading_known = bool(f.prior.deviation[YAW] < 1.0)  # where the map is laid by the start
        self.started, self._started_at, self._newest = True, stamp, stamp
        if self.monitor is not None:
            self.monitor.forget()
        self._history.clear()
        self._ahead.clear()
        self._standstill = Standstill()
        f.linearize()
        if (fix := kinds.get("gnss_position")) is not None:
            self._stand(fix)
        for kind in ("gnss_attitude", "gnss_velocity"):
            if kind in kinds and not self.heading_known:
                self._align(kinds[kind])
        self._remember(stamp)

    def _align(self, event: Event) -> bool:
        """Take the heading from a measurement, if it tells one; True if that has just been done."""
        told = self._heading(event)
        if told is None:
            return False
        f, (yaw, deviation) = self.filter, told
        was, position, spread = f.state[YAW], f.state[[X, Y]], _ANYWHERE
        if self._standstill.known:
            position, spread = self._standstill.place(position, was, yaw)
        f.place(YAW, yaw, deviation)
        for i, value in zip((X, Y), position, strict=True):
            f.place(i, value, spread)
        self.heading_known, self._standstill = True, Standstill()
        del self._history[:-1]  # from before it nobody can come here again
        return True

    def _heading(self, event: Event) -> tuple[float, float] | None:
        """Yaw that a measurement tells [rad] and its standard deviation: two antennas; the course once it means
        something; without velocities the way between positions."""
        f, sensor = self.filter, self._list[event.sensor]
        if sensor.kind == "gnss_attitude":
            cosine, sine = event.value
            return float(np.arctan2(sine, cosine) - sensor.mounting()[0]), float(np.sqrt(event.variance.max()))
        if sensor.kind == "gnss_position":
            return self._standstill.heading(f.state[[X, Y]], f.state[YAW], event.value, event.variance)
        east, north = event.value
        speed = float(np.hypot(east, north))
        if not _ALIGNMENT_SPEED < speed < f.largest[14]:
            return None
        forward = f.state[14] if abs(f.state[14]) > 0.1 else 0.1
        yaw = np.arctan2(north, east) - np.arctan2(f.state[15], forward)
        return float(yaw), float(np.hypot(0.05, np.sqrt(event.variance.max()) / speed))

    def _stand(self, event: Event) -> None:
        """Take a position for where the car is, as long as its heading is not known: all while it stands."""
        f = self.filter
        seen = event.value, event.variance, self._list[event.sensor].mounting(), f.state[YAW]
        if abs(f.state[14]) < _STANDING:
            if not event.counted:
                self._standstill.add(*seen)
            f.state[[X, Y]] = self._standstill.antenna
        elif self._standstill.known:
            self._standstill.leave()
        else:
            np.copyto(f.state[0:2], event.value, where=np.isfinite(event.value))
            if self._history and not self._velocity_comes():
                self._standstill.add(*seen)  # the way from here will tell the heading
                self._standstill.leave()
                del self._history[:-1]

    def _velocity_comes(self) -> bool:
        return any(sensor.kind == "gnss_velocity" and self._sends(i) for i, sensor in enumerate(self._list))

    # Filtering

    def _use(self, event: Event) -> None:
        """Put an event in its place and bring the filter up to the newest time again."""
        latest = self._ahead[-1].stamp if self._ahead else self._history[-1].latest
        if event.stamp < latest - self._merge:
            self.health[event.sensor].late += 1
            self._insert(event)
        else:
            self._catch_up()
            self._occur(event)

    def _occur(self, event: Event) -> None:
        """Let an event happen, not before those of the newest instant of the history."""
        instant = self._history[-1]
        stamp = event.stamp
        if self._is_later(event, instant):
            if not self.filter.move(instant.kept, *self._steps(stamp - instant.stamp)):
                self._recover()
                instant.kept.memory[:] = self.filter.memory
            instant = self._remember(stamp)
        self._happen(event)
        instant.events.append(event)
        if stamp > instant.latest:
            instant.latest = stamp
        self._look_up_road()

    def _look_up_road(self) -> None:
        """Where the vehicle file knows the road from place to place, take it as it is where the car is."""
        if self._survey is not None and self.heading_known:
            self._survey.follow(self.filter)

    def _is_later(self, event: Event, instant: _Instant) -> bool:
        """Whether an event has an instant of its own. An input holds from where it comes on: the model need not be
        brought to the very time it was read."""
        return event.stamp > instant.stamp + self._merge and self._sets[event.sensor] is None

    def _steps(self, time: int) -> tuple[int, float]:
        """Number and length [s] of the steps for some time [ns]."""
        count = max(1, -(-time // self._step))
        return count, time * 1e-9 / count

    def _insert(self, event: Event) -> None:
        """Put a late event in its place; what follows it is done again when the newest state is next needed."""
        kept = len(self._history)
        while kept > 1 and self._history[kept - 1].latest > event.stamp:
            kept -= 1
        if kept < len(self._history):
            undone = self._history[kept:]
            del self._history[kept:]
            self._spare += undone
            self._ahead[:0] = sorted((e for instant in undone for e in instant.events), key=_stamp_of)
            self.filter.memory[:] = self._history[-1].kept.memory
            self._look_up_road()  # what came after this may be done again without coming back to Python
        insort(self._ahead, event, key=_stamp_of)

    def _catch_up(self) -> None:
        """Do again what came after a late measurement."""
        while self._ahead:
            del self._ahead[: self._replay(self._ahead)]
            if self._ahead:
                self._occur(self._ahead.pop(0))

    def _replay(self, events: list[Event]) -> int:
        """Let events happen in one go, up to one that needs a closer look; returns how many did."""
        if not self.heading_known or not self.filter.at_once:
            return 0
        history, instants, plan = self._history, [self._history[-1]], []
        for event in events:
            index, instant = event.sensor, instants[-1]
            inputs, way = self._sets[index], (0, 0, 0.0)
            if self._is_later(event, instant):
                way = instant.kept.address, *self._steps(event.stamp - instant.stamp)
                instant = self._remember(event.stamp)
            plan.append(Replayed(index, inputs, event.value, event.variance, self._limits[index], *way))
            instants.append(instant)
        done, moved, nis = self.filter.replay(plan)
        newest = instants[done + moved]
        while history[-1] is not newest:
            self._spare.append(history.pop())
        for event, instant, found in zip(events[:done], instants[1:], nis.tolist(), strict=False):
            instant.events.append(event)
            if event.stamp > instant.latest:
                instant.latest = event.stamp
            if not event.counted:
                self._count(event, found, alone=False)
        return done

    def _stop(self) -> None:
        """Wait for what it takes to start anew."""
        self._restarts += 1
        self.started = False
        for known in (self._history, self._ahead, self._first, self._jumps):
            known.clear()

    def _restart(self, event: Event) -> None:
        self._stop()
        self._newest_arrival = self.health[event.sensor].last_received
        for health in self.health:
            health.last_stamp = 0
            health.stamps.clear()
        self._gather(event)

    def _happen(self, event: Event) -> None:
        """Let an event act on the filter at its present time; what happens again is not counted again."""
        f, index, value = self.filter, event.sensor, event.value
        inputs, limit, nis = self._sets[index], self._limits[index], 0.0
        if inputs is not None:
            for i, number in enumerate(value.tolist(), inputs.start):
                if isfinite(number):
                    f.inputs[i] = number
        elif self.heading_known or self._helps(event):
            nis = f.correct(index, value, event.variance, limit)
        else:
            event.counted = True
            return
        if not event.counted:
            self._count(event, nis, alone=True)
        at_odds = not nis <= limit and self.health[index].refused_in_a_row >= PATIENCE and np.isfinite(nis)
        if at_odds and not (self._astray(event) and self._align(event)):
            # Refused for so long, it may be the filter that is wrong: let the measurement pull at the gate's edge.
            f.correct(index, value, event.variance, 2 * limit, scale=nis / limit)

    def _astray(self, velocity: Event) -> bool:
        """Whether the heading is wrong: the car is as fast as GNSS says, yet all that is seen on the map is refused."""
        if self._list[velocity.sensor].kind != "gnss_velocity":
            return False
        speed = np.hypot(*velocity.value)
        same = abs(np.hypot(*self.filter.state[14:16]) - speed) < _SAME_SPEED * speed
        seen = (h for i, h in enumerate(self.health) if self._list[i].kind in ON_MAP and self._sends(i))
        return bool(same and all(h.refused_in_a_row >= PATIENCE for h in seen))

    def _helps(self, event: Event) -> bool:
        """Whether a measurement may correct a filter that does not know its heading, or has told it just now."""
        kind = self._list[event.sensor].kind
        if kind not in ON_MAP:
            return True
        if kind != "gnss_position":
            return self._align(event)
        if not self._velocity_comes() and self._align(event):
            return True
        self._stand(event)
        return False

    def _count(self, event: Event, nis: float, *, alone: bool) -> None:
        """Keep what became of an event, of a measurement its normalized innovation squared; `alone` if the filter has
        not gone on since."""
        event.counted = True
        index = event.sensor
        health, limit = self.health[index], self._limits[index]
        if self.monitor is not None:
            self.monitor.measured(index, nis, self._newest, alone=alone)
        if self._sets[index] is not None:
            health.used += 1
        elif nis <= limit:
            health.refused_in_a_row = 0
            health.used += 1
            health.innovation_ratio += 0.02 * (nis / len(event.value) - health.innovation_ratio)
        else:
            health.refused += 1
            health.refused_in_a_row += 1
            health.complain(f"innovation {abs(nis) ** 0.5:.1f} standard deviations, limit {limit**0.5:.1f}")

    def _recover(self) -> None:
        """Go on from the newest sane state before this instant, with less trust in it; start anew if there is none."""
        self._faults += 1
        for instant in reversed(self._history[:-1]):
            self.filter.memory[:] = instant.kept.memory
            if self.filter.sane():
                self.filter.lose_trust()
                return
        self._stop()
        self.filter.start(0.0)  # whoever looks at it before it starts anew finds a car

    def _remember(self, stamp: int) -> _Instant:
        """Begin a new instant with the filter's present state, in the memory of one that is not needed any more."""
        history = self._history
        if len(history) > 2 and history[0].stamp < stamp - self._reach:
            self._spare.append(history.pop(0))
        instant = self._spare.pop() if self._spare else _Instant(0, 0, self.filter.backup())
        instant.stamp = instant.latest = stamp
        instant.events = []
        if stamp > self._newest:
            self._newest = stamp
        history.append(instant)
        return instant

    # Results

    def estimate(self) -> list[Sample]:
        """All output topics at the newest time; empty before the start."""
        newest = self.snapshot()
        return estimate_samples(newest) if self.started else []

    def snapshot(self) -> Estimate:
        """The newest state in terms of the car."""
        self._catch_up()
        if self.started and not self.filter.sane():
            self._recover()
        return Estimate.of(self.stamp, self.filter)

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""
        e = self.snapshot()
        values = zip(e.parameters.tolist(), e.parameter_deviations.tolist(), strict=True)
        return dict(zip(e.parameter_names, values, strict=True))

    def diagnostics(self, now: int | None = None) -> list[Diagnostic]:
        """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
        now = self._newest_arrival if now is None else now
        lines = [self._own_diagnostic()]
        if self.left_out:
            lines.append(Diagnostic("effects", Level.WARN, self.left_out))
        if isinstance(self.filter, Spi):
            lines.append(self._parameter_diagnostic(self.filter))
        if self.monitor is not None and self.monitor.limits is not None:
            lines.append(self.monitor.diagnostic())
        for name, sensor, health in zip(self.names, self._list, self.health, strict=True):
            lines.append(health.diagnostic(name, sensor, now))
        return lines

    def _parameter_diagnostic(self, spi: Spi) -> Diagnostic:
        seen = spi.observability()
        values = {
            name: f"{value:.6g} ± {deviation:.2g}, {share:.0%} of the deviation at start"
            for name, value, deviation, share in zip(seen.names, spi.values, seen.deviation, seen.share, strict=True)
        }
        values["independent combinations told"] = f"{seen.rank} of {len(seen.names)}"
        closest = np.abs(np.triu(seen.correlation, 1))
        if closest.max(initial=0.0) > 0.9:
            i, j = np.unravel_index(closest.argmax(), closest.shape)
            values["hard to tell apart"] = f"{seen.names[i]} and {seen.names[j]} ({seen.correlation[i, j]:+.2f})"
        if stuck := spi.at_bounds():
            return Diagnostic("parameters", Level.WARN, f"at its bound: {', '.join(stuck)}; {seen}", values)
        return Diagnostic("parameters", Level.OK, str(seen), values)

    def _own_diagnostic(self) -> Diagnostic:
        values = {"faults": str(self._faults), "restarts": str(self._restarts)}
        if not self.started:
            missing = [n for n, h in zip(self.names, self.health, strict=True) if not h.last_stamp]
            text = "waiting for " + (", ".join(missing) if missing else "a speed")
            if missing and not any(self._list[i].kind in _TELL_SPEED for i in self._first):
                able = (n for n, sensor in self.sensors.items() if sensor.kind in _TELL_SPEED)
                text += f"; nothing tells the speed, which {' or '.join(able)} would"
            return Diagnostic("observer", Level.WARN, text, values)
        if not self.heading_known:
            moving = {"gnss_velocity", "gnss_position"} & {s.kind for s in self._list}
            until = "the car moves" if moving else "two antennas tell it"
            return Diagnostic("observer", Level.WARN, f"heading unknown until {until}", values)
        level = Level.OK if self.converged else Level.WARN
        return Diagnostic("observer", level, "converged" if self.converged else "converging", values)


def sensors_of(vehicle: Vehicle) -> dict[str, SensorBase]:
    """A vehicle's sensors by name, with what they take over from the vehicle.

    Raises `InputError` if nothing among them could tell the car's speed, or its steering angle.
    """
    sensors = vehicle.sensing()
    _require_observable(vehicle.name, sensors)
    return sensors


def _require_observable(vehicle: str, sensors: dict[str, SensorBase]) -> None:
    kinds = {s.kind for s in sensors.values()}
    if not kinds & _TELL_SPEED:
        raise InputError(
            f"{vehicle}: no sensor tells the car's speed; the vehicle file lists {sorted(kinds) or 'none'}, "
            "one of wheel_speeds or gnss_velocity is needed"
        )
    if "steering" not in kinds and "imu" not in kinds:
        raise InputError(
            f"{vehicle}: no sensor tells how the car turns; the vehicle file lists {sorted(kinds)}, "
            "one of steering or imu is needed"
        )


def _first_speeds(kinds: dict[str, Event], vehicle: Vehicle) -> list[float]:
    """What each sensor that tells the car's speed says [m/s], the wheels first."""
    speeds = []
    if (wheels := kinds.get("wheel_speeds")) is not None:
        speeds.append(float(np.nanmean(wheels.value) * vehicle.physics.rear.unloaded_radius * 0.98))
    if (velocity := kinds.get("gnss_velocity")) is not None and np.isfinite(velocity.value).all():
        speeds.append(float(np.hypot(*velocity.value)))
    return speeds
