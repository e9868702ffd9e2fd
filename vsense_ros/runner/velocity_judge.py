"""Is the estimate as close to measured velocities as noise lets it be? Else it may be as wrong as they are apart.

A filter that one sensor has drawn away contradicts the next, whose velocities it then refuses: it goes on, sure of
itself, while a sensor that may be right says otherwise. Until somebody is found to be wrong, the published covariance
is as wide as what they are apart, and the estimate is no good one. Differences are means over the newest velocities, so
that noise is not taken for a contradiction, in the axes of the car, and no larger than what a car can have done since
both agreed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import cos, exp, hypot, isfinite, sin, sqrt

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.judge import Judge
from vsense_ros.runner.lag_doubt import DOUBT
from vsense_ros.runner.velocity_witnesses import SETTINGS


@dataclass(frozen=True)
class VelocityJudgeSettings:
    """When a difference is a contradiction: decisions of this project. On drives without a fault means of differences
    stay below half of these margins."""

    averaged: int = 5  # [-] newest velocities of which the mean is taken, if they are no older than
    oldest: float = 1.2  # [s]
    least: int = 2  # [-] velocities of which there is a mean
    margin: float = 0.1  # [m/s] of it, and
    share: float = 0.005  # [-] of the speed: heading, stamps, scale
    deviations: float = 3.0  # [-] of its noise, or of the estimate
    acceleration: float = 10.0  # [m/s²] of a car, beside which no difference comes to be
    answered: float = 1.0  # [s] time constant with which a difference that is gone is forgotten
    nowhere: float = 0.01  # [m] of a place, below which nothing was drawn
    kept: int = 32  # [-] motions that are kept, 40 ms apart


VELOCITY = VelocityJudgeSettings()


class VelocityJudge(Judge):
    """Holds the velocities over ground of one car against its estimate; it leaves nobody out."""

    def __init__(self, adapter: Adapter) -> None:
        super().__init__()
        self._adapter = adapter
        sensors = tuple(adapter.sensors.values())
        self._course = place_of(sensors, "course")
        self.hears = frozenset((self._course,))
        self.judged = adapter.knows_car and self._course >= 0 and place_of(sensors, "rates and forces") >= 0
        if self.judged:
            self._ahead, self._left, _ = sensors[self._course].mounting().tolist()
        self.apart_by: tuple[float, ...] = 0.0, 0.0  # along and across the car [m/s]
        self._astray = 0.0  # how far the place may have been drawn meanwhile [m]
        self.forget(0)

    def forget(self, stamp: int) -> None:
        # Stamps [ns], headings [rad], and velocities of the antenna along and across the car [m/s].
        self._motions: deque[tuple[int, float, float, float]] = deque(maxlen=VELOCITY.kept)
        self._waiting: deque[Event] = deque(maxlen=VELOCITY.kept)
        self._differences: deque[tuple[int, float, float]] = deque(maxlen=VELOCITY.averaged)  # stamps [ns], [m/s]
        self._agreed = stamp  # when estimate and velocities last did [ns]
        if self.judged and stamp and not self._adapter.timeline.begun:
            apart = self._adapter.first_speeds_apart
            along, across = self.apart_by
            self.apart_by = max(along, apart), max(across, SETTINGS.sideways * apart)

    @property
    def apart(self) -> Apart | None:
        along, across = self.apart_by
        return Apart(along, across, place=self._astray) if along or across or self._astray else None

    @property
    def doubts(self) -> list[str]:
        by = hypot(*self.apart_by)
        return [f"measured velocity is {by:.1f} m/s from the estimate"] if by else []

    def hear(self, event: Event) -> None:
        if isfinite(event.value[0] + event.value[1]) and self._adapter.heading_known:
            self._waiting.append(event)

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        adapter, rate = self._adapter, felt[2] if felt[2] == felt[2] else 0.0
        along, across = adapter.forward_speed - rate * self._left, adapter.lateral_speed + rate * self._ahead
        if adapter.timeline.begun:
            self._note(adapter.timeline.present, adapter.heading, along, across)
        fade = exp(-h / VELOCITY.answered)
        self.apart_by = tuple(by * fade if by * fade > 0.5 * VELOCITY.margin else 0.0 for by in self.apart_by)
        self._astray = self._astray * exp(-h / DOUBT.corrected) + h * hypot(*self.apart_by)
        self._astray *= self._astray > VELOCITY.nowhere
        while self._waiting and self._motions and self._waiting[0].stamp <= self._motions[-1][0]:
            self._compare(self._waiting.popleft())

    def _note(self, stamp: int, heading: float, along: float, across: float) -> None:
        """Keep a motion at a time [ns]: a late message may have taken the filter back."""
        while self._motions and self._motions[-1][0] >= stamp:
            self._motions.pop()
        self._motions.append((stamp, heading, along, across))

    def _compare(self, event: Event) -> None:
        """Take in a velocity that is not newer than the newest motion."""
        motion = self._at(event.stamp)
        if motion is None:
            return
        heading, along, across = motion
        east, north = event.value.tolist()[:2]
        turned = east * cos(heading) + north * sin(heading), north * cos(heading) - east * sin(heading)
        newest = self._differences
        newest.append((event.stamp, turned[0] - along, turned[1] - across))
        while event.stamp - newest[0][0] > VELOCITY.oldest * 1e9:
            newest.popleft()
        if len(newest) < VELOCITY.least:
            return
        count, noise = len(newest), sqrt(float(event.variance[:2].max()))
        margin = VELOCITY.margin + VELOCITY.share * hypot(east, north) + VELOCITY.deviations * noise / sqrt(count)
        margins = [max(margin, VELOCITY.deviations * one) for one in self._adapter.velocity_deviations]
        means = [abs(sum(column)) / count for column in list(zip(*newest, strict=True))[1:]]
        if all(mean <= most for mean, most in zip(means, margins, strict=True)):
            self._agreed = event.stamp
            return
        most = VELOCITY.acceleration * max(event.stamp - self._agreed, 0) * 1e-9
        self.apart_by = tuple(max(was, min(mean, most)) for was, mean in zip(self.apart_by, means, strict=True))

    def _at(self, stamp: int) -> tuple[float, ...] | None:
        """Heading and velocities at a time [ns], between two motions; None before the oldest."""
        later = None
        for motion in reversed(self._motions):
            if motion[0] <= stamp:
                if later is None:
                    return motion[1:]
                share = (stamp - motion[0]) / (later[0] - motion[0])
                return tuple(one + share * (other - one) for one, other in zip(motion[1:], later[1:], strict=True))
            later = motion
        return None

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
