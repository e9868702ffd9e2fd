"""Is a GNSS receiver as exact as it states? Its positions are held against the way that the car has gone meanwhile.

What they scatter about it by from one to the next is their white noise, whatever the filter makes of them. A receiver
that states a tenth of it draws the filter to each of its positions, or is refused for ever where the first one was far
off. Either way the place is no better than its noise: that is said, and the published covariance widened by it. The
filter itself takes what is stated, so that estimates do not depend on the order in which messages arrive, and a
position that is far off is not believed because others were.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from math import cos, sin
from operator import itemgetter

import numpy as np

from vsense_ros.checks.noise import white_noise
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.judge import Judge


@dataclass(frozen=True)
class ReceiverSettings:
    """Numbers of positions, and when they are noisier than stated: decisions of this project."""

    least: int = 16  # [-] positions from which their noise is estimated
    newest: int = 128  # [-] that count
    anew: int = 8  # [-] positions from one estimate to the next
    way: int = 128  # [-] places of the way that are kept, 40 ms apart
    noisier: float = 3.0  # [-] times the stated standard deviation


RECEIVER = ReceiverSettings()


class ReceiverJudge(Judge):
    """The noise of the positions of one car, of which nobody is left out."""

    def __init__(self, adapter: Adapter) -> None:
        super().__init__()
        self._adapter = adapter
        sensors = tuple(adapter.sensors.values())
        self._position = place_of(sensors, "position")
        self.hears = frozenset((self._position,))
        self.judged = adapter.knows_car and self._position >= 0 and place_of(sensors, "rates and forces") >= 0
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._way: deque[tuple[int, float, float]] = deque(maxlen=RECEIVER.way)  # stamps [ns], east and north [m]
        self._beside: list[tuple[int, float, float]] = []  # positions less the way, by their stamps
        self._heard = 0  # of these since noise was estimated
        self._stated = 0.0  # [m] by the newest
        self.noise = 0.0  # [m] of the positions, where it is more than they state

    @property
    def apart(self) -> Apart | None:
        return Apart(place=self.noise) if self.noise else None

    @property
    def doubts(self) -> list[str]:
        if not self.noise:
            return []
        return [f"positions are noisier than stated, {self.noise:.2g} in place of {self._stated:.2g} m"]

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        adapter = self._adapter
        if not adapter.heading_known:
            return
        _, east, north = self._way[-1] if self._way else (0, 0.0, 0.0)
        way, heading = h * adapter.forward_speed, adapter.heading
        self._way.append((stamp, east + way * cos(heading), north + way * sin(heading)))

    def hear(self, event: Event) -> None:
        if len(self._way) < 2 or event.stamp < self._way[0][0]:
            return
        (east, north, *_), gone = event.value.tolist(), self._gone(event.stamp)
        insort(self._beside, (event.stamp, east - gone[0], north - gone[1]))
        del self._beside[: -RECEIVER.newest]
        self._heard += 1
        if self._heard >= RECEIVER.anew and len(self._beside) >= RECEIVER.least:
            self._heard, self._stated = 0, float(np.sqrt(event.variance.max()))
            noise = max(white_noise(axis) for axis in np.array(self._beside).T[1:])
            self.noise = noise if noise > RECEIVER.noisier * self._stated else 0.0

    def _gone(self, stamp: int) -> tuple[float, float]:
        """East and north of the way at a time [ns], straight on after its end."""
        after = min(max(bisect_left(self._way, stamp, key=itemgetter(0)), 1), len(self._way) - 1)
        (begin, *here), (end, *there) = self._way[after - 1], self._way[after]
        share = (stamp - begin) / max(end - begin, 1)
        east, north = (one + share * (other - one) for one, other in zip(here, there, strict=True))
        return east, north

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
