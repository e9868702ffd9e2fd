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
    frequencies: int = 200  # at which g is averaged
    ratios: int = 400  # of v over the variance of the noise, in a table of g
    largest_ratio: float = 1e4  # [-]


SMOOTHING = SmoothingSettings()


def smoothed(values: Array, noise: float, h: float) -> Array:
    """A signal (n,), in the unit of `values` (n,), which are `h` [s] apart and have white noise with a standard
    deviation of `noise`.

    Second differences of the signal are taken to be normal, with a variance v that changes slowly and is estimated with
    it. The result is the most likely signal (Whittaker 1923); with constant v it is that of a Wiener filter. Its second
    differences have a variance of g v, where g is the mean over all frequencies ω of
    1 / (1 + noise² |1 - exp(i ω)|⁴ / v).

    On a straight road a measured steering angle consists of noise, which the yaw rate does not follow. A model that is
    fitted to such an angle becomes too slow.
    """
    from scipy.ndimage import uniform_filter1d  # takes long to load, and no observer needs it

    if noise <= 0 or len(values) < 4:
        return values
    frequency = (np.arange(SMOOTHING.frequencies) + 0.5) * np.pi / SMOOTHING.frequencies
    fourth = (2 - 2 * np.cos(frequency)) ** 2
    least = (2 * np.pi * SMOOTHING.slowest * h) ** 4  # of v over the variance of the noise
    ratios = np.geomspace(least, SMOOTHING.largest_ratio, SMOOTHING.ratios)
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
    """The signal s (n,) that minimises Σ (s - values)² + Σ weights (Δ² s)², with values (n,) and weights (n - 2,)."""
    from scipy.linalg import solveh_banded  # takes long to load, and no observer needs it

    n = len(values)
    bands = np.zeros((3, n))
    for i, a in enumerate((1.0, -2.0, 1.0)):
        for k, b in enumerate((1.0, -2.0, 1.0)[i:]):
            bands[2 - k, i + k : n - 2 + i + k] += a * b * weights
    bands[2] += 1.0
    return np.asarray(solveh_banded(bands, values))
