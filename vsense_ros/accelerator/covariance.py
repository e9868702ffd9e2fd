"""The covariance of a Kalman filter in the accelerator: what a filter asks for, as programs of the row combiner.

A step is a product of sparse maps, P <- F P Fᵀ + Q: for the rows that a map changes, F P is made, its columns written,
F (F P)ᵀ made where these cross, and written; the half above the diagonal then stands below it too, so that P stays
symmetric to the last bit. A correction is in two requests, as the processor factors the innovation's covariance:
H P comes out, and L⁻¹ with L Lᵀ = H P Hᵀ + R goes in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsense_ros.accelerator.kernels.row_combiner import Program, RowCombiner

Array = NDArray[np.float64]
Words = NDArray[np.uint32]

_OWN_TERMS = 2  # as many at most are combined row by row, each from rows at its own distance


@dataclass(frozen=True)
class Part:
    """Rows of a map that are made together: `factors` (terms, rows) of the rows `sources` (terms,), which with `own`
    are those of the first, and go on with the rows."""

    first: int
    factors: Array
    sources: NDArray[np.intp]
    own: bool

    @property
    def rows(self) -> range:
        return range(self.first, self.first + self.factors.shape[1])


@dataclass(frozen=True)
class Map:
    """Changed rows of a transition, `rows` (k,), and what they are made of, `matrix` (k, n)."""

    rows: NDArray[np.intp]
    matrix: Array

    @classmethod
    def between(cls, first: int, matrix: ArrayLike) -> Map:
        """Consecutive rows from `first` on."""
        given = np.asarray(matrix, float)
        return cls(np.arange(first, first + len(given)), given)

    def parts(self, lanes: int) -> Iterator[Part]:
        """Rows side by side of which each is made of a few at the same distances, or which share what they are made
        of; no more than there are lanes."""
        begin = 0
        while begin < len(self.rows):
            end, distances = begin + 1, self._distances(begin)
            while end < len(self.rows) and end - begin < lanes and self.rows[end] == self.rows[end - 1] + 1:
                following = self._distances(end)
                own = len(distances) <= _OWN_TERMS
                if (following != distances) if own else (len(following) <= _OWN_TERMS):
                    break
                end += 1
            yield self._part(begin, end, sorted(distances))
            begin = end

    def _distances(self, k: int) -> set[int]:
        return set((np.flatnonzero(self.matrix[k]) - self.rows[k]).tolist())

    def _part(self, begin: int, end: int, distances: list[int]) -> Part:
        rows, matrix = self.rows[begin:end], self.matrix[begin:end]
        if 0 < len(distances) <= _OWN_TERMS:
            factors = np.array([matrix[np.arange(len(rows)), rows + distance] for distance in distances])
            return Part(int(rows[0]), factors, rows[0] + np.array(distances), True)
        sources = np.flatnonzero(matrix.any(axis=0))
        sources = sources if sources.size else rows[:1]  # rows of nothing
        return Part(int(rows[0]), matrix[:, sources].T, sources, False)


class AcceleratedCovariance:
    """A covariance (n, n) in the kernel. `run` is what answers programs: the mock's, or one over a link.

    What gives no answer waits, and goes with the next request that does.
    """

    def __init__(self, size: int, run: Callable[[Words], Words], lanes: int = 16) -> None:
        self.size, self.lanes, self._run = size, lanes, run
        self.clocks = self.words = self.requests = 0  # since the beginning
        self._program = Program(size, lanes)

    def _answer(self, first: int, count: int) -> Array:
        words = self._program.end(first, count)
        self._program = Program(self.size, self.lanes)
        answer = self._run(words)
        self.clocks += int(answer[-1])
        self.words += words.size + answer.size
        self.requests += 1
        return answer[:-1].view(np.float32).reshape(count, self.size).astype(float)

    def load(self, covariance: ArrayLike) -> None:
        """Begin with a covariance (n, n)."""
        self._program.write(0, covariance)

    def read(self) -> Array:
        """The covariance (n, n)."""
        return self._answer(0, self.size)

    def predict(self, maps: Sequence[Map], rows: ArrayLike, columns: ArrayLike, noise: ArrayLike) -> None:
        """A step: one map after the other, then noise (k,) added to elements (rows, columns), none of them twice."""
        for one in maps:
            self._transform(self._program, one)
        points = np.asarray(rows), np.asarray(columns), np.asarray(noise)
        for begin in range(0, len(points[0]), RowCombiner.ROWS):
            self._program.add(*(part[begin : begin + RowCombiner.ROWS] for part in points))

    def _transform(self, program: Program, one: Map) -> None:
        parts, work = list(one.parts(self.lanes)), RowCombiner.WORK
        places = [work + sum(len(p.rows) for p in parts[:k]) for k in range(len(parts))]
        for part, place in zip(parts, places, strict=True):
            program.combine(place, part.factors, part.sources, own=part.own)
        for part, place in zip(parts, places, strict=True):
            program.move(place, part.first, len(part.rows), column=True)
        crossed = int(one.rows.min()) // self.lanes, int(one.rows.max()) // self.lanes
        for part, place in zip(parts, places, strict=True):
            program.combine(place, part.factors, part.sources, own=part.own, slots=crossed)
        for part, place in zip(parts, places, strict=True):
            program.move(place, part.first, len(part.rows))
        for part in parts:
            program.move(part.first, part.first, len(part.rows), column=True)

    def project(self, jacobian: Array) -> Array:
        """H P (m, n) of a measurement's Jacobian H (m, n), which `subtract` then needs."""
        sources = np.flatnonzero(jacobian.any(axis=0))
        sources = sources if sources.size else np.zeros(1, int)
        for begin in range(0, len(jacobian), self.lanes):
            part = jacobian[begin : begin + self.lanes, sources]
            self._program.combine(RowCombiner.WORK + begin, part.T, sources)
        return self._answer(RowCombiner.WORK, len(jacobian))

    def subtract(self, whitening: Array) -> None:
        """P <- P - (L⁻¹ H P)ᵀ (L⁻¹ H P) with L⁻¹ (m, m) of what was projected last."""
        count = len(whitening)
        first = RowCombiner.WORK + count
        for begin in range(0, count, self.lanes):
            part = whitening[begin : begin + self.lanes]
            self._program.combine(first + begin, part.T, RowCombiner.WORK + np.arange(count))
        self._program.subtract_outer(first, count)
