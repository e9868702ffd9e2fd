"""Slopes of fits that are kept for later, in files: those of all explanations were most of a search's memory."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import Slopes
from vsense_ros.mismatch.search_settings import EFFORT


class StoredSlopes(Sequence[Slopes]):
    """Slopes by block, (rows, k) each, in a file without a name that is gone with this object: read when asked for."""

    def __init__(self, slopes: Sequence[Slopes]) -> None:
        """Raises `OSError` if they cannot be written."""
        self._shapes = [block.shape for block in slopes]
        self._types = [block.dtype for block in slopes]
        self._begins = np.cumsum([0, *(block.nbytes for block in slopes)]).tolist()
        self._file = tempfile.TemporaryFile(prefix="vsense_")  # noqa: SIM115
        for block in slopes:
            self._file.write(np.ascontiguousarray(block).data)
        self._file.flush()  # a full disk is noticed here

    def __len__(self) -> int:
        return len(self._shapes)

    @overload
    def __getitem__(self, index: int) -> Slopes: ...

    @overload
    def __getitem__(self, index: slice) -> list[Slopes]: ...

    def __getitem__(self, index: int | slice) -> Slopes | list[Slopes]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        self._file.seek(self._begins[i])
        block: NDArray[Any] = np.empty(self._shapes[i], self._types[i])
        self._file.readinto(block.data)  # type: ignore[attr-defined]
        return block


def stored(slopes: Sequence[Slopes]) -> Sequence[Slopes]:
    """The same slopes in a file, where they are large and there is room for it."""
    if isinstance(slopes, StoredSlopes) or sum(block.nbytes for block in slopes) < EFFORT.stored_from:
        return slopes
    try:
        return StoredSlopes(slopes)
    except OSError:  # a full disk, or one that may not be written to
        return slopes
