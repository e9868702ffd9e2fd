"""binary32 as the arithmetic units of `hw/rtl` have it: round to nearest even, and subnormal numbers are zero.

Every operation of a kernel's mock is one of these, in the order of the hardware, so that both give the same bits. A NaN
has one pattern (7FC00000), which matters only when results leave: `canonical`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float32]
Words = NDArray[np.uint32]

SMALLEST = np.float32(2.0**-126)  # the smallest normal number
NAN = np.uint32(0x7FC00000)
ONE, ZERO = np.float32(1), np.float32(0)
_SIGN, _EXPONENT = np.uint32(0x80000000), np.uint32(0x7F800000)


def flushed(x: ArrayLike) -> Array:
    """With zeros of the same sign in place of subnormal numbers."""
    x = np.asarray(x, np.float32)
    return np.where(np.abs(x) < SMALLEST, np.copysign(ZERO, x), x)


def canonical(x: ArrayLike) -> Words:
    """The bits of results, with one pattern for every NaN."""
    x = flushed(x)
    return np.where(np.isnan(x), NAN, x.view(np.uint32))


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """a b of flushed numbers."""
    return _by(np.multiply, a, b)


def add(a: ArrayLike, b: ArrayLike) -> Array:
    """a + b of flushed numbers; one below the normal numbers is exact before it is flushed."""
    with np.errstate(all="ignore"):
        return flushed(np.add(a, b, dtype=np.float32))


def divide(a: ArrayLike, b: ArrayLike) -> Array:
    """a / b of flushed numbers."""
    return _by(np.divide, a, b)


def _by(operation: np.ufunc, a: ArrayLike, b: ArrayLike) -> Array:
    """A product or quotient.

    The hardware rounds to 24 bits wherever the number lies, and then takes what is below 2⁻¹²⁶ for zero; a processor
    rounds there to fewer bits first, by which the largest such numbers become 2⁻¹²⁶.
    """
    with np.errstate(all="ignore"):
        result = flushed(operation(a, b, dtype=np.float32))
        smallest = np.abs(result) == SMALLEST
        if smallest.any():
            exact = np.abs(operation(a, b, dtype=np.float64))  # a product exactly, a quotient well enough to round it
            below = (exact * 2.0**64).astype(np.float32) < np.float32(2.0**-62)
            result = np.where(smallest & below, np.copysign(ZERO, result), result)
    return result


def is_positive_normal(x: ArrayLike) -> NDArray[np.bool_]:
    """Neither zero, subnormal, negative, infinite nor NaN."""
    x = np.asarray(x, np.float32)
    return np.asarray((x >= SMALLEST) & np.isfinite(x))
