"""Is a GNSS receiver as exact as it states? Its positions are held against the way that the car has gone meanwhile,
its velocities against each other.

What they scatter about it by from one to the next is their white noise, whatever the filter makes of them. A receiver
that states a tenth of it draws the filter to each of its positions, or is refused for ever where the first one was far
off. Either way the place is no better than its noise: that is said, and the published covariance widened by it. The
filter itself takes what is stated, so that estimates do not depend on the order in which messages arrive, and a
position that is far off is not believed because others were.

Velocities that are noisier than stated are given the variance that they show: what the filter makes of the others,
slip and biases among it, would follow their noise otherwise. Of a receiver slower than 5 Hz that is not judged, as the
motion of a car differs from one velocity to the next as noise does.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, isfinite, sin
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.noise import white_noise
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import Component, place_of
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.judge import Judge

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReceiverSettings:
    """Numbers of positions and velocities, and when they are noisier than stated: decisions of this project."""

    least: int = 16  # [-] positions from which their noise is estimated
    newest: int = 128  # [-] that count
    anew: int = 8  # [-] positions or velocities from one estimate to the next
    way: int = 128  # [-] places of the way that are kept, 40 ms apart
    noisier: float = 3.0  # [-] times the stated standard deviation
    velocities: int = 64  # [-] from which their noise is estimated, the newest of them
    slowest: int = 210_000_000  # [ns] between two velocities whose differences are noise and not motion


RECEIVER = ReceiverSettings()


class _Noise:
    """White noise of pairs of values, east and north, of which `least` to `newest` count: `more` has the axes that are
    noisier than stated, with estimated and stated standard deviations."""

    def __init__(self, least: int, newest: int) -> None:
        self._least, self._newest = least, newest
        self._values: list[tuple[int, float, float]] = []  # by their stamps [ns]
        self._heard = 0  # since noise was estimated
        self.more: dict[int, tuple[float, float]] = {}

    @property
    def period(self) -> float:
        """Time between two values [ns]."""
        return (self._values[-1][0] - self._values[0][0]) / max(len(self._values) - 1, 1)

    def hear(self, stamp: int, east: float, north: float, variance: Array) -> None:
        """Take in two values with their stated variances (2,), or more of which the first are theirs."""
        insort(self._values, (stamp, east, north))
        del self._values[: -self._newest]
        self._heard += 1
        if self._heard < RECEIVER.anew or len(self._values) < self._least:
            return
        self._heard = 0
        estimated = [white_noise(axis) for axis in np.array(self._values).T[1:]]
        pairs = enumerate(zip(estimated, np.sqrt(variance[:2]).tolist(), strict=True))
        self.more = {i: pair for i, pair in pairs if pair[0] > RECEIVER.noisier * pair[1]}


def noisier_in_words(components: Sequence[Component], noisier: Mapping[int, tuple[float, float]]) -> list[str]:
    """Components of a sensor that are noisier than stated, in words, from their estimated and their stated standard
    deviations."""
    return [
        f"noise of {components[i].words} {estimated:.2g}, stated {stated:.2g} {components[i].unit}"
        for i, (estimated, stated) in noisier.items()
    ]


class ReceiverJudge(Judge):
    """The noise of the positions and velocities of one car, of which nobody is left out."""

    def __init__(self, adapter: Adapter) -> None:
        super().__init__()
        self._adapter = adapter
        sensors = tuple(adapter.sensors.values())
        self._position, self._velocity = place_of(sensors, "position"), place_of(sensors, "course")
        self._components = sensors[self._velocity].components
        self.hears = frozenset(i for i in (self._position, self._velocity) if i >= 0)
        self.judged = adapter.knows_car and bool(self.hears) and place_of(sensors, "rates and forces") >= 0
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._way: deque[tuple[int, float, float]] = deque(maxlen=RECEIVER.way)  # stamps [ns], east and north [m]
        self._beside = _Noise(RECEIVER.least, RECEIVER.newest)  # of positions less the way [m]
        self._velocities = _Noise(RECEIVER.velocities, RECEIVER.velocities)  # [m/s]

    @property
    def apart(self) -> Apart | None:
        more = self._beside.more.values()
        return Apart(place=max(more)[0]) if more else None

    @property
    def doubts(self) -> list[str]:
        more = self._beside.more.values()
        if not more:
            return []
        noise, stated = max(more)
        return [f"positions are noisier than stated, {noise:.2g} in place of {stated:.2g} m"]

    def doubt(self, index: int) -> str:
        return ", ".join(noisier_in_words(self._components, self._velocities.more)) if index == self._velocity else ""

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        adapter = self._adapter
        if not adapter.heading_known:
            return
        _, east, north = self._way[-1] if self._way else (0, 0.0, 0.0)
        way, heading = h * adapter.forward_speed, adapter.heading
        self._way.append((stamp, east + way * cos(heading), north + way * sin(heading)))

    def hear(self, event: Event) -> None:
        east, north, *_ = event.value.tolist()
        if event.sensor == self._velocity:
            self._hear_velocity(event, east, north)
        elif len(self._way) >= 2 and event.stamp >= self._way[0][0]:
            gone = self._gone(event.stamp)
            self._beside.hear(event.stamp, east - gone[0], north - gone[1], event.variance)

    def _hear_velocity(self, event: Event, east: float, north: float) -> None:
        """Take in a velocity [m/s], and give it the variance that the newest ones show, where they are noisier."""
        noise = self._velocities
        if not isfinite(east + north):
            return
        noise.hear(event.stamp, east, north, event.variance)
        if noise.period > RECEIVER.slowest:
            noise.more = {}
        if noise.more:
            event.variance = event.variance.copy()
            for axis, (estimated, _) in noise.more.items():
                event.variance[axis] = max(event.variance[axis], estimated**2)

    def _gone(self, stamp: int) -> tuple[float, float]:
        """East and north of the way at a time [ns], straight on after its end."""
        after = min(max(bisect_left(self._way, stamp, key=itemgetter(0)), 1), len(self._way) - 1)
        (begin, *here), (end, *there) = self._way[after - 1], self._way[after]
        share = (stamp - begin) / max(end - begin, 1)
        east, north = (one + share * (other - one) for one, other in zip(here, there, strict=True))
        return east, north

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
