"""The runner: messages in, estimates out, for any filter, whatever the order and the state of the messages.

A measurement that arrives late is used at the time it was made (`estimation.timeline`). What cannot be true is refused
(`estimation.intake`), a sensor that contradicts the others is left out (`vote`), a filter that is wrong itself is moved
(`resets`); all of it is reported (`diagnostics`), and the runner carries on. What a filter has of that, its adapter
says (`adapter`).
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.intake import FROZEN, Intake, Timing, by_topic
from vsense_ros.estimation.reading import Map
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.beginning import UNSURE
from vsense_ros.observer.catalogue import default_filter
from vsense_ros.observer.estimate import BALANCE
from vsense_ros.observer.monitor import Limits, Monitor
from vsense_ros.runner import diagnosis
from vsense_ros.runner.adapter import Adapter, MakeFilter, Move, Placing, Report, Widening, adapter_of
from vsense_ros.runner.direction_judge import DirectionJudge
from vsense_ros.runner.fit_judge import FitJudge
from vsense_ros.runner.force_judge import ForceJudge
from vsense_ros.runner.guard import Guard
from vsense_ros.runner.judge import Judges, moving_event
from vsense_ros.runner.jury_judge import JuryJudge
from vsense_ros.runner.latency_judge import LatencyJudge
from vsense_ros.runner.leap_judge import LeapJudge
from vsense_ros.runner.linkage_judge import LinkageJudge
from vsense_ros.runner.outage_judge import OutageJudge
from vsense_ros.runner.placement import Placement
from vsense_ros.runner.receiver_judge import ReceiverJudge
from vsense_ros.runner.resets import Resets
from vsense_ros.runner.slip_judge import SlipJudge
from vsense_ros.runner.steering_judge import SteeringJudge
from vsense_ros.runner.travel_judge import TravelJudge
from vsense_ros.runner.velocity_judge import VelocityJudge
from vsense_ros.runner.vote import Vote
from vsense_ros.runner.vote_settings import VOTE
from vsense_ros.runner.wheel_judge import WheelJudge

Array = NDArray[np.float64]


class Runner:
    """The filter of one vehicle on a stream of messages.

    `vehicle` names the sensors; those whose messages do not come simply do not contribute. `map_origin` (latitude,
    longitude [deg], height [m]) fixes the map frame; by default it is where the first GNSS fix was made. `make(vehicle,
    sensors)` builds the filter, as those of `runner.catalogue` do; by default it is the errorEKF, or the SPI where the
    vehicle file lists parameters. `on_innovation(sensor, stamp, innovation)` is called once for every measurement that
    the filter was given in its turn (stamp in ns), not again where the runner goes back.

    Raises `InputError` if the vehicle's sensors do not suffice for the filter, or the filter does not fit the vehicle.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        map_origin: tuple[float, float, float] | None = None,
        make: MakeFilter | None = None,
        on_innovation: Callable[[str, int, Innovation], None] | None = None,
    ) -> None:
        self.vehicle = vehicle
        sensors = vehicle.sensing()
        self.filter = (make or default_filter(vehicle))(vehicle, sensors)
        self.adapter: Adapter = adapter_of(self.filter, vehicle, sensors)
        self.sensors = self.adapter.sensors
        self.names = tuple(self.sensors)
        self.started = False
        self.faults = self.restarts = 0
        self._started_at = 0
        self._on_innovation = on_innovation
        self.listeners = by_topic(tuple(self.sensors.values()))
        settings, adapter = vehicle.observer, self.adapter
        self.intake = Intake(self.sensors, Map(map_origin), settings.history, self._is_moving, adapter.merge)
        self.health = self.intake.health
        channels = adapter.channels()
        self.vote = Vote(adapter, channels, others_there=self._others_there, by_hand=self._move, report=self._complain)
        steering = SteeringJudge(adapter, self.vote, len(channels), self._complain)
        direction = DirectionJudge(
            adapter, lambda *turned: self.resets.report(*turned), steering.out, self.vote.left_out
        )
        self.latency = LatencyJudge(adapter, self.vote, len(channels))
        self._leap = LeapJudge(adapter, self.intake)
        judges = (
            self.latency,
            JuryJudge(adapter, self.intake, self.vote, channels, len(channels)),
            WheelJudge(adapter),
            self._leap,
            FitJudge(adapter, self._all_believed, self.latency, len(channels)),
            LinkageJudge(adapter, len(channels)),
            ForceJudge(adapter, lambda: any(self.vote.out)),
            ReceiverJudge(adapter),
            OutageJudge(adapter, self.intake),
            direction,
            steering,
            TravelJudge(adapter, self.intake, self.vote, direction, len(channels)),
            VelocityJudge(adapter),
            SlipJudge(adapter),
        )
        self.judges = Judges(tuple(self.sensors.values()), judges, self.vote.frozen)
        self._timeline = Timeline(
            self.filter,
            [*channels, Channel("shift", 0.0, by_hand=True)],
            reach=settings.history,
            longest_step=settings.longest_step,
            merge=settings.merge_window,
            remembered=VOTE.remembered,
            corrected=self._count,
            act=self.act,
            in_one_go=lambda: adapter.in_one_call and self._on_innovation is None,
            afterwards=adapter.after_event,
            fault=self._recover,
        )
        self._early: list[Event] = []  # readings from beyond the newest state, in the order of their measurement
        adapter.attach(self.intake, self._timeline)
        self.placement = Placement() if adapter.has_position else None
        self._positions = {i for i, sensor in enumerate(self.intake.sensors) if "position" in sensor.measures}
        self.resets = Resets(adapter, self.intake)
        self.guard = Guard(self.filter)

    @property
    def topics(self) -> dict[str, str]:
        """Topics to subscribe to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self.sensors.values()}

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]; 0 before the start."""
        return self._timeline.stamp

    @property
    def left_out(self) -> str:
        """Effects of the vehicle file that the filter does not have, as a sentence; empty for none."""
        return self.adapter.left_out

    @property
    def heading_known(self) -> bool:
        """True once the direction of the car on the map is known."""
        return self.adapter.heading_known

    @property
    def converged(self) -> bool:
        """True once the estimates are known well enough to be used."""
        if not self.started or not self.heading_known or self._leap.blind:
            return False
        return self.adapter.converged((self.stamp - self._started_at) * 1e-9)

    @property
    def monitor(self) -> Monitor | None:
        """The monitor of the model, once `watch` has begun one."""
        return self.adapter.monitor

    def watch(self, limits: Limits | None = None, on_statistics: Report = None) -> Monitor:
        """Watch from now on how well the model fits; arguments as of `Monitor`. Raises `InputError` for a filter
        without a model of the car, and for limits that are not of this vehicle and its sensors."""
        gates = [channel.limit for channel in self._timeline.channels[: len(self.names)]]
        return self.adapter.monitored(gates, lambda: self.converged, limits, on_statistics)

    def add(self, sample: Sample) -> None:
        """Use a message of any topic; messages of unknown topics are ignored. Never raises for bad content."""
        for index in self.listeners.get(sample.topic, ()):
            self.take(index, sample.stamp, self.intake.read(index, sample))

    def take(self, index: int, stamp: int, event: Event | None) -> None:
        """Use what the intake made of a message with a stamp [ns], and what it had held before."""
        if self.intake.has_released:
            for its_stamp, held in self.intake.released(index):
                self.take(index, its_stamp, held)
        if event is None:
            self._look_for_frozen(index)
            return
        event = self.adapter.timed(event)
        self.latency.hear_first(event)
        if self.started:
            self._use(event, stamp)
            return
        self.intake.believe(index, stamp)
        for held, its_stamp in self.intake.hold(event, stamp):
            if self.started:
                self._use(held, its_stamp)
            else:
                self.gather(held)

    def _use(self, event: Event, stamp: int) -> None:
        """Let the filter that has started have a reading of a message with a stamp [ns], if that can be true."""
        index, newest = event.sensor, self._timeline.stamp
        timing = self.intake.timing(event, self._timeline.oldest, newest)
        if timing is Timing.USED:
            if newest < self._started_at + UNSURE and self.adapter.contradicts_start(event):
                return
            self.intake.believe(index, stamp)
            if event.stamp > stamp and event.stamp > newest:
                self._keep_early(event)
                return
            if self._early:
                self._use_early(event.stamp)
            self._use_in_time(event)
        elif timing is Timing.RESTART:
            self._stop(valid=True)
            self.intake.restart(index)
            self.gather(event)

    def _use_in_time(self, event: Event) -> None:
        """Let the filter have a reading, at the time it was measured."""
        timeline, judges = self._timeline, self.judges
        judges.before(timeline, event)
        self.adapter.measured(event)
        judges.hear(event)
        if timeline.add(event):
            self.health[event.sensor].late += 1
        self._settle()

    def _keep_early(self, event: Event) -> None:
        """Keep a reading until others are from its time, or until the next one of its sensor.

        A clock that stamps early (a negative `latency`) may deliver a reading before the time that it belongs to. The
        filter would go ahead to it, and back for all that other sensors measure until then.
        """
        earlier = [early.stamp for early in self._early if early.sensor == event.sensor]
        if earlier:
            self._use_early(earlier[0])
        insort(self._early, event, key=lambda early: early.stamp)

    def _use_early(self, stamp: int) -> None:
        """Use the readings that waited for a time [ns]."""
        while self._early and self._early[0].stamp <= stamp:
            self._use_in_time(self._early.pop(0))

    def readings(self, samples: Iterable[Sample]) -> list[Event]:
        """The readings in the messages of a whole recording that can be true, in the order of their measurement."""
        events = []
        for sample in samples:
            for index in self.listeners.get(sample.topic, ()):
                newest = sample.stamp, self.intake.read(index, sample)
                for stamp, event in (*self.intake.released(index), newest):
                    if event is not None:
                        self.intake.believe(index, stamp)
                        events.append(self.adapter.timed(event))
        return sorted(events, key=lambda event: event.stamp)

    def _look_for_frozen(self, index: int) -> None:
        """Leave out a whole inertial sensor that has repeated itself too often."""
        health = self.health[index]
        if self.started and index in self.vote.axes and health.same_in_a_row == FROZEN:
            self.vote.froze(index, np.frombuffer(health.last_content))
            self._settle()

    def _settle(self) -> None:
        """Do what resets and the vote ask for."""
        if self.resets.waiting:
            for move in self.resets.asked():
                self._shift(move)
        vote, timeline = self.vote, self._timeline
        if self.judges.settle(timeline):
            vote.wait, vote.confirmed, vote.spared = self.judges.suspect, self.judges.confirms, self.judges.spares
        if vote.due(timeline.stamp):
            vote.decide(timeline)
        while vote.returned:
            sensor, axis, jump = vote.returned.pop()
            bias = self.adapter.bias(sensor, axis, jump)
            if bias is not None:
                element, deviation = bias
                self._shift(Move(element, 0.0, deviation))

    def _shift(self, move: Move) -> None:
        """Move an element of the state now, and whenever this instant happens again."""
        self._timeline.add(moving_event(len(self.names), self.stamp, move))

    # Start and stop

    def gather(self, event: Event) -> None:
        """Before the start: keep a reading, and start once the readings suffice."""
        if self.guard.pausing(event.stamp):
            return
        stamp = self.adapter.gather(event)
        if stamp is None:
            return
        self.started, self._started_at = True, stamp
        self.guard.begin(stamp)
        self._timeline.clear()
        self.vote.forget(stamp)
        self.judges.forget(stamp)
        self.resets.forget()
        if self.placement is not None:
            self.placement.forget()
        self.adapter.start(stamp)
        self._timeline.begin(stamp)

    def _stop(self, *, valid: bool) -> None:
        """Wait for what it takes to start anew; the filter's state is spoilt if it is not `valid`."""
        self.restarts += 1
        self.started = False
        self._timeline.clear()
        self._early.clear()
        self.intake.forget_clocks()
        self.adapter.stop(valid)

    def _recover(self) -> None:
        """Go on from the newest valid state before this instant, with less trust in it; start anew if there is none,
        and give the filter up where it has gone on so too often."""
        self.faults += 1
        if not self.guard.recovered(self.stamp):
            self._give_up("it has no state any more that the model can go on from")
        elif not self._timeline.recover():
            self._stop(valid=False)

    def _restore(self, why: str) -> None:
        """The filter has diverged: go on from its last good state, start anew if there is none, and give the filter up
        where that has been too often."""
        self.faults += 1
        if not self.guard.recovered(self.stamp):
            self._give_up(why)
            return
        age = self.guard.restore(self.stamp)
        if age is None:
            self._stop(valid=False)
            return
        self.adapter.aged(age)
        self._timeline.begin(self.stamp)
        self.vote.forget(self.stamp)
        self.judges.forget(self.stamp)
        self.resets.forget()
        self.resets.report(self.stamp, f"gone back to the state of {age:.1f} s before: {why}")

    def _give_up(self, why: str) -> None:
        """Stop the filter, which is an error, until it may start anew."""
        self.guard.give_up(self.stamp, why)
        self._stop(valid=False)

    # Filtering

    def act(self, event: Event) -> None:
        """Let an event act on the filter at its present time; what happens again is not counted again."""
        channel, adapter = self._timeline.channels[event.sensor], self.adapter
        _, limit, first_input, by_hand = channel
        innovation: Innovation | None = None
        nis = 0.0
        if by_hand:
            self._move(event)
            return
        if first_input is not None:
            adapter.give(channel, event)
        elif adapter.accepts(event):
            axes = self.vote.axes.get(event.sensor)
            if axes is None:
                innovation = adapter.correct(channel, event)
            else:
                innovation = self.vote.correct(axes, event, first=not event.counted)
            nis = innovation.nis
            if self._on_innovation is not None and not event.counted:
                self._on_innovation(channel.name, event.stamp, innovation)
        else:
            event.counted = True
            return
        if not event.counted:
            event.counted = True
            self._count(event, nis, innovation)
        if not nis <= limit and innovation is not None:
            self._contradicted(event, channel, innovation)

    def _contradicted(self, event: Event, channel: Channel, innovation: Innovation) -> None:
        """A measurement was refused. If that goes on for long, it may be the filter that is wrong."""
        self.resets.refused(event, innovation)
        if self._leap.is_open(event.sensor):
            return
        if not self.intake.out_of_patience(event.sensor, innovation.nis, channel.limit):
            return
        if self.adapter.begin_anew(event):
            self.resets.report(self.stamp, f"heading and velocity begun anew as {channel.name} measures them")
        elif self.resets.is_alone(event.sensor) and not self.resets.ask(event, self.stamp, channel.name):
            self.adapter.pull(channel, event, innovation.nis)

    def _count(self, event: Event, nis: float, innovation: Innovation | None) -> None:
        """Keep what became of an event; its innovation by component, if the filter has not gone on since."""
        index, timeline = event.sensor, self._timeline
        _, limit, first_input, _ = timeline.channels[index]
        monitor = self.adapter.monitor
        if monitor is not None:
            whitened = None if innovation is None else innovation.whitened
            monitor.measured(index, nis, timeline.stamp, whitened)
        measured = first_input is None
        self.intake.count(event, nis, limit, measured=measured)
        if index in self._positions and 0 <= nis <= limit and self.placement is not None:
            self.placement.believed(event.stamp)
        if measured and index not in self.vote.axes:
            self.vote.measured(index, timeline.stamp, nis, len(event.value), limit)

    def _complain(self, index: int, sentence: str) -> None:
        """Keep what is wrong with the newest message of a sensor."""
        self.health[index].complain(sentence)

    def _is_moving(self) -> bool:
        return self.adapter.moving

    def _others_there(self) -> bool:
        """True if a sensor that is believed measures the car's motion besides inertial sensors. GNSS counts once the
        heading is known: before that it does not tell how the car moves along and across itself."""
        return any(
            not sensor.is_input and i not in self.vote.axes and not self.health[i].contradicts and self.intake.sends(i)
            for i, sensor in enumerate(self.intake.sensors)
            if (self.heading_known or not sensor.on_map) and not any(i in judge.out for judge in self.judges)
        )

    def _all_believed(self) -> bool:
        """True unless a sensor is left out, or an axis of one for so long that it would be back if it were right."""
        since = self.stamp - VOTE.longest
        return not any(judge.out for judge in self.judges) and not any(out.decided < since for *_, out in self.vote.out)

    def _move(self, event: Event) -> None:
        """Do what an event asks for that is no measurement: move or place an element of the state, or widen its
        variance."""
        element, *numbers = event.value.tolist()
        if len(numbers) == 1:
            self.adapter.widen(Widening(int(element), *numbers))
        elif len(numbers) == 3:
            self.adapter.place(Placing(int(element), *numbers))
        else:
            self.adapter.move(Move(int(element), *numbers))

    # Results

    def estimate(self) -> list[Sample]:
        """All output topics at the newest time; empty before the start."""
        return list(self.newest())

    def newest(self) -> Iterator[Sample]:
        """As `estimate`, each message as soon as it is made, the odometry first."""
        newest = self.incomplete_snapshot()
        for sample in self.adapter.messages(newest) if self.started else ():
            if sample.topic != BALANCE or any(np.isfinite(values).any() for values in sample.values.values()):
                yield sample

    def output(self) -> list[Sample]:
        """All output topics, also before the start, when their values mean nothing."""
        return list(self.adapter.messages(self.snapshot()))

    def snapshot(self) -> Any:
        """The newest state in terms of the car: an `Estimate`, or a `Snapshot` of a filter of GNSS and inertial
        sensors."""
        newest = self.incomplete_snapshot()
        self.adapter.complete()
        return newest

    def incomplete_snapshot(self) -> Any:
        """As `snapshot`, for one of many states that `Adapter.columns` will complete at once."""
        self._timeline.catch_up()
        if self.started and not self.filter.is_valid():
            self._recover()
        newest = self.adapter.snapshot(self.stamp)
        if self.started and self.guard.due(self.stamp):
            wrong = self.guard.look(self.stamp, self.adapter.vitals(newest))
            if wrong:
                self._restore(wrong)
                newest = self.adapter.snapshot(self.stamp)
        if self.started:
            self.adapter.watch(newest, lambda: self.converged)
            apart = self.judges.apart
            if apart is not None:
                self.adapter.widen_published(newest, apart)
        return newest

    def snapshot_at(self, stamp: int) -> Any:
        """The state predicted to a time [ns] at or after the newest measurement, as `snapshot`."""
        if self.started:
            self._use_early(stamp)
            self._timeline.go_on(stamp)
        return self.snapshot()

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""
        return self.adapter.parameters(self.snapshot())

    def diagnostics(self, now: int | None = None) -> list[Diagnostic]:
        """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
        return diagnosis.lines(self, self.intake.newest_arrival if now is None else now)
