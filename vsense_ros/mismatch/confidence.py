"""How sure an answer is: the probability of a name, and the interval of a size."""

from __future__ import annotations

import numpy as np

from vsense_ros.mismatch.thresholds import THRESHOLDS, Thresholds

NORMAL_90 = 1.645  # standard deviations to either side that hold 90 % of a normal distribution
SMALLEST_GAIN = 1e-3  # as which a smaller gain counts, of which there is a logarithm


def confidence(gain: float, other: float, thresholds: Thresholds = THRESHOLDS) -> float:
    """How probable it is that an effect of the answer is there which explains `gain`, where the best explanation
    without it explains `other`."""
    lead = np.log(max(gain, SMALLEST_GAIN) / max(other, thresholds.least_gain))
    return float(thresholds.clear_name / (1 + np.exp(-thresholds.by_lead * lead)))


def interval(
    value: float, spread: float, left: float = 1.0, thresholds: Thresholds = THRESHOLDS
) -> tuple[float, float]:
    """The 90 % interval of a size in which windows agree to a standard deviation of `spread`, where the root mean
    square of the residuals is `left`, in standard deviations: what else is left out shifts it as well."""
    half = NORMAL_90 * float(np.hypot(spread, thresholds.size_error * max(1.0, left) * value))
    return value - half, value + half
