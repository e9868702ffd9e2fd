"""Texts whose last line was cut: its last number would be another one, and nobody would notice."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, BinaryIO

_COMPARED = 20  # lines before the last one, with whose decimals its own are compared


def is_cut(last: str, before: Sequence[str], delimiter: str, decimal: str = ".") -> bool:
    """True if the last line of a table, which has no end of line, lacks a part, to judge by the lines `before` it:
    cells, the end of a quotation, or decimals that all of them have."""
    if last.count('"') % 2 or last.count(delimiter) < before[-1].count(delimiter):
        return True
    *decimals, own = (_decimals(line, delimiter, decimal) for line in (*before[-_COMPARED:], last))
    return len(decimals) == _COMPARED and own < decimals[0] and len(set(decimals)) == 1


def _decimals(line: str, delimiter: str, decimal: str) -> int:
    """The number of decimals of the last cell of a line."""
    _, point, decimals = line.rpartition(delimiter)[2].strip().rpartition(decimal)
    return len(decimals) if point else 0


class Beginning(io.RawIOBase):
    """The first bytes of a file, as if it ended behind them."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(self._size + offset if whence == io.SEEK_END else offset, min(whence, io.SEEK_CUR))

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer: Any) -> int:
        data = self._file.read(max(min(len(buffer), self._size - self._file.tell()), 0))
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
