"""Kinematics of four wheels from the tables of their suspensions, as `hw/rtl/suspension_motion.sv`.

Of each wheel the columns x, y, camber, toe, caster and spring of `model.car.suspension`, polynomials in travel ξ and
steering η, with first derivative, half the second, and rate. The place of the thesis's "suspension update motion":
there the bodies of the linkages were moved, here what stands for them in the observer's model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.float32 import add, canonical, flushed, multiply
from vsense_ros.accelerator.kernels.base import Kernel, Words
from vsense_ros.errors import InputError

ROWS, COLUMNS = 6, 7  # of a front polynomial; a rear one has one column
PAIRS = 12  # of a front wheel's column and the same of the rear wheel behind it
QUANTITIES = ("x", "y", "camber", "toe", "caster", "spring")

Polynomials = Mapping[str, Sequence[Sequence[float]]]


class SuspensionMotion(Kernel):
    """A request is ξ, η and the rate of ξ of the wheels fl fr rl rr; a result of each wheel and column value, slope,
    half curvature and rate. Coefficients are sent once, as `table` makes them."""

    name, number, top, size = "suspension_motion", 4, "suspension_motion", 0
    words_in, words_out = 12, 96
    table_words = PAIRS * (ROWS * COLUMNS + ROWS)

    def __init__(self) -> None:
        self.parameters = {"U": 12, "DEEP": 1}
        self.variants = {
            "serial": {"U": 1, "DEEP": 1},
            "4 units": {"U": 4, "DEEP": 1},
            "12 units": {"U": 12, "DEEP": 1},
            "12 shallow units": {"U": 12, "DEEP": 0},
        }

    def run(self, words: Words, table: Words | None = None) -> tuple[Words, NDArray[np.bool_]]:
        if table is None or table.size != self.table_words:
            raise ValueError(f"coefficients (12, 48) are needed, found {None if table is None else table.shape}")
        given = flushed(np.ascontiguousarray(words, np.uint32).view(np.float32)).reshape(-1, 4, 3)
        c = flushed(np.ascontiguousarray(table, np.uint32).view(np.float32)).reshape(2, 6, 48)
        front, rear = c[..., :42].reshape(1, 2, 6, ROWS, COLUMNS), c[..., 42:].reshape(1, 2, 6, ROWS)
        eta = given[:, :2, 1][:, :, None, None]
        rows = np.broadcast_to(front[..., COLUMNS - 1], (len(given), 2, 6, ROWS))
        for j in reversed(range(COLUMNS - 1)):
            rows = add(multiply(rows, eta), front[..., j])
        rows = np.concatenate([rows, np.broadcast_to(rear, rows.shape)], axis=1)  # (k, wheel, column, row)
        xi, rate = given[:, :, 0][:, :, None], given[:, :, 2][:, :, None]
        value = rows[..., ROWS - 1]
        slope = half = np.zeros_like(value)
        for i in reversed(range(ROWS - 1)):
            value, slope, half = (
                add(multiply(value, xi), rows[..., i]),
                add(multiply(slope, xi), value),
                add(multiply(half, xi), slope),
            )
        moved = add(multiply(slope, rate), np.float32(0))
        result = np.stack([value, slope, half, moved], axis=-1)
        return canonical(result).reshape(*words.shape[:-1], 96), np.zeros(words.shape[:-1], bool)

    def cycles(self, **parameters: Any) -> int:
        chosen = self.parameters | parameters
        step = (5 + 6 if chosen["DEEP"] else 3 + 5) + 1
        return PAIRS // chosen["U"] * (12 * step + 7)


def table(front: Polynomials, rear: Polynomials) -> Words:
    """The words that hold both axles' coefficients, (576,). Raises `InputError` where they do not fit."""
    words = np.zeros((2, 6, ROWS * COLUMNS + ROWS), np.float32)
    for i, name in enumerate(QUANTITIES):
        for axle, given, (rows, columns), place in (
            ("front", front[name], (ROWS, COLUMNS), slice(0, ROWS * COLUMNS)),
            ("rear", rear[name], (ROWS, 1), slice(ROWS * COLUMNS, None)),
        ):
            values = np.asarray(given, dtype=float)
            if values.shape[0] > rows or values.shape[1] > columns:
                raise InputError(
                    f"the accelerator has {rows} × {columns} coefficients for {axle}.{name}, found "
                    f"{' × '.join(map(str, values.shape))}; make tables of a lower degree with vsense suspension"
                )
            filled = np.pad(values, [(0, rows - values.shape[0]), (0, columns - values.shape[1])])
            words[:, i, place] = filled.reshape(-1)
    return words.reshape(-1).view(np.uint32)


SUSPENSION_MOTION = SuspensionMotion()
