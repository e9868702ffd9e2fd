"""A filter of this room on a stream of messages, whatever their order and state.

As `observer.Observer`: a measurement that comes late is used at its time, what cannot be true is refused and told. The
filter starts once its inputs have come, and, if it estimates a heading, once the heading is known: by two antennas, or
by the course of a car that moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from math import hypot

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation, largest_nis
from vsense_ros.estimation.intake import Intake, Timing, by_topic
from vsense_ros.estimation.reading import Map
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.motion import Motions, Readout
from vsense_ros.navigation.readings import INPUTS, MEASUREMENTS, SPEED

_ALIGNMENT_SPEED = 2.0  # [m/s] above it the course tells the heading
_FASTEST = 150.0  # [m/s]
_LONGEST_PERIOD = 50_000_000  # [ns] between readings of a sensor that holds between them
_PATIENCE = 10.0  # [s] for which a sensor is refused, all the time, before the filter yields to it
_LEAST_REFUSED = 5  # and as many readings at least


class Navigator:
    """The filter `name` of one vehicle on a stream of messages; as `Observer` outside.

    `make` makes the filter of vehicle and sensors, by default as the catalogue does. Raises `InputError` if the vehicle
    file lacks a sensor that the filter needs.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        name: str,
        map_origin: tuple[float, float, float] | None = None,
        make: Callable[[Vehicle, dict[str, SensorBase]], Aided] | None = None,
    ) -> None:
        self.vehicle, self.name = vehicle, name
        self.definition = DEFINITIONS[FILTERS[name].name][1]
        self.sensors = used_sensors(vehicle)
        self.names = tuple(self.sensors)
        self._numbers = car_numbers(vehicle, self.sensors.values())
        self.filter: Aided = (make or FILTERS[name].make)(vehicle, self.sensors)
        self.readout = Readout(self.filter)
        self.left_out = ""
        self.started = False
        self.faults = self.restarts = 0
        settings = vehicle.observer
        self._by_topic = by_topic(tuple(self.sensors.values()))
        self.intake: Intake[SensorBase] = Intake(
            self.sensors, Map(map_origin), settings.history, lambda: self._speed > 1.0
        )
        self.health = self.intake.health
        self._speed = 0.0  # that was last seen [m/s]
        self._first: dict[str, Event] = {}
        self._last: dict[int, int] = {}  # stamps of the newest inertial readings [ns]
        self._refused_since: dict[int, int] = {}
        self._holds = [_only_drives(one, self.filter) for one in self.sensors.values()]
        self._arms = [_arm(sensor) for sensor in self.sensors.values()]
        self._timeline = Timeline(
            self.filter,
            [Channel(key, largest_nis(sensor.gate, len(sensor.deviations()))) for key, sensor in self.sensors.items()],
            reach=settings.history,
            longest_step=settings.longest_step,
            merge=settings.merge_window,
            found=self._count,
            act=self._act,
            in_one_go=lambda: False,
            fault=self._recover,
        )

    @property
    def topics(self) -> dict[str, str]:
        """Topics to subscribe to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self.sensors.values()}

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]; 0 before the start."""
        return self._timeline.stamp

    def add(self, sample: Sample) -> None:
        """Use a message of any topic; messages of unknown topics are ignored. Never raises for bad content."""
        for index in self._by_topic.get(sample.topic, ()):
            event = self.intake.read(index, sample)
            if event is None:
                continue
            event = self._in_axes_of_car(event)
            if not self.started:
                self.intake.believe(index, sample.stamp)
                self._gather(event)
                continue
            timing = self.intake.timing(event, self._timeline.oldest, self.stamp)
            if timing is Timing.RESTART:
                self._stop()
                self.intake.restart(index)
                self._gather(event)
            elif timing is Timing.USED:
                self.intake.believe(index, sample.stamp)
                if self._timeline.add(event):
                    self.health[index].late += 1

    def events(self, samples: Iterable[Sample]) -> list[Event]:
        """The readings in messages that can be true, in the order of their measurement: of a whole recording."""
        found = []
        for sample in samples:
            for index in self._by_topic.get(sample.topic, ()):
                event = self.intake.read(index, sample)
                if event is not None:
                    self.intake.believe(index, sample.stamp)
                    found.append(self._in_axes_of_car(event))
        return sorted(found, key=lambda event: event.stamp)

    def begin_with(self, event: Event) -> None:
        """Before the start: take in a reading."""
        self._gather(event)

    def correct(self, event: Event) -> None:
        """After the start: let a reading act on the filter as it is."""
        self._act(event)

    def _in_axes_of_car(self, event: Event) -> Event:
        """The event with its value in the axes of the car, at cog as far as rates alone tell; of a sensor that only
        drives the filter, half a period earlier, so that what is held from then on is the mean."""
        sensor, value, stamp = self.intake.sensors[event.sensor], event.value, event.stamp
        if "rates and forces" in sensor.tells:
            value = sensor.in_axes_of_car(value[None])[0]
            if (arm := self._arms[event.sensor]) is not None:
                rates = np.where(value[:3] == value[:3], value[:3], 0.0)
                value[3:6] -= rates * rates.dot(arm) - arm * rates.dot(rates)  # ω × (ω × r)
        elif "heading" in sensor.tells and (told := sensor.heading(value, event.variance)) is not None:
            value = np.array([np.cos(told[0]), np.sin(told[0])])
        if self._holds[event.sensor]:
            period = stamp - self._last.get(event.sensor, stamp)
            self._last[event.sensor] = stamp
            if 0 < period < _LONGEST_PERIOD:
                stamp -= period // 2
        return Event(event.sensor, stamp, value, event.variance)

    # Start and stop

    def _gather(self, event: Event) -> None:
        """Keep the newest reading of each sensor until they suffice to start."""
        key = self.names[event.sensor]
        self._first = {k: e for k, e in self._first.items() if abs(e.stamp - event.stamp) < 5e9}
        self._first[key] = event
        if not self._missing():
            seen = self._seen()
            if seen is not None:
                self._start(seen, max(e.stamp for e in self._first.values()))

    def _missing(self) -> list[str]:
        """What the sensors that have come do not tell and the filter needs."""
        names, first = self.filter.input_names, self._first
        missing = []
        for name in names:
            if name in INPUTS and "held" not in name:
                tells, places = INPUTS[name]
                readings = (e.value for key, e in first.items() if tells in self.sensors[key].tells)
                if not any(np.isfinite(value[places[0]]) for value in readings):
                    missing.append(f"{name} ({tells})")
        needs_course = SPEED in names or bool(self._states & {"yaw", "forward_velocity", "velocity_east"})
        if needs_course and not any("course" in self.sensors[key].tells for key in first):
            missing.append("course")
        return missing

    @property
    def _states(self) -> set[str]:
        return {name.rpartition(".")[2] for name in self.filter.names}

    def _seen(self) -> Mapping[str, float] | None:
        """What the first readings tell, by the names of states and numbers; None if that is not enough."""
        seen: dict[str, float] = dict(self._numbers)
        for key, event in self._first.items():
            tells, value = self.sensors[key].tells, event.value
            if "rates and forces" in tells and np.isfinite(value[2]):
                seen["yaw_rate"] = float(value[2])
            if "position" in tells and np.isfinite(value).all():
                seen["east"], seen["north"] = value.tolist()
            if "heading" in tells and np.isfinite(value).all():
                seen["yaw"] = float(np.arctan2(value[1], value[0]))
            if "course" in tells and np.isfinite(value).all():
                speed = hypot(*value.tolist())
                if speed < _FASTEST:
                    seen["forward_velocity"] = self._speed = speed
                    seen["velocity_east"], seen["velocity_north"] = value.tolist()
                if _ALIGNMENT_SPEED < speed < _FASTEST:
                    seen.setdefault("yaw", float(np.arctan2(value[1], value[0])))
        needed = {"q_w": "yaw"}
        if self.definition.finds_heading:
            return seen if "forward_velocity" in seen else None
        unknown = {needed.get(n, n) for n in self._states & {"yaw", "forward_velocity", "q_w"}} - set(seen)
        return None if unknown else seen

    def _start(self, seen: Mapping[str, float], stamp: int) -> None:
        filter = self.filter
        filter.inputs[:] = 0.0
        for key, event in self._first.items():
            filter.give_reading(key, event.value)
        filter.restart_clock()
        filter.start(self.definition.start(seen))
        self.started = True
        self._refused_since.clear()
        self._timeline.clear()
        self._timeline.begin(stamp)

    def _stop(self) -> None:
        self.restarts += 1
        self.started = False
        self._timeline.clear()
        self._first.clear()
        self.intake.forget_clocks()

    def _recover(self) -> None:
        """Go on from the newest valid state before this instant, with less trust in it; start anew if there is none."""
        self.faults += 1
        if not self._timeline.recover():
            self._stop()

    # Filtering

    def _act(self, event: Event) -> None:
        """Let a reading act on the filter, and yield to a sensor that has been refused for long: it may be the filter
        that is wrong."""
        channel = self._timeline.channels[event.sensor]
        found = self.filter.correct(channel.name, event.value, event.variance, channel.limit)
        if not event.counted:
            event.counted = True
            self._count(event, found.nis, found)
        if not found.nis > channel.limit:
            self._refused_since.pop(event.sensor, None)
            return
        since = self._refused_since.setdefault(event.sensor, event.stamp)
        refused = self.health[event.sensor].refused_in_a_row
        if event.stamp - since > _PATIENCE * 1e9 and refused >= _LEAST_REFUSED:
            self.filter.correct(channel.name, event.value, event.variance, 2 * channel.limit, found.nis / channel.limit)

    def _count(self, event: Event, nis: float, innovation: Innovation | None) -> None:
        self.intake.count(event, nis, self._timeline.channels[event.sensor].limit, measured=True)
        if "course" in self.intake.sensors[event.sensor].tells:
            self._speed = float(np.nan_to_num(np.hypot(*event.value)))

    # Results

    def catch_up(self) -> None:
        """Bring the filter to its newest time."""
        self._timeline.catch_up()
        if self.started and not self.filter.is_valid():
            self._recover()

    def motions(self) -> Motions:
        """The newest state in terms of the car."""
        self.catch_up()
        return self.readout.motions([self.readout.snapshot(self.stamp)])

    def estimate(self) -> list[Sample]:
        """All output topics at the newest time; empty before the start."""
        newest = self.output()
        return newest if self.started else []

    def output(self) -> list[Sample]:
        """The same, also before the start, when it means nothing: the topics are those of any estimate."""
        return self.motions().samples()

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""
        e = self.motions()
        values = zip(e.parameters[0].tolist(), e.deviations[0].tolist(), strict=True)
        return dict(zip(e.parameter_names, values, strict=True))

    def diagnostics(self, now: int | None = None) -> list[Diagnostic]:
        """One line for the filter and one for each sensor; `now` [ns] on the clock of arrivals."""
        at = self.intake.newest_arrival if now is None else now
        sensors = zip(self.sensors.items(), self.health, strict=True)
        return [self._own(), *(health.diagnostic(name, sensor, at) for (name, sensor), health in sensors)]

    def _own(self) -> Diagnostic:
        values = {"filter": self.name, "faults": str(self.faults), "restarts": str(self.restarts)}
        if self.started:
            unsure = self._unsure()
            text = f"not told so far: {', '.join(unsure)}" if unsure else "converged"
            return Diagnostic("observer", Level.WARN if unsure else Level.OK, text, values)
        missing = self._missing()
        text = (
            f"waiting for a sensor that tells {', '.join(missing)}"
            if missing
            else "heading unknown until the car moves"
        )
        return Diagnostic("observer", Level.WARN, text, values)

    def _unsure(self) -> list[str]:
        """States of which the drive has told less than half of what was not known at start."""
        now = np.sqrt(self.filter.belief().covariance.diagonal().clip(min=0))
        prior = self.definition.deviations
        names = self.definition.errors
        return [name for name, was, is_ in zip(names, prior, now, strict=True) if was > 0 and is_ > 0.87 * was]


def used_sensors(vehicle: Vehicle) -> dict[str, SensorBase]:
    """The sensors of a vehicle, complete, that any filter of this room could use."""
    used = {one.tells for one in INPUTS.values()} | {one.tells for one in MEASUREMENTS.values()}
    return {key: one for key, one in vehicle.sensing().items() if not used.isdisjoint(one.tells)}


def _arm(sensor: SensorBase) -> NDArray[np.float64] | None:
    """From cog to an inertial sensor [m], None where it is there."""
    if "rates and forces" not in sensor.tells:
        return None
    arm = sensor.mounting()[:3]
    return arm if arm.any() else None


def _only_drives(sensor: SensorBase, filter: Aided) -> bool:
    """Whether an inertial sensor's readings are inputs, and measure nothing."""
    if "rates and forces" not in sensor.tells or not filter.needs(sensor):
        return False
    names = (one.name for one in filter.definition.measurements)
    return not any(name in MEASUREMENTS and MEASUREMENTS[name].tells in sensor.tells for name in names)
