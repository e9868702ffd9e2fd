"""A measured signal without its noise, as far as what moves it allows at each time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.filter import Array


@dataclass(frozen=True)
class SmoothingSettings:
    """Decisions of the smoothing of a measured input."""

    around: float = 2.0  # [s] over which a signal moves alike
    slowest: float = 0.1  # [Hz] cut-off where it does not move
    iterations: int = 20
    bins: int = 200  # of frequencies


SMOOTHING = SmoothingSettings()


def smoothed(values: Array, noise: float, h: float) -> Array:
    """Values (n,), `h` [s] apart, with white noise of a standard deviation of `noise`, smoothed.

    The second differences of the signal are taken for normal, with a variance v that changes slowly, which is found
    beside: the smoothed signal is the likeliest (Whittaker 1923; with the noise known, a Wiener filter). What it keeps
    of the second differences has a variance of g v, with g the mean over all frequencies ω of
    1 / (1 + noise² |1 - exp(i ω)|⁴ / v). An input of which a drive on a straight road shows nothing but noise would
    else be told from the output, which does not follow it, by a model that is too slow.
    """
    from scipy.ndimage import uniform_filter1d  # which takes long to load, and an observer does not need

    if noise <= 0 or len(values) < 4:
        return values
    frequency = (np.arange(SMOOTHING.bins) + 0.5) * np.pi / SMOOTHING.bins
    fourth = (2 - 2 * np.cos(frequency)) ** 2
    least = (2 * np.pi * SMOOTHING.slowest * h) ** 4  # of v over the variance of the noise
    ratios = np.geomspace(least, 1e4, 400)
    kept = np.log(ratios * np.mean(1 / (1 + fourth / ratios[:, None]), axis=1))
    length = max(3, round(SMOOTHING.around / h))
    ratio = np.full(len(values) - 2, 1.0)
    found = values
    for _ in range(SMOOTHING.iterations):
        found = _penalised(values, 1 / ratio)
        moving = uniform_filter1d(np.diff(found, 2) ** 2, length, mode="nearest") / noise**2
        ratio = np.exp(np.interp(np.log(np.maximum(moving, 1e-300)), kept, np.log(ratios)))
    return found


def _penalised(values: Array, weights: Array) -> Array:
    """The signal (n,) with the least sum of its squared distances from values and of its squared second differences
    (n - 2,), weighed."""
    from scipy.linalg import solveh_banded  # likewise

    n = len(values)
    bands = np.zeros((3, n))
    for i, a in enumerate((1.0, -2.0, 1.0)):
        for k, b in enumerate((1.0, -2.0, 1.0)[i:]):
            bands[2 - k, i + k : n - 2 + i + k] += a * b * weights
    bands[2] += 1.0
    return np.asarray(solveh_banded(bands, values))
