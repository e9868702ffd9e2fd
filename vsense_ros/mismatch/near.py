"""Motions in windows near those of one parameter set, which secants are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.model.simulation.differences import Differences, Known
from vsense_ros.model.simulation.open_loop import OpenLoop, Run, StateHistory

Array = NDArray[np.float64]


@dataclass
class Moved:
    """A motion in a window, and what is known of it."""

    motion: StateHistory
    lost_from: float  # when the car gets lost [s], infinite where it never does
    signals: dict[int, dict[str, Array]] = field(default_factory=dict)  # by a hash of the sensors


class MotionsNear:
    """The motions near that of a parameter set which were asked for last. They are used for the very objects that asked
    for them, and for no others: a fit that comes to the same parameters is simulated in full."""

    def __init__(self, loop: OpenLoop) -> None:
        self._differences = Differences(loop)
        self._known: dict[int, tuple[int, Known]] = {}  # by window, with the key of the motion
        self._asked: list[ParameterSet] = []
        self.motions: dict[tuple[int, int], Moved] = {}  # by window and key

    def begin(self, known: Mapping[int, tuple[int, Run, StateHistory]], parameter_sets: Sequence[ParameterSet]) -> None:
        """Forget the motions of before, and learn of the known ones by window, each with its key and its run."""
        self._asked, self.motions = list(parameter_sets), {}
        new = [i for i, (key, _, _) in known.items() if i not in self._known or self._known[i][0] != key]
        with_jacobians = self._differences.known([known[i][1] for i in new], [known[i][2] for i in new])
        self._known |= {i: (known[i][0], one) for i, one in zip(new, with_jacobians, strict=True)}

    def drive(self, index: int, runs: Sequence[Run]) -> list[StateHistory]:
        """The motions of runs near the known one of a window."""
        return self._differences.motions(self._known[index][1], runs)

    def known_of(self, parameter_set: ParameterSet) -> dict[tuple[int, int], Moved]:
        """The motions by window and key that may be used for a parameter set."""
        return self.motions if any(one is parameter_set for one in self._asked) else {}
