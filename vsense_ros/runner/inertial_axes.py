"""The axes of inertial sensors as a filter uses them, each of which the vote can leave out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vsense_ros.estimation.filter import Filter, Innovation
from vsense_ros.estimation.timeline import Channel, Event


class Judged(NamedTuple):
    """An inertial sensor as the vote sees it: names of its axes, places of those that the filter uses, how many other
    numbers stand behind its innovations, and its gate [standard deviations]."""

    words: tuple[str, ...]
    judged: tuple[int, ...]
    conditions: int
    gate: float


class InertialAxes:
    """How the readings of inertial sensors act on a filter, together or axis by axis; by default none is judged."""

    def __init__(self, filter: Filter) -> None:
        self.filter = filter

    def axes(self) -> dict[int, Judged]:
        """Inertial sensors whose axes can be left out, by their place."""
        return {}

    def correct(self, channel: Channel, event: Event, gate: float) -> Innovation:
        """Let an inertial reading correct the filter if its normalized innovation squared is at most `gate`."""
        return self.filter.correct(channel.name, event.value, event.variance, gate)

    def correct_by_axis(self, channel: Channel, event: Event, gate: float) -> Iterator[tuple[int, Innovation]]:
        """Let the axes of an inertial reading correct the filter one by one, each with its place and innovation."""
        for axis in np.flatnonzero(np.isfinite(event.value)).tolist():
            alone = np.full_like(event.value, np.nan)
            alone[axis] = event.value[axis]
            yield axis, self.filter.correct(channel.name, alone, event.variance, gate)

    def believe(self, channel: Channel, event: Event, axis: int) -> bool:
        """Let one axis of an inertial reading correct the filter however far it is from what was expected; False if the
        filter cannot."""
        alone = np.full_like(event.value, np.nan)
        alone[axis] = event.value[axis]
        self.filter.correct(channel.name, alone, event.variance, np.inf)
        return True

    def innovation_of_axis(self, channel: Channel, event: Event, axis: int) -> Innovation:
        """Innovation of one axis, which leaves the filter as it is."""
        alone = np.full_like(event.value, np.nan)
        alone[axis] = event.value[axis]
        return self.filter.correct(channel.name, alone, event.variance, -1.0)
