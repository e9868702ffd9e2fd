"""A sensor of where the car goes that is wrong: left out once the direct witnesses say so, and believed again."""

from __future__ import annotations

from dataclasses import replace

from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.messages.diagnostic import Level
from vsense_ros.model.sensors import SensorBase
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.direction_judge import DirectionJudge
from vsense_ros.runner.judge import Judge, Rolled, widening_event
from vsense_ros.runner.velocity_witnesses import SETTINGS, VelocityWitnesses
from vsense_ros.runner.vote import Vote
from vsense_ros.runner.vote_settings import VOTE


class TravelJudge(Judge):
    """Wheels, velocity and position of one car, as far as the runner may leave one of them out; `out` are the places of
    those that are."""

    level = Level.ERROR  # as of a measurement that is refused for long

    def __init__(
        self, adapter: Adapter, intake: Intake[SensorBase], vote: Vote, direction: DirectionJudge, shift: int
    ) -> None:
        super().__init__()
        self._adapter, self._intake, self._vote, self._direction = adapter, intake, vote, direction
        self._shift = shift
        self.witnesses = VelocityWitnesses(adapter.vehicle, adapter.sensors)
        witnesses = self.witnesses
        self.hears = frozenset(i for i in (witnesses.wheels, witnesses.velocity, witnesses.position) if i >= 0)
        self.judged = self.witnesses.possible and adapter.knows_car
        self._first = "wheels" if witnesses.wheels >= 0 else "acceleration"
        self.why = f"contradicts the two others of {self._first}, velocity and position"
        self._wait: dict[int, float] = {}  # how long each must agree next time [s]
        self._rolled: Event | None = None  # the newest wheel speeds of a block, believed or not

    @property
    def suspect(self) -> bool:  # type: ignore[override]
        since = self.witnesses.since
        return not self.out and since > 0 and self._intake.newest_arrival - since < SETTINGS.longest_wait * 1e9

    @property
    def _undecided(self) -> bool:
        """True while two of them contradict each other, and it is not decided who is wrong."""
        return not self.out and self.witnesses.since > 0

    @property
    def doubts(self) -> list[str]:
        if not self._undecided:
            return []
        return [f"{self._first}, velocity and position are apart by {self.witnesses.apart_by:.1f} m/s"]

    @property
    def apart(self) -> Apart | None:
        return self._apart_by() if self._undecided else None

    def _apart_by(self) -> Apart:
        """How far the estimated velocity may be from the actual one, where one of them is wrong."""
        ahead = min(self.witnesses.apart_by, SETTINGS.doubted)
        return Apart(ahead, SETTINGS.sideways * ahead, place=self._gone_astray())

    def _gone_astray(self) -> float:
        """How far a position that is wrong may have drawn the place since it began to contradict [m]."""
        since = (self._intake.newest_arrival - self.witnesses.since) * 1e-9
        return self.witnesses.apart_by * min(since + SETTINGS.windows[1], SETTINGS.windows[-1])

    def forget(self, stamp: int) -> None:
        self.witnesses.forget()

    def hear(self, event: Event) -> None:
        if not self._adapter.heading_known:
            return
        heard = event
        if event.sensor in self.out:
            heard = replace(event)
            event.without(list(range(len(event.value))))
        if event.sensor == self.witnesses.wheels:
            self._rolled = heard
        else:
            self.witnesses.hear(heard, self._heading)

    def roll(self, rolled: Rolled) -> None:
        if self._rolled is not None:
            self.witnesses.hear(self._rolled, self._heading)
            self._rolled = None

    def settle(self, timeline: Timeline) -> None:
        witnesses = self.witnesses
        wrong = witnesses.wrong
        if (
            wrong is not None
            and wrong not in self.out
            and self._adapter.heading_known
            and not self._is_refused(wrong, timeline.stamp)
        ):
            if witnesses.opposite:
                self._reverse_wheels(timeline)
            else:
                self._leave_out(wrong, timeline)
        for index in list(self.out):
            since = witnesses.agreed[index]
            wait = self._wait.get(index, SETTINGS.agreed)
            if since and (timeline.stamp - since) * 1e-9 >= wait:
                self.out.discard(index)
                self._wait[index] = min(2 * wait, SETTINGS.longest)

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        self.witnesses.feel(stamp, felt, self._adapter.heading)

    def _heading(self) -> float:
        return self._adapter.heading

    def _is_refused(self, index: int, now: int) -> bool:
        """True for a position that has jumped of late: the gate refuses it, and the filter is moved there if it
        stays."""
        refused = self._intake.health[index].refused_to
        return index == self.witnesses.position and now - refused < SETTINGS.windows[-1] * 1e9

    def _reverse_wheels(self, timeline: Timeline) -> None:
        """Take the wheel speeds with the other sign: most wheel sensors have none, and the car goes backwards."""
        self._direction.reverse()
        since = self.witnesses.since
        ahead = timeline.rewind(max(since - int(SETTINGS.windows[0] * 1e9), timeline.stamp - VOTE.look_back))
        self._vote.reconsider(since - int(SETTINGS.before * 1e9), ahead)
        for event in ahead:
            if event.sensor == self.witnesses.wheels:
                event.value = -event.value
        self.witnesses.reverse_wheels()

    def _leave_out(self, index: int, timeline: Timeline) -> None:
        """Go back to before the sensor was wrong, or as far as possible: by then it may have drawn the filter."""
        self.out.add(index)
        witnesses, now = self.witnesses, timeline.stamp
        ahead = timeline.rewind(now - VOTE.look_back)
        self._vote.reconsider(witnesses.since - int(SETTINGS.before * 1e9), ahead)
        for event in ahead:
            if event.sensor == index:
                event.without(list(range(len(event.value))))
        if ahead:
            apart = self._apart_by()
            way = self._gone_astray() if index == witnesses.position else apart.ahead * SETTINGS.windows[0]
            apart = Apart() if index == witnesses.position else apart
            widened = self._adapter.doubted_motion(apart, way)
            ahead[:0] = [widening_event(self._shift, ahead[0].stamp, one) for one in widened]
