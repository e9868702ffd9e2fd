"""Errors of an estimate against the truth of a simulated drive."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def score(error: Array, true: Array, settled: NDArray[np.bool_]) -> dict[str, float]:
    """Root mean square error [SI] when settled and over the whole drive, and the range of the truth."""
    return {
        "rmse": float(np.sqrt(np.mean(error[settled] ** 2))) if settled.any() else float("nan"),
        "whole": float(np.sqrt(np.mean(error**2))),
        "range": float(np.ptp(true)),
    }


def score_side_slip(error: Array, deviation: Array, settled: NDArray[np.bool_]) -> dict[str, Any]:
    """How true the stated deviation (n,) [rad] of a side slip is when settled: `nees`, the mean of the error (n,) [rad]
    squared over it, and the deviation's own root mean square."""
    stated = np.where(np.isfinite(deviation), deviation, np.nan)[settled]
    return {
        "nees": {"side_slip": float(np.nanmean((error[settled] / stated) ** 2))},
        "expected_side_slip": float(np.sqrt(np.nanmean(stated**2))),
    }
