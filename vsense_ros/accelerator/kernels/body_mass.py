"""The mass matrix of one rigid body, as `hw/rtl/body_mass.sv`: the thesis's "individual mass matrix".

About a reference point and in its axes the 6×6 matrix of a body of mass m is [[R J Rᵀ, m [Rs]×], [-m [Rs]×, m I]], with
R that turns body axes into those of the reference, J the inertia about the reference point and s the centre of gravity,
both in body axes (Featherstone 2008, equation 2.63). The kernel makes its nine different numbers beside m.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.float32 import add, canonical, flushed, multiply
from vsense_ros.accelerator.kernels.base import Array, Kernel, Words

_SYMMETRIC = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # where xx yy zz xy xz yz stand in the matrix
_FIRST, _SECOND = np.triu_indices(3)  # of the upper triangle, by rows


class BodyMass(Kernel):
    """A request is R by rows, J as xx yy zz xy xz yz, s, m; a result xx xy xz yy yz zz of R J Rᵀ, and m R s."""

    name, number, top, size = "body_mass", 3, "body_mass", 0
    words_in, words_out = 19, 9

    def __init__(self) -> None:
        self.parameters = {"ROWS": 1, "DEEP": 0}
        self.variants = {
            "serial": {"ROWS": 0, "DEEP": 0},
            "pipelined": {"ROWS": 1, "DEEP": 0},
            "unrolled": {"ROWS": 3, "DEEP": 0},
        }

    def run(self, words: Words, table: Words | None = None) -> tuple[Words, NDArray[np.bool_]]:
        given = flushed(np.ascontiguousarray(words, np.uint32).view(np.float32))
        r = given[..., :9].reshape(*given.shape[:-1], 3, 3)
        j = given[..., 9:15][..., _SYMMETRIC]
        s, m = given[..., 15:18], given[..., 18]
        # Columns of [J | s] by rows of R, then rows of that by rows of R.
        columns = np.concatenate([j, s[..., None, :]], axis=-2)  # J is symmetric
        first = _dot3(r[..., :, None, :], columns[..., None, :, :])
        turned = _dot3(first[..., _FIRST, :3], r[..., _SECOND, :])
        # The unit that has m R s to make adds two products of zeros.
        moment = add(add(multiply(first[..., 3], m[..., None]), np.float32(0)), np.float32(0))
        return canonical(np.concatenate([turned, moment], axis=-1)), np.zeros(words.shape[:-1], bool)

    def cycles(self, **parameters: Any) -> int:
        chosen = self.parameters | parameters
        latency = 17 if chosen["DEEP"] else 13
        if chosen["ROWS"] == 0:
            return 2 * (12 + latency) + 2
        return 2 * latency + 2 + (1 if chosen["ROWS"] == 3 else 3)

    @staticmethod
    def matrix(result: Array, mass: float) -> NDArray[np.float64]:
        """The 6×6 matrix, rotation first, of a result (9,)."""
        xx, xy, xz, yy, yz, zz, x, y, z = (float(v) for v in result)
        moment = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return np.block([[turned, moment], [-moment, mass * np.eye(3)]])


def _dot3(a: Array, b: Array) -> Array:
    p = multiply(a, b)
    return add(add(p[..., 0], p[..., 1]), p[..., 2])


BODY_MASS = BodyMass()
