"""What a sensor needs to know of a simulated drive in order to say what its messages would have been."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sampling:
    """When a sensor measures and when its message arrives, all in ms; steps of its values."""

    period: int
    phase: int  # of the first measurement
    delay: int  # until arrival
    quantum: tuple[float, ...]  # of each component; one for all if single
    own_clock: bool = False  # True: it measures at its own instants, even where all others measure together
    limit: tuple[float, ...] = (inf,)  # largest amount of each component; one for all if single


class Content(NamedTuple):
    """The messages of a sensor: columns by field, one row for each message, and names of joints."""

    columns: dict[str, Array]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class SimulatedDrive:
    """A simulated drive at the n instants at which a sensor measures."""

    truth: Array  # (n, m) what a perfect sensor would give
    position: Array  # (n, 3) of `cog` on the map [m]
    origin: tuple[float, float, float]  # of the map: latitude, longitude [deg], height [m]
    rng: np.random.RandomState  # from which errors are drawn
    bias: float  # 1, or 0 for sensors without biases
    quantum: Array  # steps of the values
    climb: Callable[[Array], Array]  # upward velocity (n,) [m/s] of a point of the body, (3,) [m] in the axes of `cog`
    limit: Array = field(default_factory=lambda: np.array([inf]))  # largest amounts of the values

    def __len__(self) -> int:
        return len(self.truth)

    def digitized(self, value: Array) -> Array:
        """Values (n, m) as its messages have them: within its range, in steps. Raises `InputError` where the numbers of
        a bus are neither one nor m."""
        for setting, numbers in (("resolution", self.quantum), ("range", self.limit)):
            if numbers.size not in (1, value.shape[1]):
                raise InputError(
                    f"a transmission has a {setting} of {numbers.size} numbers for messages of {value.shape[1]} "
                    "values; expected one for all of them, or one for each"
                )
        return quantized(np.clip(value, -self.limit, self.limit), self.quantum)

    def repeated(self, row: list[float] | Array) -> Array:
        """A column that says the same in every message."""
        return np.tile(np.asarray(row, dtype=float), (len(self), 1))


def quantized(value: Array, quantum: Array | float) -> Array:
    """Nearest multiple of a step, exact in binary if the step is a power of two."""
    return np.rint(value / quantum) * quantum + 0.0  # no negative zeros
