"""A steering angle that is wrong: left out once the direct witnesses say so, estimated meanwhile, and believed again.

The steering angle drives the model; it has no innovation of its own, and cannot just be absent. One that is left out is
held where it was before it was wrong, and its error, a state of the filter in any case, is estimated from all other
sensors as a random walk that is as fast as drivers steer. Where a sensor is silent, its last angle is held in this way,
too.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable, Sequence
from math import degrees, nan
from operator import attrgetter

import numpy as np

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.runner.adapter import Adapter, Apart, Move, Placing, Widening
from vsense_ros.runner.judge import Judge, Rolled, widening_event
from vsense_ros.runner.vote import Vote
from vsense_ros.runner.vote_settings import STEERING, VOTE
from vsense_ros.runner.yaw_witnesses import WITNESSES, YawWitnesses

_LEAST_GAIN = 1e-3  # [m/s²/rad] for a division by what the steering does to a car at rest


class SteeringJudge(Judge):
    """The steering sensor of one car, as far as the runner may leave it out; `out` has its place while it is."""

    why = "contradicts what gyro, wheels, accelerometer and course agree on"

    def __init__(self, adapter: Adapter, vote: Vote, shift: int, report: Callable[[int, str], None]) -> None:
        super().__init__()
        self._adapter, self._vote, self._shift, self._report = adapter, vote, shift, report
        self._witnesses = YawWitnesses(adapter.vehicle, adapter.sensors)
        self.hears, self.place = self._witnesses.hears, self._witnesses.steering
        self._yaw_rate = axis_of_yaw_rate(tuple(adapter.sensors.values()))
        self.judged = self._witnesses.possible and adapter.steering_error is not None
        self._recent: deque[tuple[int, float]] = deque(maxlen=STEERING.kept)  # stamps [ns] and angles [rad]
        self._wait = WITNESSES.agreed
        self._held = self._offset = 0.0  # angle and offset before it was left out [rad]
        self._started = 0  # when the filter began [ns]
        self._widened = 0  # when its error was last given time to change [ns]
        self._given = nan, 0  # the newest angle that was believed [rad], and its stamp [ns]
        self._last = 0  # stamp of the newest angle [ns]
        self._silent = False  # while no angle comes
        self._in_order = True  # while angles come in the order of their stamps

    def forget(self, stamp: int) -> None:
        self._witnesses.forget()
        self._widened = self._started = stamp

    @property
    def suspect(self) -> bool:  # type: ignore[override]
        return not self.out and self._witnesses.suspects_steering

    @property
    def _undecided(self) -> bool:
        """True while gyro and steering contradict each other, and it is not decided which of them is wrong."""
        open_ = self._witnesses.contradiction > WITNESSES.suspicious
        return open_ and not self.out and not any(self._vote.out)

    @property
    def confirms(self) -> dict[tuple[int, int], int]:
        stamp = self._witnesses.gyro_confirmed
        return dict.fromkeys(self._yaw_rate, stamp) if stamp else {}

    @property
    def doubts(self) -> list[str]:
        return ["gyro and steering contradict each other"] if self._undecided else []

    @property
    def apart(self) -> Apart | None:
        if not self._undecided:
            return None
        turned = self._witnesses.contradiction * abs(self._adapter.forward_speed)
        return Apart(across=turned, yaw_rate=self._witnesses.apart_by)

    def hear(self, event: Event) -> None:
        self._witnesses.hear(event)
        if event.sensor == self.place:
            angle = event.value.item(0)
            self._recent.append((event.stamp, angle))
            if self.out:
                event.value = np.array([self._held])
            elif self._is_jump(angle, event.stamp):
                event.value = np.array([self._given[0]])
            else:
                self._given = angle, event.stamp

    def roll(self, rolled: Rolled) -> None:
        self._witnesses.hear(rolled.newest)

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        adapter = self._adapter
        offset = self._offset if self.out else adapter.steering_offset()  # the one from before it was left out
        self._witnesses.feel(stamp, h, felt, adapter.forward_speed, offset)

    def _is_jump(self, angle: float, stamp: int) -> bool:
        """True if no driver steers so far from the last angle, until the witnesses have had time to decide."""
        before, at = self._given
        period, self._last = (stamp - self._last) * 1e-9, stamp
        jump = abs(angle - before)
        if not jump > WITNESSES.jump + WITNESSES.fastest * period or not 0 < stamp - at < STEERING.undecided:
            return False
        self._report(self.place, f"jumped by {degrees(jump):.1f}° at the road wheels")
        return True

    def settle(self, timeline: Timeline) -> None:
        now = timeline.stamp
        if not self.out:
            if self._witnesses.wrong:
                self._leave_out(timeline, now)
            else:
                self._bridge_silence(timeline, now)
        elif self._witnesses.agreed >= self._wait:
            self._believe(timeline, now)
        elif now - self._widened >= STEERING.period:
            timeline.add(self._widening(now, now - self._widened))
            self._widened = now

    def _bridge_silence(self, timeline: Timeline, now: int) -> None:
        """Let the error of the held angle change while none comes, and be what it was once one does."""
        adapter, intake = self._adapter, self._adapter.intake
        health = intake.health[self.place]
        in_order = intake.is_in_order(self.place)
        heard = self._last or self._started
        unheard = now - heard if in_order else intake.newest_arrival - health.last_received
        never = not health.last_stamp
        silent = never or unheard > max(STEERING.unheard, 1e9 * STEERING.periods * health.period)
        if silent and not self._silent:
            timeline.catch_up()
            self._offset = adapter.steering_offset()
            self._widened = heard - STEERING.unknown if never else heard
        if silent and now - self._widened >= STEERING.period:
            self._widen_until(timeline, now)
        self._silent |= silent

    def _widen_until(self, timeline: Timeline, now: int) -> None:
        """Give the steering's error time to change until now [ns], at the times when it may have, as far as these can
        happen again."""
        density, period = self._density_at(abs(self._adapter.forward_speed)), STEERING.period
        for at in range(self._widened + period, now + 1, period):
            timeline.add(self._widening(max(at, timeline.oldest), period, density))
            self._widened = at

    def before(self, timeline: Timeline, event: Event) -> None:
        if event.sensor != self.place and event.stamp - timeline.stamp <= STEERING.unheard:
            return
        in_order = self._adapter.intake.is_in_order(self.place)
        if self._in_order and not in_order:
            self._undo_silence(timeline)
        self._in_order = in_order
        if self._last and not self.out and event.stamp - timeline.stamp > STEERING.unheard:
            timeline.catch_up()
            if not self._silent:
                self._silent, self._offset = True, self._adapter.steering_offset()
            density = self._density_at(abs(self._adapter.forward_speed))
            for at in range(timeline.stamp + STEERING.period, event.stamp, STEERING.period):
                timeline.add(self._widening(at, STEERING.period, density))
            self._widened = timeline.stamp
        if self._silent and event.sensor == self.place and event.stamp > self._last:
            self._silent = False
            self._restore(timeline, event.stamp)

    def _restore(self, timeline: Timeline, stamp: int) -> None:
        """Let the steering's error be, from a time [ns] on, what it was before no angle came."""
        error = self._adapter.steering_error
        assert error is not None
        ahead = timeline.rewind(stamp)
        ahead[:] = [one for one in ahead if not self._is_widening(one, error)]
        back = Placing(error, self._offset, self._adapter.usual_deviation(error))
        timeline.add(Event(self._shift, stamp, np.array(back), np.zeros(4), counted=True))

    def _undo_silence(self, timeline: Timeline) -> None:
        """Forget a silence that was none, where messages turn out to come in another order than they were sent."""
        ahead = timeline.rewind(timeline.stamp - VOTE.look_back)
        ahead[:] = [one for one in ahead if one.sensor != self._shift]
        self._silent = False

    def _is_widening(self, event: Event, error: int) -> bool:
        return event.sensor == self._shift and len(event.value) == len(Widening._fields) and event.value[0] == error

    def _leave_out(self, timeline: Timeline, now: int) -> None:
        error = self._adapter.steering_error
        assert error is not None
        begin = self._witnesses.since - STEERING.before
        doubtful = begin - STEERING.doubtful
        since = min([begin, *(out.since for _, _, out in self._vote.doubtful(doubtful))])
        self.out.add(self.place)
        if not self._silent:
            self._offset = self._adapter.steering_offset()
        self._silent = False
        known = [angle for stamp, angle in self._recent if stamp <= begin and angle == angle]
        jumped = self._given[1] != self._last
        self._held = self._given[0] if jumped or not known else known[-1]
        ahead = timeline.rewind(max(since, now - VOTE.look_back))
        self._vote.reconsider(doubtful, ahead)
        for event in ahead:
            if event.sensor == self.place and event.stamp > begin:
                event.value = np.array([self._held])
        if ahead:
            for stamp in range(max(ahead[0].stamp, begin), now, STEERING.period):
                insort(ahead, self._widening(stamp, STEERING.period), key=attrgetter("stamp"))
        self._widened = now

    def _believe(self, timeline: Timeline, now: int) -> None:
        self.out.clear()
        self._wait = min(2 * self._wait, WITNESSES.longest)
        known = [angle for _, angle in self._recent if angle == angle]
        timeline.add(Event(self.place, now, np.array(known[-1:] or [self._held]), np.zeros(1), counted=True))
        error = self._adapter.steering_error
        assert error is not None
        back = Move(error, self._offset - self._adapter.steering_offset(), self._adapter.usual_deviation(error))
        timeline.add(Event(self._shift, now, np.array(back), np.zeros(3), counted=True))

    def _density_at(self, speed: float) -> float:
        """Density of the steering's error [rad²/s] at a speed [m/s], where no tyre turns the car faster than this."""
        by_angle = self._witnesses.lateral_acceleration(speed)
        return min(STEERING.density, STEERING.lateral_density / max(by_angle, _LEAST_GAIN) ** 2)

    def _widening(self, stamp: int, time: int, density: float = STEERING.density) -> Event:
        """The event after which the steering's error may have changed for a time [ns]."""
        error = self._adapter.steering_error
        assert error is not None
        change = Widening(error, density * time * 1e-9)
        return widening_event(self._shift, stamp, change)


def axis_of_yaw_rate(sensors: Sequence[SensorBase]) -> frozenset[tuple[int, int]]:
    """The place of the first inertial sensor and its axis that is nearest to the car's vertical one; empty for none."""
    place = place_of(sensors, "rates and forces")
    if place < 0:
        return frozenset()
    upward = np.abs(sensors[place].in_axes_of_car(np.eye(6))[:, 2])
    return frozenset({(place, int(upward.argmax()))})
