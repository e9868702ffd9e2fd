"""The axes of an inertial sensor: which of them are left out, and since when."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Channel
from vsense_ros.runner.sums import Sums
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]


@dataclass
class Out:
    """An axis that is not believed."""

    since: int  # [ns]
    why: str
    agreed_from: int = 0  # [ns]
    count: int = 0
    squares: float = 0.0
    total: float = 0.0  # of innovations, in units of the axis
    value: float = 0.0  # when it was asked last, and how often it had been the same
    same: int = 0


@dataclass
class Axes:
    """Of one inertial sensor with m components."""

    index: int
    channel: Channel
    words: tuple[str, ...]  # what the components are called
    gate: float  # largest normalized innovation squared of one component
    out: dict[int, Out] = field(default_factory=dict)
    wait: dict[int, int] = field(default_factory=dict)  # how long an axis must agree next time [ns]
    refused_from: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # first, last [ns], how many
    sums: Sums = field(init=False)
    newest: deque[Array] = field(default_factory=lambda: deque(maxlen=VOTE.frozen))  # as they came
    looked: int = 0  # messages since the last look for frozen axes
    asked: int = 0
    held: Array = field(init=False)  # share of values that equal the one before

    def __post_init__(self) -> None:
        m = len(self.words)
        self.sums, self.held = Sums(m), np.ones(m)

    @property
    def there(self) -> NDArray[np.bool_]:
        """What came of late, (m,)."""
        return np.asarray(self.sums.counts[0] > 0)

    def masked(self, value: Array) -> Array:
        """A measurement without what is out."""
        value = value.copy()
        value[list(self.out)] = np.nan
        return value

    @property
    def absent(self) -> list[str]:
        """What did not come of late."""
        return [
            word for word, there in zip(self.words, self.there.tolist(), strict=True) if not there and self.sums.begun
        ]

    def name(self, axis: int) -> str:
        """Of an axis, with that of its sensor."""
        return f"{self.channel.name} {self.words[axis]}"
