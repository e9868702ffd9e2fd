"""Leaps: changes of a measured speed from one message to the next that no car can make.

Tyres push a car by little more than its weight. Four wheels that fall from 20 m/s to zero between two messages 10 ms
apart, which takes 2,000 m/s², say something of the sensor, or of wheels that lock, and nothing of the car. A filter
that such a sensor contradicts is not wrong, however long that goes on and whoever else is silent.

Wheels lock or spin one by one or by axle, so a leap is that of the wheel which changes least. It is over once the
sensor has leapt back, or agrees with the filter again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.judge import Judge, Rolled


@dataclass(frozen=True)
class LeapSettings:
    """What no car does, with room for noise and slip: decisions of this project."""

    acceleration: float = 60.0  # [m/s²], as the fastest racing cars brake
    noise: float = 3.0  # [m/s] of two speeds, and of what all wheels may slip between them
    returned: float = 0.5  # share of the greatest leap that may remain once the sensor is back
    believed: int = 3  # readings that the filter has used since


SETTINGS = LeapSettings()


@dataclass
class _Leap:
    """What a sensor measured last, and by how much it has leapt."""

    stamp: int = 0  # [ns]
    speeds: list[float] = field(default_factory=list)  # [m/s]
    sum: float = 0.0  # [m/s] of the leaps since the sensor was believed
    greatest: float = 0.0  # [m/s] that it has been, 0 without a leap
    used: int = 0  # readings that the filter had used by then

    def end(self) -> None:
        """The sensor is back."""
        self.sum = self.greatest = 0.0


class LeapJudge(Judge):
    """The leaps of all sensors of one car that measure its speed in its own axes, as wheels do."""

    def __init__(self, adapter: Adapter, intake: Intake[SensorBase]) -> None:
        super().__init__()
        self._intake = intake
        sensors = tuple(adapter.sensors.values())
        self._names = tuple(adapter.sensors)
        self._speeds = [i for i, one in enumerate(sensors) if one.measures_speed or "position" in one.measures]
        own = frozenset(i for i in self._speeds if not sensors[i].on_map)
        self.judged = bool(own) and place_of(sensors, "rates and forces") >= 0
        self._wheels = place_of(sensors, "rolling speed")
        self.hears = own - {self._wheels}
        rolling = (i for i in own if "rolling speed" in sensors[i].measures)
        physics, spin = adapter.vehicle.physics, np.ones(1)
        self._radii = {i: sensors[i].first_speed(spin, physics) or 0.0 for i in rolling}  # [m]
        self._leaps = {i: _Leap() for i in own}

    def forget(self, stamp: int) -> None:
        self._leaps = {i: _Leap() for i in self._leaps}

    def is_open(self, index: int) -> bool:
        """True if a sensor has leapt, and is not back."""
        return index in self._leaps and self._leaps[index].greatest > 0

    @property
    def blind(self) -> bool:
        """True if the car's speed is measured by sensors of which none is believed."""
        sending = [i for i in self._speeds if self._intake.sends(i)]
        return bool(sending) and all(self.is_open(i) or self._intake.health[i].contradicts for i in sending)

    @property
    def doubts(self) -> list[str]:
        return [
            f"{self._names[i]} leapt by {leap.greatest:.3g} m/s, as no car does"
            for i, leap in self._leaps.items()
            if leap.greatest and self._intake.health[i].refused_in_a_row
        ]

    def hear(self, event: Event) -> None:
        self._take(event.sensor, event.stamp, [event.value.item(0) * self._radii.get(event.sensor, 1.0)])

    def roll(self, rolled: Rolled) -> None:
        radius, leap = self._radii[self._wheels], self._leaps[self._wheels]
        least, most = np.minimum.reduce(rolled.spins), np.maximum.reduce(rolled.spins)
        if leap.speeds and not leap.greatest:
            ranges = zip(leap.speeds, (radius * least).tolist(), (radius * most).tolist(), strict=True)
            if any(max(high - low, high - was, was - low) < SETTINGS.noise for was, low, high in ranges):
                # One wheel at least was always there, and did not leap, whatever the order.
                leap.stamp, leap.speeds = rolled.stamps[-1], (radius * rolled.spins[-1]).tolist()
                return
        for stamp, row in zip(rolled.stamps, (radius * rolled.spins).tolist(), strict=True):
            self._take(self._wheels, stamp, row)

    def _take(self, index: int, stamp: int, speeds: list[float]) -> None:
        """Take in speeds [m/s] that a sensor has measured at a time [ns]: of each wheel, or of the car."""
        leap, health = self._leaps[index], self._intake.health[index]
        if leap.greatest and not health.refused_in_a_row and health.used >= leap.used + SETTINGS.believed:
            leap.end()
        before, passed = leap.speeds, (stamp - leap.stamp) * 1e-9
        leap.stamp, leap.speeds = stamp, speeds
        if not before or passed <= 0:
            return
        changes = (new - old for new, old in zip(speeds, before, strict=True))
        least = min((change for change in changes if change == change), key=abs, default=0.0)
        if abs(least) <= SETTINGS.noise + SETTINGS.acceleration * passed:
            return
        if not leap.greatest:
            leap.used = health.used
        leap.sum += least
        leap.greatest = max(leap.greatest, abs(leap.sum))
        if abs(leap.sum) <= SETTINGS.returned * leap.greatest:
            leap.end()

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        """Nothing is to be known of inertial sensors."""

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
