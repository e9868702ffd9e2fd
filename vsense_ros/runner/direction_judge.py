"""Which way a car goes: where wheels have no sign, inertial sensors and steering determine it.

A car that goes backwards looks on the map like one that points the other way and goes forwards; wheels without a sign
agree to both. Inertial sensors and the steering do not: with the speed v that the filter has,

    a_x - a_x₀ = v̇,    a_y = v r,    r = v δ / l,

and the other direction has -v; a_x₀ is what was felt at rest, and the first equation holds as long as the slope has not
changed since. The direction changes at rest alone: what is known of it is forgotten there. The logarithm of the ratio
of the likelihoods of both is the sum of 2 a b / σ² over both sides a, b of the equations, of blocks that are
independent of each other (Wald 1945, a sequential test). A bank, or a sensor that is turned, adds the same to a_y all
the time: with a constant of unknown size and the variance σ² of it, too, that of the second equation is
2 (Σ a b - Σ a Σ b / (k + n)) / (k σ²) after n blocks, of which k make one that is independent.

A filter that has the right direction, because it has integrated what was felt from rest on, is contradicted by such
wheels: they roll as fast the other way. Their sign is then changed, and not the direction. What points the other way
once the direction changes is the heading that GNSS has given since the car rested; without GNSS the heading is as it
was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, isfinite, nan, sin

import numpy as np

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.judge import Judge, Rolled, into_axes_of_car


@dataclass(frozen=True)
class DirectionSettings:
    """Decisions of this project."""

    block: float = 0.1  # [s] in which messages are averaged
    correlated: float = 0.5  # [s] for which errors of the equations stay the same
    acceleration: float = 0.8  # [m/s²] standard deviation of the first two: slopes, banks, side slip that changes
    yaw_rate: float = 0.1  # [rad/s] of the third
    slowest: float = 0.5  # [m/s] below which the car rests
    rest: float = 0.5  # [s] for which it does, until the direction may be another
    still: float = 0.3  # [m/s²] of the filter, below which what is felt is felt at rest
    same_slope: float = 10.0  # [m] on the way from there
    forgotten: float = 20.0  # [s] time constant
    largest: float = 2.0  # [-] of a block and an equation, either way
    most: float = 30.0  # [-] of the sum, either way
    confirmed: float = 5.0  # [-] from which on an inertial axis that is left out is not because of the direction
    opposed: float = 0.4  # [s] for which wheels roll as fast as the filter moves, the other way
    fast: float = 1.0  # [m/s] from which on that is looked at
    alike: float = 0.15  # [-] of the speed, by which the two may differ
    wrong: float = -15.0  # [-] evidence of more than 10⁶ to 1
    doubtful: float = -5.0  # [-]


DIRECTION = DirectionSettings()


class DirectionJudge(Judge):
    """The direction of motion of one car; `evidence` is the logarithm of the ratio of likelihoods, positive for the
    direction that the filter has.

    While `reversed` is true, wheel speeds are taken with the other sign. `report(stamp, sentence)` is called when the
    filter has been turned around. `steering` are the places of steering sensors that are not believed, and
    `left_out(sensor)` those of axes of an inertial sensor that are not.
    """

    def __init__(
        self,
        adapter: Adapter,
        report: Callable[[int, str], None],
        steering: set[int],
        left_out: Callable[[int], list[int]],
    ) -> None:
        super().__init__()
        self._adapter, self._report, self._no_steering, self._left_out = adapter, report, steering, left_out
        sensors = tuple(adapter.sensors.values())
        self._steering = place_of(sensors, "steering")
        self._wheels = place_of(sensors, "rolling speed")
        self._inertial = place_of(sensors, "rates and forces")
        self._into_car = into_axes_of_car(sensors, self._inertial)
        self._out: dict[int, bool] = {}  # axes that are left out, and whether the direction was confirmed before
        self.judged = self._inertial >= 0 and adapter.knows_car
        self._course = place_of(sensors, "course")
        self._on_map = frozenset(i for i, sensor in enumerate(sensors) if sensor.on_map)
        self.hears = frozenset((self._steering, self._wheels)) | self._on_map
        self._sensors = sensors
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

    def _begin_anew(self) -> None:
        """Know nothing of the direction."""
        self.evidence = self._by_others = 0.0  # the second without the equation of the lateral acceleration
        self._lateral = np.zeros(4)  # Σ a b, Σ a, Σ b and n of that

    def forget(self, stamp: int) -> None:
        self._time, self._sums = 0.0, (0.0, 0.0, 0.0)  # [s] of a block, and integrals of yaw rate and accelerations
        self._begin_anew()
        self._angle = self._speed = self._felt = nan  # the last is along the car, at rest [m/s²]
        self._velocity = [nan, nan]  # over ground, east and north [m/s]
        self._located = True  # by GNSS, since it rested
        self._rolled, self._opposed = nan, 0.0  # speed of the wheels [m/s], and for how long it has been opposed [s]
        self._rested = self._way = 0.0  # since it moved last [s], since it rested [m]

    def settle(self, timeline: Timeline) -> None:
        if self._opposed >= DIRECTION.opposed:
            self.reverse()
            self._opposed = 0.0
        elif self.evidence < DIRECTION.wrong:
            timeline.catch_up()
            if self._wheels >= 0:
                self.reverse()
            self._adapter.turn_around(self._is_turned())
            self._report(timeline.stamp, "turned around: the car goes the other way")
            self.forget(timeline.stamp)

    def _is_turned(self) -> bool:
        """True if the car points the other way as well; false if GNSS saw it going the other way, so that the heading
        was right, or has not seen it at all since it rested."""
        if not self._located:
            return False
        yaw, speed = self._adapter.heading, self._adapter.forward_speed
        east, north = self._velocity
        return not speed * (east * cos(yaw) + north * sin(yaw)) < 0

    def hear(self, event: Event) -> None:
        if self.reversed and event.sensor == self._wheels:
            event.value = -event.value
        if event.sensor == self._steering:
            self._angle = event.value.item(0)
        if event.sensor in self._on_map:
            self._located = True
        if event.sensor == self._course:
            self._velocity = event.value.tolist()

    def roll(self, rolled: Rolled) -> None:
        speed = self._sensors[self._wheels].first_speed(rolled.newest.value, self._adapter.vehicle.physics)
        self._rolled = nan if speed is None else speed

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        rate, along, across = self._sums
        _, _, r, a_x, a_y, _ = self._believable(felt)
        self._time += h
        self._sums = rate + h * r, along + h * a_x, across + h * a_y
        if self._time >= DIRECTION.block:
            time = self._time
            self._weigh(time, *(one / time for one in self._sums))
            self._time, self._sums = 0.0, (0.0, 0.0, 0.0)

    def _believable(self, felt: list[float]) -> list[float]:
        """What is felt (6), NaN for axes that were left out after they had confirmed the direction: that changes at
        rest alone, so that it is they which are wrong."""
        out = self._left_out(self._inertial)
        if not out:
            self._out.clear()
            return felt
        self._out = {axis: self._out.get(axis, self.evidence > DIRECTION.confirmed) for axis in out}
        absent = np.zeros(6)
        absent[[axis for axis, confirmed in self._out.items() if confirmed]] = nan
        return (np.array(felt) + self._into_car(absent)).tolist()

    def _weigh(self, h: float, rate: float, along: float, across: float) -> None:
        """Add the evidence of a block of `h` [s]."""
        s = DIRECTION
        speed, before = self._adapter.forward_speed, self._speed
        self._speed = speed
        self._by_others *= exp(-h / s.forgotten)
        self._lateral *= exp(-h / s.forgotten)
        if abs(speed) < s.slowest:
            self._rested += h
            if self._rested >= s.rest and abs(speed - before) < s.still * h:
                self._felt, self._way, self._located = along, 0.0, False
                self._begin_anew()
            return
        self._rested = 0.0
        alike = abs(self._rolled + speed) < s.alike * abs(speed)
        self._opposed = self._opposed + h if alike and abs(speed) > s.fast else 0.0
        self._way += abs(speed) * h
        felt = along - self._felt if self._way < s.same_slope else nan
        blocks = s.correlated / h
        angle = nan if self._no_steering else self._angle
        sides = (
            (felt, (speed - before) / h, s.acceleration),
            (rate, speed * angle / self._length, s.yaw_rate),
        )
        for one, other, deviation in sides:
            product = 2.0 * one * other / deviation**2
            if isfinite(product):
                self._by_others += min(max(product / blocks, -s.largest), s.largest)
        self._by_others = min(max(self._by_others, -s.most), s.most)
        if isfinite(across * rate):
            self._lateral += across * rate * speed, across, rate * speed, 1.0
        products, felt_across, turned, count = self._lateral.tolist()
        lateral = 2.0 * (products - felt_across * turned / (blocks + count)) / (blocks * s.acceleration**2)
        self.evidence = min(max(self._by_others + lateral, -s.most), s.most)
