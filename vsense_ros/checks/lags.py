"""The lag between two signals: by how much one is the later one, found by correlation.

All shifts are compared at once: the sums that a correlation needs are themselves correlations of masked signals, which
Fourier transforms give. A correlation asks neither for units nor for signs, so that lags can be sought first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.setting import JUDGEMENT, setting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LagSettings:
    """How a lag is sought."""

    longest: float = setting(1.0, "s", "lag that is sought", JUDGEMENT)
    least_overlap: float = setting(1.0, "s", "in which both signals are present at a shift", JUDGEMENT)
    apart: float = setting(0.4, "s", "from the best lag to one that is another", JUDGEMENT)


CLOCK_LAGS = LagSettings()
# What lasts for a second and more leaves a simulation beside the car, and is sought in means that are coarser.
LONG_LAGS = LagSettings(longest=3.0, least_overlap=8.0)

_NO_POWER = 1e-12  # share of a signal's variance that rounding makes of none


@dataclass(frozen=True)
class LagCurve:
    """Statistics of two signals at `shifts` (k,) in steps by which the first is taken to be the later one: `count` of
    the instants at which both are present, and over these the variance of each and their covariance, (k,)."""

    shifts: NDArray[np.int64]
    count: Array
    variance_one: Array
    variance_other: Array
    covariance: Array

    @property
    def correlation(self) -> Array:
        """Correlation (k,), NaN where a signal is constant or the two have nothing in common."""
        power = np.sqrt(self.variance_one * self.variance_other)
        return np.divide(self.covariance, power, out=np.full(len(power), np.nan), where=power > 0)

    @property
    def ratio(self) -> Array:
        """Standard deviation of the first signal over that of the other (k,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(self.variance_one / self.variance_other))

    @property
    def difference_variance(self) -> Array:
        """Variance of the difference of the two signals (k,)."""
        return self.variance_one + self.variance_other - 2 * self.covariance


def lag_curve(one: Array, other: Array, longest: int, least: float = 2) -> LagCurve:
    """Statistics of two signals (n,), (m,) on the same grid for all shifts up to `longest` steps; absent samples are
    NaN. Shifts at which fewer than `least` instants are common have NaN."""
    shifts = np.arange(-longest, longest + 1)
    size = 1 << (max(len(one), len(other)) + longest).bit_length()
    known_one, known_other = np.isfinite(one), np.isfinite(other)
    parts = np.zeros((2, 3, size))  # of each signal, where it is known, its values and their squares
    power = []
    for part, values, known in ((parts[0], one, known_one), (parts[1], other, known_other)):
        mean = float(values[known].mean()) if known.any() else 0.0
        centred = np.where(known, values - mean, 0.0)
        power.append(float(centred @ centred) / max(int(known.sum()), 1))
        part[:, : len(values)] = known, centred, centred**2
    (mask_one, a, a_square), (mask_other, b, b_square) = np.fft.rfft(parts)
    first, second = [mask_one, a, mask_one, a_square, mask_one, a], [mask_other, mask_other, b, mask_other, b_square, b]
    sums = np.fft.irfft(np.array(first) * np.conj(second), size)[:, shifts]
    count = np.rint(sums[0])
    count[count < least] = np.nan
    mean_one, mean_other, square_one, square_other, of_both = sums[1:] / count
    variance_one, variance_other = square_one - mean_one**2, square_other - mean_other**2
    variance_one[variance_one <= _NO_POWER * power[0]] = 0.0
    variance_other[variance_other <= _NO_POWER * power[1]] = 0.0
    return LagCurve(shifts, count, variance_one, variance_other, of_both - mean_one * mean_other)


@dataclass(frozen=True)
class Match:
    """How two signals go together: `correlation` and `ratio` (standard deviation of the first over that of the other)
    without a shift; `lag` [s] by which the first is later where they correlate best, `best` their correlation then, and
    `clear` by how much that is more than at any lag apart from it."""

    correlation: float
    ratio: float
    lag: float
    best: float
    clear: float

    @property
    def explained(self) -> float:
        """Share of the variance that is unexplained without the lag, over that which is with it."""
        return (1 - self.correlation**2) / max(1 - self.best**2, 1e-9)

    @property
    def distinct(self) -> float:
        """Share of the variance that is unexplained at any lag apart from the best one, over that which is at it."""
        return (1 - (abs(self.best) - self.clear) ** 2) / max(1 - self.best**2, 1e-9)


def match(one: Array, other: Array, step: float, settings: LagSettings = CLOCK_LAGS) -> Match | None:
    """Compare two signals (n,) at common times, `step` [s] apart; None where they have too little in common, or one of
    them is constant."""
    longest = min(round(settings.longest / step), len(one) - 1)
    if longest < 1:
        return None
    curve = lag_curve(one, other, longest, settings.least_overlap / step)
    size = np.nan_to_num(np.abs(curve.correlation))
    if np.isnan(curve.correlation[longest]):
        return None
    at = int(np.argmax(size))
    lags = curve.shifts * step
    elsewhere = size[np.abs(lags - lags[at]) > settings.apart]
    return Match(
        correlation=float(curve.correlation[longest]),
        ratio=float(curve.ratio[longest]),
        lag=float(lags[at]),
        best=float(curve.correlation[at]),
        clear=float(size[at] - np.max(elsewhere, initial=0.0)),
    )


def refined(values: Array, at: int) -> float:
    """Place [steps] of the extremum of samples (n,) near the index `at`, by the parabola through it and its
    neighbours; the index itself at an end, or where they are on no parabola."""
    if not 0 < at < len(values) - 1:
        return float(at)
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2 * here + after
    return float(at + 0.5 * (before - after) / bend) if np.isfinite(bend) and bend != 0 else float(at)
