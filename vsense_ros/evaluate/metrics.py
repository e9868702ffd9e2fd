"""Scores of the estimates of a drive against its reference.

All scores are taken at the stamps of the reference: the estimate is interpolated linearly between its own stamps,
never extrapolated, and never across a gap of more than `METRICS.longest_gap`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.lags import lag_curve, refined
from vsense_ros.checks.noise import white_noise
from vsense_ros.evaluate.signals import Array, Series, longest_period, read_signals, wrap
from vsense_ros.messages.recording import Recording


@dataclass(frozen=True)
class MetricSettings:
    """Settings of comparisons with a reference: decisions of this project."""

    longest_gap: float = 0.5  # [s] between two estimates, to interpolate between them; of frequent ones ten periods
    sparsest: float = 100.0  # steps of the grid for each value, beyond which two series are gaps, not a common time
    longest_lag: float = 1.0  # [s] that is searched for
    least_difference: float = 1e-6  # [-] of both variances, which the lag has to make to be known
    boundless: float = 1e12  # standard deviation in any unit that stands for an infinite one
    weakest_correlation: float = 0.5  # [-] of estimate and truth, for a lag to mean something
    least_certain_lag: float = 0.02  # [s] standard deviation of a lag, beyond which it is not known
    # Standard deviations of estimate and truth together that the range of the truth has to have, to be more than the
    # range of errors alone, ± 3 of them.
    least_range: float = 6.0


METRICS = MetricSettings()


@dataclass(frozen=True, slots=True)
class SignalScore:
    """How well one signal was estimated.

    - `rmse`: root mean square of the error [unit]; of the horizontal distance for the position.
    - `nrmsd_percent`: RMSE over the range (max - min) of the truth in percent (Leung 2010, eq. 1.2); over the
      diagonal of the bounding box for the position; None where that range is not larger than what noise of the truth
      and the standard deviation of the estimate make by themselves.
    - `bias`: mean of estimate - truth [unit]; length of the mean error vector for the position.
    - `lag_s`: delay that brings the estimate closest to the truth [s], positive where the estimate is late; None
      where the signals do not determine it to `METRICS.least_certain_lag` (a ramp, unlike each other), or that range
      does not.
    - `n`: number of reference values compared.
    - `within_2s`: share of the errors within two standard deviations, 0.954 if the filter is right; each component of
      the position counts. `nees`: mean square of error over standard deviation (Bar-Shalom, Li & Kirubarajan 2001,
      section 5.4), 1 if the filter is right, more if it is too sure of itself. None where it states no deviation, as
      with those of simpler ways.
    - `known_share`: share of the time for which the filter claims to know the signal; only that is scored.
    """

    rmse: float
    nrmsd_percent: float | None
    bias: float
    lag_s: float | None
    unit: str
    n: int
    within_2s: float | None = None
    nees: float | None = None
    known_share: float = 1.0


@dataclass(frozen=True, slots=True)
class Aligned:
    """Estimate and truth of one signal at the stamps of the truth.

    `stamp` (n,) [ns]; `estimate`, `truth` (n, k) [unit of the signal]; angles are continuous and never more than
    half a turn apart. `deviation` (n,) one standard deviation of the estimate; NaN where it states none.
    """

    stamp: NDArray[np.int64]
    estimate: Array
    truth: Array
    deviation: Array

    @property
    def error(self) -> Array:
        """The error (n, k): estimate less truth."""
        return self.estimate - self.truth

    def select(self, rows: NDArray[np.bool_]) -> Aligned:
        """The selected rows alone."""
        return Aligned(self.stamp[rows], self.estimate[rows], self.truth[rows], self.deviation[rows])


def compare(output: Recording, input: Recording) -> dict[str, SignalScore]:
    """Scores of every signal that stands below `vsense/` in `output` and below `reference/` in `input`.

    The side slip is scored where the reference moves faster than `signals.SLOWEST_SIDE_SLIP`.
    """
    estimates, truths = read_signals(output, "vsense"), read_signals(input, "reference")
    scores = {name: score(estimates[name], truths[name]) for name in estimates if name in truths}
    return {name: result for name, result in scores.items() if result is not None}


def without_reference(output: Recording, scored: Collection[str]) -> list[str]:
    """What `output` estimates and no reference is known for: signals that were not `scored`, and topics that hold none
    of the signals."""
    missing = [name for name in read_signals(output, "vsense") if name not in scored]
    for topic, channel in output.channels.items():
        name = topic.removeprefix("/")
        if len(channel) and name.startswith("vsense/wheel_slip/"):
            missing.append(name.removeprefix("vsense/").replace("/", "_"))
    return missing


def score(estimate: Series, truth: Series, *, with_lag: bool = True) -> SignalScore | None:
    """Score one signal where the estimate claims to know it; None where the two have no such time in common. The lag
    takes longer than all the rest, and can be left out."""
    aligned = align(estimate, truth)
    claimed = ~(aligned.deviation >= estimate.signal.unknown)
    if not claimed.any():
        return None
    aligned = aligned.select(claimed)
    error = aligned.error
    stated = aligned.deviation > 0
    ratio = error[stated] / aligned.deviation[stated, None]
    rmse = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    mean = error.mean(axis=0)
    extent = _known_range(aligned)
    return SignalScore(
        rmse=rmse,
        nrmsd_percent=None if extent is None else 100.0 * rmse / extent,
        bias=float(mean[0]) if len(mean) == 1 else float(np.linalg.norm(mean)),
        lag_s=lag(estimate, truth) if with_lag and extent is not None else None,
        unit=estimate.signal.unit,
        n=len(error),
        within_2s=float(np.mean(np.abs(ratio) < 2.0)) if len(ratio) else None,
        nees=float(np.mean(ratio**2)) if len(ratio) else None,
        known_share=float(claimed.mean()),
    )


def _known_range(aligned: Aligned) -> float | None:
    """Range of the truth, where that is more than errors of truth and estimate have by themselves."""
    extent = float(np.linalg.norm(np.ptp(aligned.truth, axis=0)))
    stated = aligned.deviation[np.isfinite(aligned.deviation)]
    own = float(np.median(stated)) if len(stated) else 0.0
    noise = max(white_noise(column) for column in aligned.truth.T)
    return extent if extent > max(METRICS.least_range * float(np.hypot(own, noise)), 1e-9) else None


def align(estimate: Series, truth: Series) -> Aligned:
    """Bring an estimate to the stamps of the truth, leaving out what it does not cover."""
    angle = truth.signal.angle
    times = (truth.stamp - truth.stamp[0]) * 1e-9 if len(truth) else np.zeros(0)
    longest_gap = min(longest_period(estimate.stamp), METRICS.longest_gap)
    value, covered = _resample(estimate, truth.stamp[0] if len(truth) else 0, times, longest_gap)
    value, stamp, reference = value[covered], truth.stamp[covered], truth.value[covered]
    if angle and len(reference):
        reference = np.unwrap(reference, axis=0)
        value = reference + wrap(value - reference)
    deviation = np.full(len(stamp), np.nan)
    if estimate.deviation is not None and len(stamp):
        # Interpolated between finite ones: beside an infinite one nothing is known.
        deviation = np.interp(stamp, estimate.stamp, np.minimum(estimate.deviation, np.finfo(float).max))
    return Aligned(stamp, value, reference, np.where(deviation > METRICS.boundless, np.inf, deviation))


def lag(estimate: Series, truth: Series) -> float | None:
    """Delay τ of the estimate behind the truth [s], by least squares; None where it is not known.

    τ minimises the variance of estimate(t) - truth(t - τ) over the times at which both are known, for |τ| up to
    `METRICS.longest_lag` and a quarter of the common time. The variance rather than the mean square, so that a bias
    does not pass for a delay. It is evaluated at all whole steps of a common grid and refined below the step by the
    parabola through its minimum. How well it is known, `_lag_deviation` says.
    """
    if len(estimate) < 4 or len(truth) < 4:
        return None
    origin = max(estimate.stamp[0], truth.stamp[0])
    duration = float(min(estimate.stamp[-1], truth.stamp[-1]) - origin) * 1e-9
    periods = [float(np.median(np.diff(series.stamp))) * 1e-9 for series in (estimate, truth)]
    step = float(np.clip(min(periods), 0.005, 0.05))
    reach = int(min(METRICS.longest_lag, duration / 4.0) / step)
    if reach < 2 or duration > METRICS.sparsest * step * (len(estimate) + len(truth)):
        return None
    times = np.arange(0.0, duration, step)
    y, y_known = _resample(estimate, origin, times, max(METRICS.longest_gap, 2.0 * periods[0]))
    x, x_known = _resample(truth, origin, times, max(METRICS.longest_gap, 2.0 * periods[1]))
    both_known = x_known & y_known
    if both_known.sum() < 4:
        return None
    y[~y_known], x[~x_known] = np.nan, np.nan
    curves = [lag_curve(estimated, true, reach) for estimated, true in zip(y.T, x.T, strict=True)]
    variance = np.nan_to_num(np.sum([curve.difference_variance for curve in curves], axis=0), nan=np.inf)
    power_y, power_x = (
        np.sum([getattr(c, name) for c in curves], axis=0) for name in ("variance_one", "variance_other")
    )
    best = int(np.argmin(variance))
    in_all = variance[np.isfinite(variance)]
    if best in (0, 2 * reach) or in_all.max() - variance[best] <= METRICS.least_difference * (power_y + power_x)[reach]:
        return None
    covariance = float(np.sum([curve.covariance[best] for curve in curves]))
    if not covariance >= METRICS.weakest_correlation * float(np.sqrt(power_y[best] * power_x[best])):
        return None
    shift = best - reach
    if _lag_deviation(y[max(shift, 0) :], x[max(-shift, 0) :], step) > METRICS.least_certain_lag:
        return None
    return float((refined(variance, best) - reach) * step)


def _lag_deviation(y: Array, x: Array, step: float) -> float:
    """Standard deviation [s] of the lag between signals (m, k), (n, k) that are shifted by it, on a grid of `step` [s].

    Least squares move the lag by Σ e ẋ / Σ ẋ², where means do not count, and e is what is left of y by the best
    multiple of x: a wrong gain is no lag. With e as noise that has the spectrum of its own and knows nothing of x, the
    variance of Σ e ẋ is that of both spectra: what errs slowly says little of a short event, and what errs as the
    signal moves says least.
    """
    n = min(len(y), len(x))
    slope = np.gradient(x[:n], step, axis=0)
    known = np.isfinite(y[:n]) & np.isfinite(slope)
    y, x, slope = (np.where(known, z - np.mean(z, axis=0, where=known), 0.0) for z in (y[:n], x[:n], slope))
    square, power = float(np.sum(x**2)), float(np.sum(slope**2))
    gain = float(np.sum(y * x)) / square if square > 0 else 0.0
    if not gain or not power:
        return np.inf
    size = 1 << (2 * n).bit_length()
    spectra = np.abs(np.fft.rfft(y - gain * x, size, axis=0) * np.fft.rfft(slope, size, axis=0)) ** 2
    return float(np.sqrt(2 * np.sum(spectra) / (size * n))) / (abs(gain) * power)


def _resample(series: Series, origin: int, times: Array, longest_gap: float) -> tuple[Array, NDArray[np.bool_]]:
    """Values (m, k) at `times` [s after origin], and where they are known; angles continuous."""
    covered = np.zeros(len(times), dtype=bool)
    value = np.zeros((len(times), series.value.shape[1]))
    if not len(series) or not len(times):
        return value, covered
    own_times = (series.stamp - origin) * 1e-9
    source = np.unwrap(series.value, axis=0) if series.signal.angle else series.value
    after = np.searchsorted(own_times, times)
    inside = (after > 0) & (after < len(own_times))
    covered[inside] = (own_times[after[inside]] - own_times[after[inside] - 1]) <= longest_gap
    covered |= np.isin(times, own_times)
    for column in range(value.shape[1]):
        value[:, column] = np.interp(times, own_times, source[:, column])
    return value, covered
