"""What a filter of the literature finds in its small simulation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Finding(NamedTuple):
    """One row of the table: a quantity as found, and what it is compared with."""

    filter: str
    source: str
    quantity: str
    unit: str
    found: float
    beside: str  # what stands beside it
    reference: float


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
