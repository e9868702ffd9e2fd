"""A road along which something changes, known at places: between these it has no kinks, which would shake a car.

It is the natural cubic spline, which is linear in what is known. What is known of a place is felt a quarter as much
behind each next one, with the other sign.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]


def spline(distance: Array, value: Array) -> CubicSpline:
    """Through values (n,) at two places or more, `distance` (n,) [m], which increase."""
    from scipy.interpolate import CubicSpline  # which takes long to load, and few observers need

    return CubicSpline(distance, value, bc_type="natural")


def changes(distance: Array, value: Array) -> Array:
    """What the values (n,) at places `distance` (n,) [m] change by per metre there; nothing of one place."""
    return np.asarray(spline(distance, value)(distance, 1)) if len(distance) > 1 else np.zeros(len(distance))


def between(share: float, length: float, value: Array, change: Array) -> tuple[float, float]:
    """Value of a cubic spline and its derivative per metre at a `share` of the way between two places that are a
    `length` [m] apart, from the values and derivatives (2,) at both places (Hermite's form)."""
    (begin, end), remaining = value.tolist(), 1 - share
    first, last = length * change.item(0) - (end - begin), (end - begin) - length * change.item(1)
    curved = remaining * first + share * last
    interpolated = begin + share * (end - begin + remaining * curved)
    return interpolated, (end - begin + (remaining - share) * curved + share * remaining * (last - first)) / length
