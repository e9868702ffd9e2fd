"""Which way a car goes: where wheels have no sign, inertial sensors and steering determine it.

A car that goes backwards looks on the map like one that points the other way and goes forwards; wheels without a sign
agree to both. Inertial sensors and the steering do not: with the speed v that the filter has,

    a_x - a_x₀ = v̇,    a_y = v r,    r = v δ / l,

and the other direction has -v; a_x₀ is what was felt at rest, and the first equation holds as long as the slope has not
changed since. The direction changes at rest alone: what is known of it is forgotten there. The logarithm of the ratio
of the likelihoods of both is the sum of 2 a b / σ² over both sides a, b of the equations, of blocks that are
independent of each other (Wald 1945, a sequential test).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, isfinite, nan, sin

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.judge import Judge


@dataclass(frozen=True)
class DirectionSettings:
    """Decisions of this project."""

    block: float = 0.1  # [s] in which messages are averaged
    correlated: float = 0.5  # [s] for which errors of the equations stay the same
    acceleration: float = 0.8  # [m/s²] standard deviation of the first two: slopes, banks, side slip that changes
    yaw_rate: float = 0.1  # [rad/s] of the third
    slowest: float = 0.5  # [m/s] below which the car rests
    rest: float = 0.5  # [s] for which it does, until the direction may be another
    same_slope: float = 10.0  # [m] on the way from there
    forgotten: float = 20.0  # [s] time constant
    most: float = 30.0  # [-] of the sum, either way
    wrong: float = -15.0  # [-] evidence of more than 10⁶ to 1
    doubtful: float = -5.0  # [-]


DIRECTION = DirectionSettings()


class DirectionJudge(Judge):
    """The direction of motion of one car; `evidence` is the logarithm of the ratio of likelihoods, positive for the
    direction that the filter has.

    While `reversed` is true, wheel speeds are taken with the other sign. `report(stamp, sentence)` is called when the
    filter has been turned around.
    """

    def __init__(self, adapter: Adapter, report: Callable[[int, str], None]) -> None:
        super().__init__()
        self._adapter, self._report = adapter, report
        sensors = tuple(adapter.sensors.values())
        self._steering = place_of(sensors, "steering")
        self._wheels = place_of(sensors, "rolling speed")
        self.judged = place_of(sensors, "rates and forces") >= 0 and adapter.knows_car
        self._course = place_of(sensors, "course")
        self.hears = frozenset((self._steering, self._wheels, self._course))
        self.reversed = False
        numbers = car_numbers(adapter.vehicle)
        self._length = numbers["to_front"] + numbers["to_rear"]
        self.forget(0)

    @property
    def doubts(self) -> list[str]:
        return ["direction of motion is doubtful"] if self.evidence < DIRECTION.doubtful else []

    def doubt(self, index: int) -> str:
        return "taken with the other sign" if self.reversed and index == self._wheels else ""

    def reverse(self) -> None:
        """Take wheel speeds with the other sign from now on."""
        self.reversed = not self.reversed

    def forget(self, stamp: int) -> None:
        self.evidence = 0.0
        self._time, self._sums = 0.0, (0.0, 0.0, 0.0)  # [s] of a block, and integrals of yaw rate and accelerations
        self._angle = self._speed = self._felt = nan  # the last is along the car, at rest [m/s²]
        self._velocity = [nan, nan]  # over ground, east and north [m/s]
        self._rested = self._way = 0.0  # since it moved last [s], since it rested [m]

    def settle(self, timeline: Timeline) -> None:
        if self.evidence < DIRECTION.wrong:
            timeline.catch_up()
            if self._wheels >= 0:
                self.reverse()
            self._adapter.turn_around(self._is_turned())
            self._report(timeline.stamp, "turned around: the car goes the other way")
            self.forget(timeline.stamp)

    def _is_turned(self) -> bool:
        """True if the car points the other way as well; false if GNSS saw it going the other way, so that the heading
        was right."""
        yaw, speed = self._adapter.heading, self._adapter.forward_speed
        east, north = self._velocity
        return not speed * (east * cos(yaw) + north * sin(yaw)) < 0

    def hear(self, event: Event) -> None:
        if self.reversed and event.sensor == self._wheels:
            event.value = -event.value
        if event.sensor == self._steering:
            self._angle = event.value.item(0)
        elif event.sensor == self._course:
            self._velocity = event.value.tolist()

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        rate, along, across = self._sums
        _, _, r, a_x, a_y, _ = felt
        self._time += h
        self._sums = rate + h * r, along + h * a_x, across + h * a_y
        if self._time >= DIRECTION.block:
            time = self._time
            self._weigh(time, *(one / time for one in self._sums))
            self._time, self._sums = 0.0, (0.0, 0.0, 0.0)

    def _weigh(self, h: float, rate: float, along: float, across: float) -> None:
        """Add the evidence of a block of `h` [s]."""
        s = DIRECTION
        speed, before = self._adapter.forward_speed, self._speed
        self._speed = speed
        self.evidence *= exp(-h / s.forgotten)
        if abs(speed) < s.slowest:
            self._rested += h
            if self._rested >= s.rest:
                self._felt, self._way, self.evidence = along, 0.0, 0.0
            return
        self._rested = 0.0
        self._way += abs(speed) * h
        felt = along - self._felt if self._way < s.same_slope else nan
        sides = (
            (felt, (speed - before) / h, s.acceleration),
            (across, rate * speed, s.acceleration),
            (rate, speed * self._angle / self._length, s.yaw_rate),
        )
        for one, other, deviation in sides:
            product = 2.0 * one * other / deviation**2
            if isfinite(product):
                limit = 2.0 * s.correlated / h
                self.evidence += h / s.correlated * min(max(product, -limit), limit)
        self.evidence = min(max(self.evidence, -s.most), s.most)
