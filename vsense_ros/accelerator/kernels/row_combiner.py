"""`hw/rtl/row_combiner.sv`: sums of rows of a symmetric matrix that stays in the accelerator, as a filter's covariance.

A request is a program: words that say which rows are combined into which. `Program` writes one, and `RowCombiner` does
what the hardware does with it, with the same bits and clocks. `vsense_ros/accelerator/covariance.py` makes programs of
what a Kalman filter asks for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsense_ros.accelerator import float32
from vsense_ros.errors import InputError

Array = NDArray[np.float32]
Words = NDArray[np.uint32]


class Operation(IntEnum):
    """What an instruction's first three bits stand for."""

    SIZE, WRITE, COMBINE, OUTER, MOVE, POINT, NONE, END = range(8)


@dataclass
class Program:
    """Words of a request, and how many the answer has. `lanes` limits how many rows a combination may make."""

    columns: int
    lanes: int = 16
    words: list[NDArray[np.uint32]] = field(default_factory=list)
    words_out: int = 1  # the clocks, after END

    def __post_init__(self) -> None:
        if not 1 <= self.columns <= RowCombiner.COLUMNS:
            raise InputError(f"a matrix of 1 to {RowCombiner.COLUMNS} rows, not {self.columns}")
        self._say(Operation.SIZE, self.columns - 1)

    def write(self, first: int, rows: ArrayLike) -> None:
        """Rows (k, columns) from `first` on."""
        given = np.asarray(rows, np.float32).reshape(-1, self.columns)
        self._say(Operation.WRITE, first, count=len(given))
        self._numbers(given)

    def combine(
        self, first: int, factors: ArrayLike, sources: ArrayLike, *, slots: tuple[int, int] | None = None,
        keep: bool = False, own: bool = False,
    ) -> None:  # fmt: skip
        """Rows `first` + i become the sum over k of factors[k, i] times row sources[k], or sources[k] + i with `own`;
        they are added to what is there with `keep`. Only the `slots` of columns from one to another are made. None
        of the results may be among the sources."""
        given = np.asarray(factors, np.float32)
        terms, results = given.shape
        low, high = slots or (0, (self.columns - 1) // self.lanes)
        bits = (64 // self.lanes - 1).bit_length()
        flags = keep << 21 | own << 22 | low << 23 | high << (23 + bits)
        self._say(Operation.COMBINE, first, results - 1, terms, flags)
        body = np.empty((terms, 1 + results), np.uint32)
        body[:, 0] = sources
        body[:, 1:] = given.view(np.uint32)
        self.words.append(body.reshape(-1))

    def subtract_outer(self, first: int, count: int) -> None:
        """The matrix becomes itself less the sum of vᵀv over `count` rows v from `first` on."""
        self._say(Operation.OUTER, first, count=count)

    def move(self, first: int, to: int, count: int, *, column: bool = False) -> None:
        """Rows `first` + i become the rows, or columns, `to` + i; a row of the matrix none but its own column."""
        self._say(Operation.MOVE, first, to, count, column << 21)

    def add(self, rows: ArrayLike, columns: ArrayLike, values: ArrayLike) -> None:
        """Elements grow, 128 of them at most and none of them twice."""
        given = np.asarray(values, np.float32)
        body = np.empty((given.size, 2), np.uint32)
        body[:, 0] = np.asarray(columns) << 7 | np.asarray(rows)
        body[:, 1] = given.view(np.uint32)
        self._say(Operation.POINT, 0, count=given.size)
        self.words.append(body.reshape(-1))

    def end(self, first: int = 0, count: int = 0) -> Words:
        """All words, for the kernel, whose answer will have `count` rows from `first` on."""
        self._say(Operation.END, first, count=count + 1)
        self.words_out = count * self.columns + 1
        return np.concatenate(self.words)

    def _say(self, operation: Operation, low: int, middle: int = 0, count: int = 1, flags: int = 0) -> None:
        word = operation << 29 | flags | (count - 1) << 14 | middle << 7 | low
        self.words.append(np.array([word], np.uint32))

    def _numbers(self, numbers: Array) -> None:
        self.words.append(np.ascontiguousarray(numbers).view(np.uint32).reshape(-1))


class RowCombiner:
    """The kernel's mock: its memory lasts from request to request. Not for several threads at once."""

    ROWS: ClassVar[int] = 128
    COLUMNS: ClassVar[int] = 64
    WORK: ClassVar[int] = 64  # the first row that is not of the matrix
    name: ClassVar[str] = "row_combiner"
    top: ClassVar[str] = "row_combiner"
    number: ClassVar[int] = 5
    size: ClassVar[int] = 64  # columns of the largest matrix
    words_in: ClassVar[int] = 0  # a request is as long as its program
    words_out: ClassVar[int] = 0
    table_words: ClassVar[int] = 0
    parameters: ClassVar[dict[str, int]] = {"L": 16}
    variants: ClassVar[dict[str, dict[str, int]]] = {"8 lanes": {"L": 8}, "16 lanes": {"L": 16}}
    _READ: ClassVar[int] = 3  # clocks until what was read has been turned to where it goes
    _GAP: ClassVar[int] = 4

    def __init__(self, lanes: int = 16, deep: bool = True) -> None:
        self.lanes = lanes
        self._product, self._sum = (5, 6) if deep else (3, 5)
        self.memory = np.zeros((self.ROWS, self.COLUMNS), np.float32)
        self.columns = self.COLUMNS
        self._now = self._drained = 0  # when the next instruction may be taken, and when all results are in memory

    @property
    def slots(self) -> int:
        """Number of slots of a row, in each of which there are as many columns as lanes."""
        return -(-self.columns // self.lanes)

    def run(self, words: Words) -> Words:
        """The answer to a program: what it reads, and last the clocks that it took."""
        self._now = self._drained = 0
        given = iter(np.asarray(words, np.uint32))
        for header in given:
            word = int(header)
            operation = Operation(word >> 29)
            self._now = max(self._now, self._drained)
            low, middle, count = word & 127, word >> 7 & 127, (word >> 14 & 127) + 1
            if operation is Operation.SIZE:
                self.columns, self._now = (low & 63) + 1, self._now + 1
            elif operation is Operation.WRITE:
                self._write(low, count, given)
            elif operation is Operation.COMBINE:
                self._combine(low, middle + 1, count, word, given)
            elif operation is Operation.OUTER:
                self._outer(low, count)
            elif operation is Operation.MOVE:
                self._move(low, middle, count, bool(word >> 21 & 1))
            elif operation is Operation.POINT:
                self._add(count, given)
            else:
                return np.append(self._read(low, count - 1), np.uint32(self._now))
        raise InputError("a program of the kernel has no end")

    @property
    def _depth(self) -> int:
        return self._READ + self._product + self._sum

    @staticmethod
    def _taken(given: Iterator[np.uint32], count: int) -> Words:
        return np.fromiter(given, np.uint32, count)

    @staticmethod
    def _added(kept: ArrayLike, factor: ArrayLike, x: ArrayLike) -> Array:
        return float32.add(float32.flushed(kept), float32.multiply(float32.flushed(factor), float32.flushed(x)))

    def _write(self, first: int, count: int, given: Iterator[np.uint32]) -> None:
        rows = self._taken(given, count * self.columns).reshape(count, self.columns)
        self.memory[first : first + count, : self.columns] = rows.view(np.float32)
        self._now += 1 + rows.size

    def _read(self, first: int, count: int) -> Words:
        self._now += 1 + count * (self.slots * (2 + self._READ) + self.columns)
        return self.memory[first : first + count, : self.columns].copy().view(np.uint32).reshape(-1)

    def _combine(self, first: int, results: int, terms: int, word: int, given: Iterator[np.uint32]) -> None:
        bits = (64 // self.lanes - 1).bit_length()
        mask = (1 << bits) - 1
        low, high = word >> 23 & mask, word >> (23 + bits) & mask
        part = slice(low * self.lanes, (high + 1) * self.lanes)
        body = self._taken(given, terms * (1 + results)).reshape(terms, 1 + results)
        factors = body[:, 1:].view(np.float32)
        target = self.memory[first : first + results, part]
        total = target.copy() if word >> 21 & 1 else np.zeros_like(target)
        for source, factor in zip(body[:, 0].astype(int), factors, strict=True):
            rows = source + np.arange(results) if word >> 22 & 1 else np.full(results, source)
            total = self._added(total, factor[:, None], self.memory[rows, part])
        target[:] = total
        slots = results * (high - low + 1)
        period = max(self._sum + 2, slots)
        last = self._now + results + 2 + (terms - 1) * max(period, results + 2)
        self._now, self._drained = last + period + 1, last + slots + 2 + self._depth

    def _outer(self, first: int, count: int) -> None:
        rows = self.memory[first : first + count].copy()
        matrix = self.memory[: self.columns, : self.slots * self.lanes]
        total = matrix.copy()
        for row in rows[:, : self.slots * self.lanes]:
            total = self._added(total, -row[: self.columns, None], row)
        matrix[:] = total
        began = self._now + 3 + self._READ
        for block in range(self.slots):
            slots = self.slots * min(self.lanes, self.columns - block * self.lanes)
            period = max(self._sum + 2, slots)
            last = began + (count - 1) * (period + self._READ + 3)
            began = last + period + self._READ + 3
            self._now, self._drained = last + period + 1, last + slots + 2 + self._depth

    def _add(self, count: int, given: Iterator[np.uint32]) -> None:
        body = self._taken(given, 2 * count).reshape(count, 2)
        places = body[:, 0] & 127, body[:, 0] >> 7 & 63
        self.memory[places] = self._added(self.memory[places], body[:, 1].view(np.float32), np.float32(1))
        self._now += 1 + 2 * count
        self._drained = self._now + 1 + self._depth

    def _move(self, first: int, to: int, count: int, column: bool) -> None:
        width = self.slots * self.lanes
        for i in range(count):
            row = self.memory[first + i, :width].copy()
            if column:
                self.memory[:width, to + i] = row
            else:
                self.memory[to + i, :width] = row
        self._now += 1 + count * (self.slots + self._GAP)
        self._drained = self._now
