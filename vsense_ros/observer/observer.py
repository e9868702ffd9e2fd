"""The observer: messages in, estimates out, whatever the order and the state of the messages.

A measurement that arrives late is used at the time it was made (`estimation.timeline`). What cannot be true is refused
(`estimation.intake`), said (`observer.diagnostics`), and the observer carries on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Given, Innovation, largest_nis
from vsense_ros.estimation.intake import FROZEN, Intake, Timing, by_topic
from vsense_ros.estimation.reading import Map
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.coordinates import SPIN
from vsense_ros.model.sensors import KINDS, SensorBase
from vsense_ros.model.vehicle import Vehicle, left_out_of_observer
from vsense_ros.observer import diagnostics
from vsense_ros.observer.alignment import Alignment
from vsense_ros.observer.balance import Balance
from vsense_ros.observer.beginning import UNSURE, Beginning, Start
from vsense_ros.observer.catalogue import MakeFilter, default_filter
from vsense_ros.observer.estimate import BALANCE, Estimate, estimate_samples
from vsense_ros.observer.monitor import Limits, Monitor
from vsense_ros.observer.placement import Placement
from vsense_ros.observer.resets import Resets
from vsense_ros.observer.road_map import RoadMap
from vsense_ros.observer.state import FORWARD, LATERAL, YAW_RATE, U
from vsense_ros.observer.tilt import Tilt
from vsense_ros.observer.vote import REMEMBERED, Vote

Array = NDArray[np.float64]

_SPINS = range(SPIN.start, SPIN.stop)
_MOVING = 1.0  # [m/s] below it an inertial sensor of coarse resolution may well repeat itself


class Observer:
    """The filter of one vehicle on a stream of messages.

    `vehicle` names the sensors; those whose messages do not come simply do not contribute. `map_origin` (latitude,
    longitude [deg], height [m]) fixes the map frame; by default it is where the first GNSS fix was made. `make` builds
    the filter (`observer.catalogue`), by default the errorEKF, or the SPI where the vehicle file lists parameters.
    `on_innovation(sensor, stamp, innovation)` is called once for every measurement that the filter was given in its
    turn (stamp in ns), not again where the observer goes back.

    Raises `InputError` if nothing in the sensor set could tell the car's speed, or its steering angle, or if the filter
    does not fit the vehicle.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        map_origin: tuple[float, float, float] | None = None,
        make: MakeFilter | None = None,
        on_innovation: Callable[[str, int, Innovation], None] | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.sensors = sensors_of(vehicle)
        self.names = tuple(self.sensors)
        self.filter = (make or default_filter(vehicle))(vehicle, self.sensors)
        self.car = self.filter.car
        self.left_out = left_out_of_observer(vehicle)
        self.monitor: Monitor | None = None
        self.started = False
        self.faults = self.restarts = 0
        self._started_at = 0
        self._on_innovation = on_innovation
        self._by_topic = by_topic(tuple(self.sensors.values()))
        on_map, settings = Map(map_origin), vehicle.observer
        self._road_map = RoadMap.of(vehicle, on_map)
        mean = self.car.mean
        self.intake = Intake(
            self.sensors,
            on_map,
            settings.history,
            lambda: abs(mean[FORWARD]) > _MOVING,
            settings.merge_window,
        )
        self.health = self.intake.health
        channels = [_channel(name, sensor) for name, sensor in self.sensors.items()]
        self.vote = Vote(
            self.filter,
            channels,
            {
                i: (tuple(c.words for c in sensor.components), sensor.gate)
                for i, sensor in enumerate(self.sensors.values())
                if "rates and forces" in sensor.tells
            },
            others_there=self._others_there,
            moving=lambda: abs(mean[FORWARD]) > _MOVING,
            by_hand=self._set,
            tell=lambda index, sentence: self.health[index].complain(sentence),
        )
        self._timeline = Timeline(
            self.filter,
            [*channels, Channel("shift", 0.0, by_hand=True)],
            reach=settings.history,
            longest_step=settings.longest_step,
            merge=settings.merge_window,
            remembered=REMEMBERED,
            found=self._count,
            act=self._act,
            in_one_go=lambda: self._alignment.known and self._on_innovation is None,
            afterwards=self._look_up_road,
            fault=self._recover,
        )
        places = any("position" in sensor.tells for sensor in self.sensors.values())
        self.placement = Placement() if places else None
        self.resets = Resets(self.car, self.intake)
        self._alignment = Alignment(self.filter, self._timeline, self.intake)
        self.balance = Balance(vehicle, self.sensors)
        self.tilt = Tilt(self.sensors, self.car)
        self._beginning = Beginning(vehicle, self.intake, self.car.largest[FORWARD])

    @property
    def topics(self) -> dict[str, str]:
        """Topics to subscribe to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self.sensors.values()}

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]; 0 before the start."""
        return self._timeline.stamp

    @property
    def heading_known(self) -> bool:
        """Whether the car's direction on the map is."""
        return self._alignment.known

    @property
    def converged(self) -> bool:
        """Whether velocity, yaw rate and side slip are known well enough to be used."""
        if not self.started or not self.heading_known:
            return False
        deviation = np.sqrt(self.filter.belief().covariance.diagonal()[[FORWARD, LATERAL, YAW_RATE]])
        return bool(self.stamp - self._started_at > 1e9 and np.all(deviation < (0.5, 0.5, 0.02)))

    def watch(self, limits: Limits | None = None, on_statistics: Callable[[int, Array], None] | None = None) -> Monitor:
        """Watch from now on whether the model fits; arguments as of `Monitor`. Raises `InputError` for limits that are
        not of this vehicle and its sensors."""
        if limits is not None and limits.vehicle != self.vehicle.name:
            raise InputError(
                f"the limits of the monitor are those of the vehicle {limits.vehicle!r}, this is {self.vehicle.name!r}"
            )
        gates = [channel.limit for channel in self._timeline.channels[: len(self.names)]]
        self.monitor = Monitor(self.car, self.sensors, gates, lambda: self.converged, limits, on_statistics)
        return self.monitor

    def add(self, sample: Sample) -> None:
        """Use a message of any topic; messages of unknown topics are ignored. Never raises for bad content."""
        for index in self._by_topic.get(sample.topic, ()):
            event = self.intake.read(index, sample)
            if event is None:
                if self.started and index in self.vote.axes and self.health[index].same_in_a_row == FROZEN:
                    self.vote.froze(index, np.frombuffer(self.health[index].last_content))
                    self._settle()
                continue
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
                if self.stamp < self._started_at + UNSURE and self._beginning.doubts(event):
                    continue
                self.intake.believe(index, sample.stamp)
                self.balance.measured(event)
                if self._timeline.add(event):
                    self.health[index].late += 1
                self._settle()

    def _settle(self) -> None:
        """Do what the sensors' vote asks for."""
        if self.resets.waiting:
            for element, by, deviation in self.resets.asked():
                self._shift(element, by, deviation)
        vote = self.vote
        if vote.due(self.stamp):
            vote.decide(self._timeline)
        while vote.returned:
            sensor, axis, jump = vote.returned.pop()
            bias = self.car.layout.biases[sensor].start + axis
            self._shift(bias, 0.0, float(np.hypot(self.car.prior.deviation[bias], jump)))

    def _shift(self, element: int, by: float, deviation: float) -> None:
        """Move an element of the state, whose error then has this deviation and no correlation; now, and whenever this
        instant happens again."""
        event = Event(len(self.names), self.stamp, np.array([element, by, deviation]), np.zeros(3), counted=True)
        self._timeline.add(event)

    # Start and stop

    def _gather(self, event: Event) -> None:
        start = self._beginning.add(event)
        if start is not None:
            self._start(start)

    def _start(self, start: Start) -> None:
        filter, mean, events = self.filter, self.car.mean, start.events
        filter.start_rolling(start.speed)
        self.balance.forget()
        self.tilt.forget()
        for event in events.values():
            sensor = self.intake.sensors[event.sensor]
            self.balance.measured(event)
            if sensor.inputs is not None:
                filter.inputs[sensor.inputs] = np.nan_to_num(event.value)
            for place, velocity in sensor.first_velocities(event.value).items():
                at = U.start + place
                at_rest = place in _SPINS and start.speed <= _MOVING  # where the noise of the wheels would be slip
                if abs(velocity) < self.car.largest[at] and not at_rest:
                    mean[at] = velocity
        self.started, self._started_at = True, start.stamp
        if self.monitor is not None:
            self.monitor.forget()
        self._timeline.clear()
        self.vote.forget(start.stamp)
        self.resets.forget()
        if self.placement is not None:
            self.placement.forget()
        filter.linearize()
        self._alignment.start(events)
        self._timeline.begin(start.stamp)

    def _stop(self) -> None:
        """Wait for what it takes to start anew."""
        self.restarts += 1
        self.started = False
        self._timeline.clear()
        self._beginning.clear()
        self.intake.forget_clocks()

    def _recover(self) -> None:
        """Go on from the newest valid state before this instant, with less trust in it; start anew if there is none."""
        self.faults += 1
        if not self._timeline.recover():
            self._stop()
            self.filter.start_rolling(0.0)  # whoever looks at it before it starts anew finds a car

    # Filtering

    def _act(self, event: Event) -> None:
        """Let an event act on the filter at its present time; what happens again is not counted again."""
        channel = self._timeline.channels[event.sensor]
        innovation: Innovation | None = None
        if channel.by_hand:
            self._set(event)
            return
        if channel.first_input is not None:
            self.filter.give(Given(channel.first_input, event.value))
        elif self._alignment.known or self._alignment.helps(event):
            axes = self.vote.axes.get(event.sensor)
            if axes is None:
                innovation = self.filter.correct(channel.name, event.value, event.variance, channel.limit)
            else:
                innovation = self.vote.correct(axes, event, first=not event.counted)
            if self._on_innovation is not None and not event.counted:
                self._on_innovation(channel.name, event.stamp, innovation)
        else:
            event.counted = True
            return
        nis = 0.0 if innovation is None else innovation.nis
        if not event.counted:
            event.counted = True
            self._count(event, nis, innovation)
        if not nis <= channel.limit and innovation is not None:
            self._contradicted(event, channel, innovation)

    def _contradicted(self, event: Event, channel: Channel, innovation: Innovation) -> None:
        """A measurement was refused. If that goes on for long, it may be the filter that is wrong."""
        self.resets.refused(event, innovation)
        if not self.intake.out_of_patience(event.sensor, innovation.nis, channel.limit):
            return
        if self._alignment.astray(event) and self._alignment.begin_anew(event):
            self.resets.tell(self.stamp, f"heading and velocity begun anew as {channel.name} tells them")
        elif self.resets.is_alone(event.sensor) and not self.resets.ask(event, self.stamp, channel.name):
            # Let the measurement pull at the gate's edge.
            pull = innovation.nis / channel.limit
            self.filter.correct(channel.name, event.value, event.variance, 2 * channel.limit, pull)

    def _count(self, event: Event, nis: float, innovation: Innovation | None) -> None:
        """Keep what became of an event; its innovation by component, if the filter has not gone on since."""
        channel = self._timeline.channels[event.sensor]
        if self.monitor is not None:
            whitened = None if innovation is None else innovation.whitened
            self.monitor.measured(event.sensor, nis, self.stamp, whitened)
        measured = channel.first_input is None
        self.intake.count(event, nis, channel.limit, measured=measured)
        place = self.placement
        if place is not None and 0 <= nis <= channel.limit and "position" in self.intake.sensors[event.sensor].tells:
            place.believed(event.stamp)
        if measured and event.sensor not in self.vote.axes:
            self.vote.measured(event.sensor, self.stamp, nis, len(event.value), channel.limit)

    def _others_there(self) -> bool:
        """Whether something measures the car's motion besides inertial sensors."""
        return any(
            not sensor.is_input and i not in self.vote.axes and not self.health[i].contradicts and self.intake.sends(i)
            for i, sensor in enumerate(self.intake.sensors)
        )

    def _set(self, event: Event) -> None:
        """What `_shift` asks for."""
        element, by, deviation = event.value.tolist()
        self.filter.set_element(int(element), float(self.car.mean[int(element)]) + by, deviation)

    def _look_up_road(self) -> None:
        """Where the vehicle file knows the road from place to place, take it as it is where the car is."""
        if self._road_map is not None and self._alignment.known:
            self._road_map.follow(self.filter)

    # Results

    def estimate(self) -> list[Sample]:
        """All output topics at the newest time; empty before the start."""
        newest = self.output()
        if not self.started:
            return []
        told = [v for sample in newest if sample.topic == BALANCE for v in sample.values.values()]
        return [sample for sample in newest if sample.topic != BALANCE or np.isfinite(told).any()]

    def output(self) -> list[Sample]:
        """The same, also before the start, when it means nothing: the topics are those of any estimate."""
        return estimate_samples(self.snapshot())

    def snapshot(self) -> Estimate:
        """The newest state in terms of the car."""
        self._timeline.catch_up()
        if self.started and not self.filter.is_valid():
            self._recover()
        made = Estimate.of(self.stamp, self.filter)
        if self.started:
            made.unbalanced[:] = self.balance.residual(made)
            self.tilt.look(self.stamp, lambda: self.converged)
        return made

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""
        e = self.snapshot()
        values = zip(e.parameters.tolist(), e.parameter_deviations.tolist(), strict=True)
        return dict(zip(e.parameter_names, values, strict=True))

    def diagnostics(self, now: int | None = None) -> list[Diagnostic]:
        """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
        return diagnostics.of_observer(self, self.intake.newest_arrival if now is None else now)

    @property
    def waits_for_speed(self) -> bool:
        """Whether nothing has come yet that could tell the speed."""
        return not self._beginning.tells_speed


def _channel(name: str, sensor: SensorBase) -> Channel:
    part = sensor.inputs
    limit = largest_nis(sensor.gate, len(sensor.deviations()))
    return Channel(name, limit, None if part is None else part.start)


def sensors_of(vehicle: Vehicle) -> dict[str, SensorBase]:
    """A vehicle's sensors by name, with what they take over from the vehicle.

    Raises `InputError` if nothing among them could tell the car's speed, or its steering angle.
    """
    sensors = vehicle.sensing()
    kinds = sorted({s.kind for s in sensors.values()}) or "none"
    for what, told in (("the car's speed", SensorBase.tells_speed), ("how the car turns", SensorBase.tells_turning)):
        if not any(told.__get__(sensor) for sensor in sensors.values()):
            able = " or ".join(name for name, kind in KINDS.items() if told.__get__(kind.model_construct()))
            raise InputError(
                f"{vehicle.name}: no sensor tells {what}; the vehicle file lists {kinds}, one of {able} is needed"
            )
    return sensors
