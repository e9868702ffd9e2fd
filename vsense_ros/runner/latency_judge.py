"""A sensor whose stamps are late: its readings are used at the time that they were made, and that is said.

What lags are, `latency` estimates from the readings as they come. Where one becomes certain, the filter goes back as
far as it remembers, takes the readings since then at their times, and doubts what it has made of the earlier ones.
"""

from __future__ import annotations

from operator import attrgetter

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.runner.adapter import Adapter, Apart, Move
from vsense_ros.runner.judge import Judge, moving_event, widening_event
from vsense_ros.runner.lag_doubt import GAIN
from vsense_ros.runner.latency import Latencies
from vsense_ros.runner.velocity_witnesses import SETTINGS
from vsense_ros.runner.vote import Vote
from vsense_ros.runner.vote_settings import VOTE


class LatencyJudge(Judge):
    """Estimates by how much each sensor of one car is late; the runner lets it `hear_first` what every message says,
    and takes `late` off the stamps of what the filter is given."""

    def __init__(self, adapter: Adapter, vote: Vote, shift: int) -> None:
        super().__init__()
        self._adapter, self._vote, self._shift = adapter, vote, shift
        self.hears = frozenset()
        self._names = tuple(adapter.sensors)
        self._reach = adapter.vehicle.observer.history
        latencies = Latencies(adapter.vehicle, adapter.sensors) if adapter.knows_car else None
        self.latencies = latencies if latencies is not None and latencies.possible else None
        self.judged = self.latencies is not None
        if self.latencies is not None:
            car = car_numbers(adapter.vehicle)
            self._base = car["to_front"] + car["to_rear"]
            softer = car["to_rear"] / car["front_stiffness"] - car["to_front"] / car["rear_stiffness"]
            self._understeer = max(car["mass"] / self._base * softer, 0.0)  # [s²/m] of the single-track model
        self._late: dict[int, int] = {}  # that are not in time [ns]
        self.changes = 0  # how often others have turned out to be late

    def hear_first(self, event: Event) -> None:
        """Take in a reading with the stamp of its message, and give it the time at which it was made."""
        if self.latencies is not None:
            self.latencies.hear(event)
            if self._late:
                event.stamp -= self._late.get(event.sensor, 0)

    @property
    def seems_late(self) -> bool:
        """True while one sensor feels the car gain speed later than another, or may do so."""
        return self.latencies is not None and self.latencies.doubt.lags[GAIN] > 0

    @property
    def doubts(self) -> list[str]:
        return [f"{self._names[index]} is {self._in_words(index)}" for index in self._late]

    def doubt(self, index: int) -> str:
        return f"stamps are {self._in_words(index)}" if index in self._late else ""

    def figures(self, index: int) -> dict[str, str]:
        late = None if self.latencies is None else self.latencies.by_sensor.get(index)
        return {} if late is None else {"stamps late by": str(late)}

    def _in_words(self, index: int) -> str:
        """By how much a sensor is late, and what became of that."""
        assert self.latencies is not None
        seconds, deviation = self.latencies.late[index]
        side = "late" if seconds > 0 else "early"
        too_old = seconds > self._reach
        used = f"more than the history of {self._reach:g} s: not used" if too_old else "taken off"
        return f"{1e3 * abs(seconds):.0f} ± {1e3 * deviation:.0f} ms {side}, {used}"

    def forget(self, stamp: int) -> None:
        """Stamps are as late as before."""

    def hear(self, event: Event) -> None:
        """What comes here has its time already."""

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        if self.latencies is not None:
            speed = self._adapter.forward_speed
            steered = self._adapter.steering_angle * speed / (self._base + self._understeer * speed**2)
            self.latencies.doubt.feel(stamp, h, (felt[2], steered), speed)

    @property
    def apart(self) -> Apart | None:
        return None if self.latencies is None else self.latencies.doubt.apart

    def settle(self, timeline: Timeline) -> None:
        latencies = self.latencies
        if latencies is None or not latencies.look(timeline.stamp):
            return
        before, self.changes = self._late, self.changes + 1
        self._late = {index: round(late.seconds * 1e9) for index, late in latencies.late.items()}
        changes = {i: self._late.get(i, 0) - before.get(i, 0) for i in {*before, *self._late}}
        ahead = timeline.rewind(timeline.stamp - VOTE.look_back)
        self._vote.reconsider(0, ahead)
        for event in ahead:
            event.stamp -= changes.get(event.sensor, 0)
        ahead[:] = sorted((event for event in ahead if event.stamp >= timeline.present), key=attrgetter("stamp"))
        if ahead:
            ahead[:0] = self._doubted(ahead[0].stamp, changes)

    def _doubted(self, stamp: int, changes: dict[int, int]) -> list[Event]:
        """Events at a time [ns] by which the filter doubts its motion, or, where fixes alone have another time, its
        place; and the biases of inertial sensors."""
        if all("position" in self._adapter.measures(index) for index, change in changes.items() if change):
            later = max(map(abs, changes.values())) * 1e-9
            apart, way = Apart(), abs(self._adapter.forward_speed) * later
        else:
            apart, way = (
                Apart(SETTINGS.doubted, SETTINGS.sideways * SETTINGS.doubted),
                SETTINGS.doubted * SETTINGS.windows[0],
            )
        events = [widening_event(self._shift, stamp, one) for one in self._adapter.doubted_motion(apart, way)]
        for index, axes in self._vote.axes.items():
            for axis in range(len(axes.words)) if index in changes else ():
                bias = self._adapter.bias(index, axis, 0.0)
                if bias is not None:
                    events.append(moving_event(self._shift, stamp, Move(bias[0], 0.0, bias[1])))
        return events
