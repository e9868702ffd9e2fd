"""Linear systems by Gauss-Jordan elimination without divisions but the last (David 2017), as `hw/rtl/gj_solver.sv`.

With the pivot a_kk = m_k 2^e_k, 1 ≤ m_k < 2, every other row becomes m_k a_i - (a_ik / 2^e_k) a_k, so that nothing but
products and sums stands in the loop, and numbers stay within the range of binary32. Rows are not exchanged: it is made
for matrices whose pivots are positive as they are, as mass matrices and the matrices of implicit time steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.float32 import NAN, ONE, ZERO, add, canonical, divide, flushed, is_positive_normal, multiply
from vsense_ros.accelerator.kernels.base import Array, Kernel, Words


class GaussJordan(Kernel):
    """N × N with one right-hand side; a request is the rows of [A | b], a result x."""

    top = "gj_solver"

    def __init__(self, name: str, number: int, size: int, lanes: int, variants: dict[str, dict[str, int]]) -> None:
        self.name, self.number, self.size = name, number, size
        self.words_in, self.words_out = size * (size + 1), size
        self.parameters = {"N": size, "P": lanes, "DEEP": 1}
        self.variants = {key: {"N": size, **chosen} for key, chosen in variants.items()}

    def run(self, words: Words, table: Words | None = None) -> tuple[Words, NDArray[np.bool_]]:
        n = self.size
        x, refused = solve(np.ascontiguousarray(words, np.uint32).view(np.float32).reshape(-1, n, n + 1))
        return canonical(x).reshape(*words.shape[:-1], n), refused.reshape(words.shape[:-1])

    def cycles(self, **parameters: Any) -> int:
        chosen = self.parameters | parameters
        n, lanes, deep = chosen["N"], chosen["P"], bool(chosen["DEEP"])
        slots_of_row = -(-(n + 1) // lanes)
        latency = 3 + (5 + 6 if deep else 3 + 5)
        total = 0
        for k in range(n - 1):
            slots = slots_of_row - k // lanes
            fewer = (k + 1) % lanes == 0
            total += max((n - 1) * slots, latency + 1 + slots + (n - 2 if fewer else 0))
        total += n * (slots_of_row - (n - 1) // lanes)  # the last step has its pivot row, too
        return total + latency + (16 if deep else 15)


def solve(systems: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Solutions (k, n) of systems [A | b] (k, n, n + 1), and of each whether a pivot was not a positive normal number,
    in which case its solution is NaN."""
    a = flushed(systems)
    count, n, _ = a.shape
    refused = np.zeros(count, bool)
    d = np.zeros((count, n), np.float32)
    with np.errstate(all="ignore"):
        for k in range(n):
            pivot = a[:, k, k]
            refused |= ~is_positive_normal(pivot)
            mantissa, exponent = np.frexp(pivot)
            m, e = (mantissa * 2).astype(np.float32)[:, None], (exponent - 1)[:, None]
            d[:, :k] = multiply(d[:, :k], m)
            d[:, k] = pivot
            others = np.arange(n) != k
            c = flushed(np.ldexp(a[:, others, k], -e))
            rest = a[:, others, k + 1 :]
            a[:, others, k + 1 :] = add(multiply(m[:, :, None], rest), -multiply(c[:, :, None], a[:, k, None, k + 1 :]))
        # The last pivot row goes through the same product and sum, with 1 and 0.
        b = a[:, :, n]
        b[:, n - 1] = add(multiply(ONE, b[:, n - 1]), multiply(ZERO, b[:, n - 1]))
        x = divide(b, d)
    x[refused] = NAN.view(np.float32)
    return x, refused


SOLVE_14 = GaussJordan(
    "solve14",
    1,
    14,
    8,
    {
        "serial": {"P": 1, "DEEP": 1},
        "4 lanes": {"P": 4, "DEEP": 1},
        "8 lanes": {"P": 8, "DEEP": 1},
        "15 lanes": {"P": 15, "DEEP": 0},
    },
)
SOLVE_42 = GaussJordan(
    "solve42",
    2,
    42,
    22,
    {"serial": {"P": 1, "DEEP": 1}, "11 lanes": {"P": 11, "DEEP": 1}, "22 lanes": {"P": 22, "DEEP": 1}},
)
SOLVE_56 = GaussJordan("solve56", 6, 56, 19, {"serial": {"P": 1, "DEEP": 1}, "19 lanes": {"P": 19, "DEEP": 1}})
