"""The data frames of a CAN log as columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.driver.can_signal import Frames

UNIX = 1e8  # [s] from which on a time is one since 1970


@dataclass(frozen=True)
class CanFrames:
    """The data frames of a log as columns, in the order of the log."""

    time: NDArray[np.float64]  # (n,) [s]
    identifier: NDArray[np.uint32]  # (n,)
    is_extended: NDArray[np.bool_]  # (n,)
    channel: NDArray[np.int16]  # (n,), which of `channels`
    channels: tuple[str, ...]
    length: NDArray[np.int64]  # (n,) [byte]
    begin: NDArray[np.int64]  # (n,), where in `data` a frame's own begins
    data: NDArray[np.uint8]
    losses: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def counts_from_zero(self) -> bool:
        """True if the times count from the start of the log."""
        return bool(len(self.time)) and float(np.median(self.time)) < UNIX

    def rows(self, chosen: NDArray[np.intp]) -> Frames:
        """Data of some frames, (frames, bytes of the longest), shorter ones filled with zeros."""
        length, begin = self.length[chosen], self.begin[chosen]
        width = int(length.max(initial=0))
        at = np.minimum(begin[:, None] + np.arange(width), max(len(self.data) - 1, 0))
        rows = self.data[at] if len(self.data) else np.zeros((len(chosen), width), np.uint8)
        rows[np.arange(width) >= length[:, None]] = 0
        return rows
