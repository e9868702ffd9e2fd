"""White noise of a signal, estimated from its own values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.setting import JUDGEMENT, setting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseSettings:
    """By which values in steps are distinguished from others."""

    least_values: int = setting(12, "-", "of a signal, of fewer of which its noise is not known", JUDGEMENT)
    rounding: float = setting(1e-6, "-", "share of the range of a signal, below which two values are one", JUDGEMENT)
    off_step: float = setting(0.05, "steps", "by which a difference may be beside a multiple of the step", JUDGEMENT)
    in_steps: float = setting(0.9, "-", "share of differences that are multiples of the step", JUDGEMENT)


SETTINGS = NoiseSettings()
_OF_THIRD_DIFFERENCE = 20**0.5  # standard deviation of that of white noise: 1² + 3² + 3² + 1² variances add up
_MEDIAN_OF_NORMAL = float(ndtri(0.75))  # median of the absolute value of a standard normal number


def white_noise(values: Array) -> float:
    """Standard deviation of the white noise of a signal (n,), from values in equal intervals; 0 where there are too
    few of them. Absent values (NaN) are passed over, with the differences that they belong to.

    Third differences of white noise have a variance of twenty times its own, those of what a car does are small. Of
    values that are held until new ones come, each is counted once. Values in steps have an error of a twelfth of a
    squared step besides (Widrow 1956), which differences do not show where a signal rests on a step.
    """
    if len(values) < SETTINGS.least_values:
        return 0.0
    step = 0.0
    if np.count_nonzero(values[1:] == values[:-1]):
        values = values[:: period_of_updates(values[:, None]) or 1]
        step = step_of(values)
    differences = np.abs(values[3:] - 3 * (values[2:-1] - values[1:-2]) - values[:-3])
    if not np.isfinite(differences.sum()):
        differences = differences[np.isfinite(differences)]
    if len(differences) < SETTINGS.least_values - 3:
        return 0.0
    white = float(np.median(differences)) / (_MEDIAN_OF_NORMAL * _OF_THIRD_DIFFERENCE)
    return float(np.hypot(white, step / 12**0.5))


def white_noise_of_each(signals: Array) -> Array:
    """`white_noise` of each of some signals (n, m): of all at once, where nothing is held or absent."""
    held = np.count_nonzero(signals[1:] == signals[:-1])
    if held or len(signals) < SETTINGS.least_values or not np.isfinite(signals.sum()):
        return np.array([white_noise(signal) for signal in signals.T])
    differences = np.abs(signals[3:] - 3 * (signals[2:-1] - signals[1:-2]) - signals[:-3])
    return np.asarray(np.median(differences, axis=0) / (_MEDIAN_OF_NORMAL * _OF_THIRD_DIFFERENCE))


def step_of(values: Array) -> float:
    """The step in which values (n,) come: the least difference of two of them, where all others are multiples of it;
    0 where they do not come in steps. Absent values (NaN) are passed over."""
    different = np.unique(values[np.isfinite(values)])
    apart = np.diff(different)
    apart = apart[apart > SETTINGS.rounding * np.ptp(different)] if len(apart) else apart
    if not len(apart):
        return 0.0
    multiples = apart / apart.min()
    in_steps = np.abs(multiples - np.rint(multiples)) < SETTINGS.off_step
    return float(apart.min()) if np.mean(in_steps) > SETTINGS.in_steps else 0.0
