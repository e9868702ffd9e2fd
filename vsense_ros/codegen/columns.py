"""Arrays as compiled loops over lanes take them: one element of all lanes after the other."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Doubles = ctypes.POINTER(ctypes.c_double)
Integers = ctypes.POINTER(ctypes.c_longlong)


def beside(lanes: int, rows: int, *columns: Array) -> Array:
    """(rows, …, lanes): arrays (at most rows, …) of the runs, the last row of each again and again to the end."""
    side_by_side = np.zeros((rows, *columns[0].shape[1:], lanes))
    for lane, column in enumerate(columns):
        side_by_side[: len(column), ..., lane] = column
        side_by_side[len(column) :, ..., lane] = column[-1:]
    return side_by_side


def in_lanes(lanes: int, *values: Array) -> Array:
    """(…, lanes): values of the runs; lanes without a run have those of the first."""
    return np.stack([*values, *[values[0]] * (lanes - len(values))], axis=-1).astype(float)


def pointer(array: Array) -> ctypes._Pointer[ctypes.c_double]:
    """A pointer to the first number of a contiguous array."""
    return array.ctypes.data_as(Doubles)


def integers(array: NDArray[np.int64]) -> ctypes._Pointer[ctypes.c_longlong]:
    """A pointer to the first integer of a contiguous array."""
    return array.ctypes.data_as(Integers)
