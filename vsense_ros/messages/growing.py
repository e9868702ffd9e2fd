"""Columns that grow row by row, and go to the disk where they become long."""

from __future__ import annotations

from dataclasses import dataclass
from tempfile import TemporaryFile, gettempdir
from typing import IO

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError


@dataclass(frozen=True)
class GrowingSettings:
    """Decisions of this project."""

    in_memory: int = 1 << 22  # [byte] of a column: minutes of what a filter estimates, all of which takes some 100 MB


GROWING = GrowingSettings()


class Growing:
    """A column (n, k) of which blocks (m, k) come one after the other.

    What is more than `GROWING.in_memory` waits in a file without a name, in the folder for temporary files. Its array
    is a map of that file then, which the system reads where it is looked at and need not keep. Raises `InputError`
    where there is no room for it.
    """

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float64]] = []
        self._file: IO[bytes] | None = None
        self._rows = self._width = self._size = 0  # [byte] in memory

    def add(self, block: NDArray[np.float64]) -> None:
        """Take the next rows."""
        block = np.ascontiguousarray(block, dtype=float)  # what they are a part of need not be kept
        self._parts.append(block)
        self._rows += len(block)
        self._width = block.shape[1]
        self._size += block.nbytes
        if self._size > GROWING.in_memory:
            self._put_down()

    def column(self) -> NDArray[np.float64]:
        """All rows, after which none may be added any more."""
        if self._file is None:
            return np.concatenate(self._parts)
        self._put_down()
        return np.memmap(self._file, dtype=float, mode="c", shape=(self._rows, self._width))

    def _put_down(self) -> None:
        try:
            if self._file is None:
                self._file = TemporaryFile()  # noqa: SIM115 - open as long as its map is
            for part in self._parts:
                self._file.write(part.data)
            self._file.flush()
        except OSError as error:
            reason = f"no room for a long recording's estimates ({error.strerror}); TMPDIR names another folder"
            raise InputError(f"{gettempdir()}: {reason}") from None
        self._parts.clear()
        self._size = 0
