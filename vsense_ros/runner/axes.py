"""The axes of an inertial sensor: which of them are left out, and since when."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Channel
from vsense_ros.runner.sums import WINDOWS, Sums
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]

FROZEN = "is frozen"


@dataclass
class Out:
    """An axis that is not believed."""

    since: int  # [ns]
    why: str
    decided: int  # [ns] when it was left out
    far: Array = field(default_factory=lambda: np.zeros(len(WINDOWS)))  # its sums were then [usual deviations]
    heard: int = 0  # when it has last appealed against that [ns]
    agreed_from: int = 0  # [ns]
    count: int = 0
    squares: float = 0.0
    total: float = 0.0  # of innovations, in units of the axis
    value: float = 0.0  # when it was asked last, and how often it had been the same
    same: int = 0
    stood: float = nan  # value at which it froze, while it may move on from there
    moved: int = 0  # how often in a row it has been asked since it did


@dataclass
class Axes:
    """The axes of one inertial sensor, m components of each reading.

    Behind the innovations of its axes may stand others, `conditions` in number, of what is required of the motion at
    each reading. `judged` are the places of the axes that the filter uses.
    """

    index: int
    channel: Channel
    words: tuple[str, ...]  # what the components are called
    judged: tuple[int, ...]
    conditions: int
    gate: float  # largest normalized innovation squared of one component
    out: dict[int, Out] = field(default_factory=dict)
    wait: dict[int, int] = field(default_factory=dict)  # how long an axis must agree next time [ns]
    believed: dict[int, int] = field(default_factory=dict)  # since when an axis that was out is not any more [ns]
    refused_from: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # first, last [ns], how many
    sums: Sums = field(init=False)
    newest: deque[Array] = field(default_factory=lambda: deque(maxlen=VOTE.frozen))  # as they came
    looked: int = 0  # messages since the last look for frozen axes
    asked: int = 0
    held: Array = field(init=False)  # share of values that equal the one before

    def __post_init__(self) -> None:
        m = len(self.words)
        self.sums, self.held = Sums(m, self.conditions), np.ones(m)

    def believe(self, axis: int, now: int) -> None:
        """Believe an axis that was out, at a time [ns]."""
        del self.out[axis]
        self.believed[axis] = now

    def leave_out(self, axis: int, out: Out) -> None:
        """Do not believe an axis any more. One that was right for long need not agree longer than at first."""
        if out.decided - self.believed.get(axis, out.decided) > VOTE.memory:
            self.wait.pop(axis, None)
        self.out[axis] = out
        self.refused_from.pop(axis, None)
        self.sums.forget(axis)

    @property
    def present(self) -> list[int]:
        """Places of the axes that came of late."""
        came = self.sums.counts[0] > 0
        return [axis for axis in self.judged if came[axis]]

    @property
    def absent(self) -> list[str]:
        """Names of the axes that did not come of late."""
        if not self.sums.begun:
            return []
        present = self.present
        return [self.words[axis] for axis in self.judged if axis not in present]

    def name(self, axis: int) -> str:
        """The name of an axis with that of its sensor."""
        return f"{self.channel.name} {self.words[axis]}"
