"""What a filter's intake must know of a sensor, whatever it is mounted on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Source(Protocol):
    """Where readings come from: a topic and its type of message, and how to read one."""

    message: ClassVar[str]  # message type
    geodetic: ClassVar[bool]  # True: `read` finds `east` and `north` [m] beside latitude and longitude
    noisy: ClassVar[bool]  # True: noise makes equal messages in a row impossible
    states_noise: ClassVar[bool]  # False: its messages have no place for standard deviations
    least_stated: ClassVar[float]  # share of `deviations` below which the one that a message states does not count

    @property
    def topic(self) -> str: ...
    @property
    def frame_id(self) -> str: ...
    @property
    def latency(self) -> float:
        """How long after the measurement its time stamp is [s]."""

    @property
    def timeout(self) -> float:
        """Silence after which it is reported [s]."""

    def offsets(self) -> Array:
        """Known errors (m,), to be subtracted."""

    def deviations(self) -> Array:
        """Standard deviations (m,), where a message states none."""

    def noise_in_words(self, deviations: Array) -> str:
        """Standard deviations (m,) with their units; empty for none."""

    def read(self, names: tuple[str, ...], values: Mapping[str, Array], value: Array, variance: Array) -> None:
        """Write the measurement (m,) of a message, and the variances (m,) if it states some."""

    def read_rows(self, names: tuple[str, ...], columns: Mapping[str, Array], value: Array, variance: Array) -> None:
        """As `read`, of n messages at once: columns (n, length), `value` and `variance` (n, m)."""
