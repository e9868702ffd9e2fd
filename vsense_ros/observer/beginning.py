"""What it takes to start: messages until they show how the car moves; a start at a wrong speed is worse than none.

Until the filter knows the speed well, any sensor that measures another one draws it there, and those that are right are
refused from then on. So in the first seconds sensors of the speed are held against each other: where three or more are
there, one that differs from the median of all is not believed. Where two are far apart, the way between positions says
which of them is right.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, isfinite
from statistics import median

import numpy as np

from vsense_ros.estimation.intake import LONGEST_GAP, Intake
from vsense_ros.estimation.timeline import Event
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class BeginningSettings:
    """Which first speeds are believed: decisions of this project."""

    disagreement: float = 5.0  # [m/s] between first speeds, beyond which one of them is wrong
    apart: float = 0.05  # of the median of all speeds, and
    apart_at_least: float = 0.5  # [m/s] by which one has to differ from it not to be believed
    fewest: int = 3  # speeds of which one can be seen to be wrong
    way: float = 0.9  # [s] at least from one position to another whose way tells a speed, and
    longest_way: float = 2.0  # [s] at most
    near: float = 0.25  # of how far two speeds are apart, within which the speed of the way is one of them


SETTINGS = BeginningSettings()

UNSURE = 2_000_000_000  # [ns] from the start on in which speeds are held against each other


@dataclass(frozen=True)
class Start:
    """The first time [ns], the speed there [m/s], the newest measurement of each kind of sensor, and by how much their
    speeds contradict each other [m/s]."""

    stamp: int
    speed: float
    events: dict[str, Event]
    apart: float = 0.0


class Beginning:
    """Collects the first messages; `fastest` is the largest speed of a car [m/s]."""

    def __init__(self, vehicle: Vehicle, intake: Intake[SensorBase], fastest: float) -> None:
        self._vehicle, self._intake, self._fastest = vehicle, intake, fastest
        self._kinds = [sensor.kind for sensor in intake.sensors]
        self._first: dict[int, Event] = {}  # newest measurement of each sensor
        self._gathered: dict[int, int] = {}  # when these arrived [ns]
        self._newest: dict[int, tuple[int, float]] = {}  # stamp [ns] and speed [m/s] that each sensor measured last
        self._places: deque[tuple[int, float, float]] = deque()  # stamps [ns] of positions, east and north [m]
        self._first_stamp = 0

    @property
    def measures_speed(self) -> bool:
        """True if a sensor has sent that could measure the speed."""
        return any(self._intake.sensors[i].measures_speed for i in self._first)

    def clear(self) -> None:
        """Forget all messages and begin anew."""
        self._first.clear()
        self._newest.clear()
        self._places.clear()

    def add(self, event: Event) -> Start | None:
        """Take in a measurement; what to start with, once that is known."""
        stamp, index = event.stamp, event.sensor
        for speed in self._speeds([event]):
            if not abs(speed) < self._fastest:
                self._intake.refuse(index, f"speed {speed:.3g} m/s before the start, limit {self._fastest:g}")
                return None
        if not self._keep(event) or self.doubts(event):
            return None
        kinds = {self._kinds[i]: e for i, e in self._first.items() if self._differs(i) is None}
        speeds = self._speeds(kinds.values())
        waited = (stamp - self._first_stamp) * 1e-9
        missing = (sensor for sensor in self._intake.sensors if sensor.kind not in kinds)
        if not speeds or any(sensor.awaited and waited < sensor.awaited for sensor in missing):
            return None
        apart = float(np.ptp(np.abs(speeds)))
        if apart > SETTINGS.disagreement and waited < LONGEST_GAP:
            return None
        agree = apart <= max(SETTINGS.apart_at_least, SETTINGS.apart * max(map(abs, speeds)))
        return Start(stamp, speeds[0], kinds, 0.0 if agree else apart)

    def doubts(self, event: Event) -> bool:
        """True if a measurement gives another speed than most sensors do; it is then refused."""
        sensor = self._intake.sensors[event.sensor]
        if "position" in sensor.measures:
            self._keep_place(event)
        speed = sensor.first_speed(event.value, self._vehicle.physics)
        if speed is None or not isfinite(speed):
            return False
        self._newest[event.sensor] = event.stamp, abs(speed)
        middle = self._differs(event.sensor)
        if middle is None:
            return False
        self._intake.refuse(event.sensor, f"speed {speed:.3g} m/s, where most sensors say {middle:.3g} m/s")
        return True

    def _differs(self, index: int) -> float | None:
        """The median [m/s] of the speeds that sensors measure, where this one is apart from it and most are not; None
        otherwise, and where fewer than three measure a speed, positions among them."""
        latest = self._newest.get(index)
        if latest is None:
            return None
        speeds = [speed for stamp, speed in self._newest.values() if abs(stamp - latest[0]) < LONGEST_GAP * 1e9]
        if len(speeds) == SETTINGS.fewest - 1 and (travelled := self._of_way(*speeds)) is not None:
            speeds.append(travelled)
        if len(speeds) < SETTINGS.fewest:
            return None
        middle = median(speeds)
        tolerance = max(SETTINGS.apart_at_least, SETTINGS.apart * middle)
        agree = sum(abs(speed - middle) <= tolerance for speed in speeds)
        return middle if abs(latest[1] - middle) > tolerance and 2 * agree > len(speeds) else None

    def _keep_place(self, event: Event) -> None:
        """Keep a position on the map, with those of the last seconds."""
        east, north = event.value.tolist()[:2]
        places = self._places
        if not isfinite(east + north) or (places and event.stamp <= places[-1][0]):
            return
        places.append((event.stamp, east, north))
        while event.stamp - places[0][0] > SETTINGS.longest_way * 1e9:
            places.popleft()

    def _of_way(self, one: float, other: float) -> float | None:
        """That of two speeds which the car had on its way between the first and the newest position [m/s]; None where
        the two are not far apart, or the way does not tell."""
        apart = abs(one - other)
        if apart <= SETTINGS.disagreement or not self._places:
            return None
        (begin, *first), (end, *last) = self._places[0], self._places[-1]
        seconds = (end - begin) * 1e-9
        if seconds < SETTINGS.way:
            return None
        travelled = hypot(last[0] - first[0], last[1] - first[1]) / seconds
        nearest = min(one, other, key=lambda speed: abs(speed - travelled))
        return nearest if abs(nearest - travelled) < SETTINGS.near * apart else None

    def _keep(self, event: Event) -> bool:
        """What is far apart in time, one of them by a wrong clock, does not describe the same start. A clock that
        differs from several others, of which there was news lately, is wrong; else the newest message counts."""
        stamp, gap, now = event.stamp, LONGEST_GAP * 1e9, self._intake.newest_arrival
        simultaneous = {i for i, e in self._first.items() if abs(e.stamp - stamp) < gap}
        other_sensors = [i for i in self._first if i != event.sensor and now - self._gathered[i] < gap]
        if len(other_sensors) > 1 and not simultaneous.intersection(other_sensors):
            return False
        self._first = {i: e for i, e in self._first.items() if i in simultaneous}
        if not self._first:
            self._first_stamp = stamp
        self._first[event.sensor] = event
        self._gathered[event.sensor] = now
        return True

    def _speeds(self, events: Iterable[Event]) -> list[float]:
        """What each sensor that measures the car's speed says [m/s], in the order of their kinds."""
        sensors = self._intake.sensors
        in_order = sorted(events, key=lambda event: sensors[event.sensor].place)
        speeds = (sensors[event.sensor].first_speed(event.value, self._vehicle.physics) for event in in_order)
        return [speed for speed in speeds if speed is not None]
