"""Whole sensors that the vote has found to be wrong: left out, asked on, and believed again.

A vote about an axis of an inertial sensor may find that all others, that axis among them, agree without wheels, or
without a receiver, better than without the axis (`recount`). It is then that sensor which is wrong. The filter goes
back to before the contradiction and on without it, and believes axes again that were left out meanwhile. Its newest
message is held against what the filter expects; once they have agreed for a while, twice as long each time, it is
believed.

Wheels and a receiver that give the same speed are not accused: it would be by chance if both were wrong. Where all axes
of an inertial sensor are wrong at once, the filter agrees with it rather than with them.
"""

from __future__ import annotations

from dataclasses import replace

from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Level
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.judge import Judge, Rolled, widening_event
from vsense_ros.runner.steering_judge import axis_of_yaw_rate
from vsense_ros.runner.velocity_judge import VELOCITY
from vsense_ros.runner.velocity_witnesses import SETTINGS
from vsense_ros.runner.vote import Vote
from vsense_ros.runner.vote_settings import VOTE

_OLDEST = 300_000_000  # [ns] of a speed over ground that is held against the wheels: a decision of this project


class JuryJudge(Judge):
    """The sensors of one car besides inertial ones that correct its filter; `out` are the places of those that a vote
    has found to be wrong. `shift` is the channel of events by hand."""

    why = "contradicts what all others agree on"
    level = Level.ERROR  # as of a measurement that is refused for long

    def __init__(
        self, adapter: Adapter, intake: Intake[SensorBase], vote: Vote, channels: list[Channel], shift: int
    ) -> None:
        super().__init__()
        self._adapter, self._intake, self._vote, self._shift = adapter, intake, vote, shift
        self._channels = channels
        moving = ("rolling speed", "ground speed", "course", "position")
        sensors = enumerate(intake.sensors)
        self.hears = frozenset(i for i, one in sensors if not one.is_input and one.measures.intersection(moving))
        self.judged = adapter.knows_car and len(self.hears) > 1 and bool(vote.axes)
        self._wheels, self._course = (place_of(intake.sensors, what) for what in ("rolling speed", "course"))
        self._yaw_rate = axis_of_yaw_rate(intake.sensors)
        self._rolled: Event | None = None  # newest wheel speeds,
        self._travelled: Event | None = None  # and newest velocity over ground
        self._newest: dict[int, Event] = {}  # message of each that is out
        self._agreed: dict[int, int] = {}  # since when it has agreed [ns], 0: it does not
        self._wait: dict[int, int] = {}  # how long it must agree next time [ns]
        if self.judged:
            vote.jury = self._accusable

    @property
    def _waits(self) -> bool:
        """True while there is an alarm, and it is too early for a vote."""
        vote, now = self._vote, self._intake.newest_arrival
        recent = vote.alarm is not None and 0 <= now - vote.heard < VOTE.last_pause
        return recent and 0 <= now - vote.begun < VOTE.settled + VOTE.first_pause

    @property
    def _undecided(self) -> bool:
        """True while it is too early for a vote about an alarm, or one has found somebody suspect and not decided."""
        vote = self._vote
        return self._waits or (vote.undecided and 0 <= self._intake.newest_arrival - vote.heard < VOTE.last_pause)

    @property
    def apart(self) -> Apart | None:
        # If an inertial axis is what is wrong, all of the lateral velocity may be its integral.
        sideways = max(VOTE.unsettled, abs(self._adapter.lateral_speed))
        return Apart(across=sideways) if self._undecided else None

    @property
    def doubts(self) -> list[str]:
        return ["sensors contradict each other"] if self._undecided else []

    def _accusable(self, index: int, axes: list[int]) -> list[int]:
        """Places of sensors that may be found to be wrong, where axes of the inertial sensor at a place seem to be: two
        others that measure the motion are there then. Of how the car turns wheels say something by their differences,
        which no speed over ground confirms."""
        there = [i for i in self.hears if self._intake.sends(i) and i not in self.out]
        if len(there) <= 2 - len(self._vote.axes):
            return []
        if {(index, axis) for axis in axes} == self._yaw_rate or not self._same_speed():
            return there
        return [i for i in there if i not in (self._wheels, self._course)]

    def _same_speed(self) -> bool:
        """True if wheels and receiver, neither of which is out, give the same speed now, within the margins of the
        velocity witnesses and what a car may have gained since the receiver's."""
        newest = self._rolled, self._travelled
        if newest[0] is None or newest[1] is None or self.out & {self._wheels, self._course}:
            return False
        age = self._adapter.timeline.stamp - newest[1].stamp
        sensors, physics = self._intake.sensors, self._adapter.vehicle.physics
        rolled, travelled = (sensors[one.sensor].first_speed(one.value, physics) for one in newest if one is not None)
        if rolled is None or travelled is None or not 0 <= age <= _OLDEST:
            return False
        margin = SETTINGS.speed + SETTINGS.share * travelled + VELOCITY.acceleration * age * 1e-9
        return abs(abs(rolled) - travelled) < margin

    def forget(self, stamp: int) -> None:
        self._rolled = self._travelled = None
        self._newest.clear()
        self._agreed.clear()

    def hear(self, event: Event) -> None:
        if event.sensor in self.out:
            self._newest[event.sensor] = replace(event, value=event.value.copy())
            event.without(list(range(len(event.value))))
        elif event.sensor == self._course:
            self._travelled = event

    def roll(self, rolled: Rolled) -> None:
        self._rolled = rolled.newest

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        """Nothing is to be known of inertial sensors."""

    def settle(self, timeline: Timeline) -> None:
        accused, self._vote.accused = self._vote.accused, None
        if accused is not None and accused not in self.out:
            self._leave_out(accused, timeline)
        if self._vote.doubted:
            self._vote.doubted = False
            apart = Apart(SETTINGS.doubted, SETTINGS.doubted, heading=SETTINGS.sideways)
            for one in self._adapter.doubted_motion(apart, apart.ahead * SETTINGS.windows[0]):
                timeline.add(widening_event(self._shift, timeline.stamp, one))
        for index in [i for i in self.out if i in self._newest]:
            self._ask(index, self._newest.pop(index), timeline)

    def _leave_out(self, index: int, timeline: Timeline) -> None:
        """Go back to before the sensor was wrong, or as far as possible: by then it may have drawn the filter."""
        self.out.add(index)
        self._agreed[index] = 0
        ahead = timeline.rewind(timeline.stamp - VOTE.look_back)
        self._vote.reconsider(timeline.present, ahead)
        for event in ahead:
            if event.sensor == index:
                event.without(list(range(len(event.value))))
        if ahead:
            apart = Apart(SETTINGS.doubted, SETTINGS.sideways * SETTINGS.doubted)
            widened = self._adapter.doubted_motion(apart, apart.ahead * SETTINGS.windows[0])
            ahead[:0] = [widening_event(self._shift, ahead[0].stamp, one) for one in widened]

    def _ask(self, index: int, event: Event, timeline: Timeline) -> None:
        """Compare the newest message of a sensor that is out with what is expected, and believe it once they have
        agreed for long."""
        timeline.catch_up()
        channel = self._channels[index]
        nis = self._adapter.filter.correct(channel.name, event.value, event.variance, -1.0).nis
        if not abs(nis) <= channel.limit:
            self._agreed[index] = 0
            return
        self._agreed[index] = self._agreed[index] or timeline.stamp
        wait = self._wait.get(index, VOTE.agreed)
        if timeline.stamp - self._agreed[index] >= wait:
            self.out.discard(index)
            self._wait[index] = min(2 * wait, VOTE.longest)
