"""A single wheel that turns as the car does not go: left out as long as it does.

Each wheel that rolls gives the speed of the car, v = (R ω - r a sin δ) / cos δ + r y, with its radius R and its place
(a, y), its steering angle δ and the yaw rate r. Three that agree show the fourth to be wrong, or to slide; neither says
how the car goes. All four slide where brakes or engine act strongly, and none is judged there. A fault of all four is a
matter of other judges.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from operator import mul

import numpy as np

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.judge import Judge, Rolled


@dataclass(frozen=True)
class WheelJudgeSettings:
    """When a wheel is wrong: decisions of this project. Wheels of the recordings at hand are never so far apart."""

    speed: float = 0.3  # [m/s] by which it differs from the others, and
    share: float = 0.025  # [-] of their speed
    together: float = 0.5  # [-] of this, by which the three others differ at most
    sliding: float = 3.0  # [m/s²] longitudinal acceleration beyond which wheels may slide
    wrong: int = 200_000_000  # [ns] for which it does
    agreed: int = 1_000_000_000  # [ns] for which it has to agree, before it is believed again


WHEEL = WheelJudgeSettings()


class WheelJudge(Judge):
    """The single wheels of one car whose speeds are measured."""

    def __init__(self, adapter: Adapter) -> None:
        super().__init__()
        self._adapter = adapter
        sensors = tuple(adapter.sensors.values())
        self._wheels = place_of(sensors, "rolling speed")
        self.hears = frozenset((self._wheels,))
        self.judged = adapter.knows_car and self._wheels >= 0 and place_of(sensors, "rates and forces") >= 0
        numbers = car_numbers(adapter.vehicle) if self.judged else {}
        self._radii = [numbers.get(f"radius_{wheel}", 0.0) for wheel in WHEELS]
        front, rear = numbers.get("front_half_track", 0.0), numbers.get("rear_half_track", 0.0)
        self._across, self._ahead = (front, -front, rear, -rear), numbers.get("to_front", 0.0)
        self.alone: dict[int, float] = {}  # wheels that are wrong, and by which share of the speed [-]
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._far_from: dict[int, int] = {}  # since when wheels have been far from the others [ns]
        self._agreed_from: dict[int, int] = {}  # since when those that are out have agreed [ns]
        self._rate = self._force = 0.0  # yaw rate [rad/s], longitudinal acceleration [m/s²]
        self._undone: set[int] = set()  # of these, those whose readings the filter still has to forget

    def doubt(self, index: int) -> str:
        if index != self._wheels or not self.alone:
            return ""
        return ", ".join(f"without {WHEELS[i]}, {by:+.0%} beside the other wheels" for i, by in self.alone.items())

    @property
    def doubts(self) -> list[str]:
        return [f"without wheel {WHEELS[i]}" for i in self.alone]

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        self._rate, self._force = felt[2], felt[3]

    def _speeds(self, spins: list[float]) -> list[float]:
        """The speed of the car by each wheel [m/s], NaN for what is not known."""
        angle, rate = self._adapter.steering_angle, self._rate
        turned, sideways = cos(angle), rate * self._ahead * sin(angle)
        fl, fr, rl, rr = map(mul, spins, self._radii)
        to_left, to_right, behind_left, behind_right = self._across
        return [
            (fl - sideways) / turned + rate * to_left,
            (fr - sideways) / turned + rate * to_right,
            rl + rate * behind_left,
            rr + rate * behind_right,
        ]

    def hear(self, event: Event) -> None:
        if self.alone:
            event.without(list(self.alone))

    def roll(self, rolled: Rolled) -> None:
        speeds = self._speeds((np.add.reduce(rolled.spins) / len(rolled.spins)).tolist())
        if max(speeds) - min(speeds) < WHEEL.speed and not (self.alone or self._far_from):
            return  # as nearly always
        begin, end = rolled.stamps[0], rolled.stamps[-1]
        order = sorted(range(4), key=speeds.__getitem__) if sum(speeds) == sum(speeds) else []
        far = self._far(speeds, order) if order and abs(self._force) < WHEEL.sliding else None
        if far is None or far not in self.alone:
            self._mark(far, begin, end, speeds, order)
        for wheel in list(self.alone):
            since = self._agreed_from.setdefault(wheel, end) if order and far != wheel else end
            self._agreed_from[wheel] = since
            if end - since >= WHEEL.agreed:
                del self.alone[wheel], self._agreed_from[wheel]

    def _far(self, speeds: list[float], order: list[int]) -> int | None:
        """The wheel that is far from the three others, which agree; None for none."""
        least, low, high, largest = (speeds[i] for i in order)
        margin = WHEEL.speed + WHEEL.share * max(abs(low), abs(high))
        if largest - high > margin and high - least < WHEEL.together * margin:
            return order[3]
        if low - least > margin and largest - low < WHEEL.together * margin:
            return order[0]
        return None

    def _mark(self, far: int | None, begin: int, end: int, speeds: list[float], order: list[int]) -> None:
        """Note which wheel is far from the others from one time to another [ns], and leave it out if it has been so
        for long."""
        self._far_from = {} if far is None else {far: self._far_from.get(far, begin)}
        if far is not None and end - self._far_from[far] >= WHEEL.wrong:
            middle = 0.5 * (speeds[order[1]] + speeds[order[2]])
            self.alone[far] = (speeds[far] - middle) / max(abs(middle), 1.0)
            self._undone.add(far)

    def settle(self, timeline: Timeline) -> None:
        if self._undone:
            wheels, self._undone = list(self._undone), set()
            since = min(self._far_from.values(), default=timeline.stamp)
            for event in timeline.rewind(since):
                if event.sensor == self._wheels:
                    event.without(wheels)
