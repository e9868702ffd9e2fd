"""The components of the readings of one sensor, as the vote sees them: which are left out, how far they are from what
is expected."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Channel
from vsense_ros.runner.sums import Sums
from vsense_ros.runner.suspects import Suspect
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]


@dataclass
class Components:
    """The m components of each reading of one sensor.

    Behind their innovations may stand others, `conditions` in number, of what is required of the motion at each
    reading. `judged` are the places of the components that the filter uses. Those of an `inertial` sensor, which comes
    often, are looked at for jumps and for values that repeat themselves.
    """

    index: int
    channel: Channel
    words: tuple[str, ...]  # what the components are called
    judged: tuple[int, ...]
    conditions: int
    gate: float  # largest normalized innovation squared of one component
    inertial: bool
    suspects: tuple[Suspect, ...]  # of this sensor, those of one component first
    left: list[int] = field(default_factory=list)  # components that are left out
    refused_from: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # first, last [ns], how many
    sums: Sums = field(init=False)
    newest: deque[Array] = field(default_factory=lambda: deque(maxlen=VOTE.frozen))  # as they came
    looked: int = 0  # messages since the last look for frozen components
    asked: int = 0
    held: Array = field(init=False)  # share of values that equal the one before

    def __post_init__(self) -> None:
        m = len(self.words)
        self.sums, self.held = Sums(m, self.conditions), np.ones(m)

    @property
    def present(self) -> list[int]:
        """Places of the components that came of late."""
        came = self.sums.counts[0] > 0
        return [axis for axis in self.judged if came[axis]]

    def masked(self, value: Array) -> Array:
        """A measurement without what is left out."""
        value = value.copy()
        value[self.left] = np.nan
        return value

    @property
    def absent(self) -> list[str]:
        """Names of the components that did not come of late."""
        if not self.sums.begun:
            return []
        present = self.present
        return [self.words[axis] for axis in self.judged if axis not in present]

    def alone(self, component: int) -> Suspect:
        """The suspect that is this component alone, or else the one that it fails with."""
        return next(suspect for suspect in self.suspects if component in suspect.components)
