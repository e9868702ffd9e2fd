"""Lags of signals, against numpy's correlation of the samples that two signals have in common."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.checks.lags import LONG_LAGS, lag_curve, match, refined

STEP = 0.05


def noise(seed: int, count: int = 800) -> np.ndarray:
    return np.convolve(np.random.default_rng(seed).standard_normal(count), np.ones(10) / 10, mode="same")


@given(lag=st.integers(-50, 50), scale=st.sampled_from([-7.0, -1.0, 0.1, 1.0, 60.0]), seed=st.integers(0, 5))
def test_the_lag_of_two_signals_is_found_whatever_their_sizes_and_signs(lag, scale, seed):
    signal = noise(seed)
    other = scale * np.roll(signal, lag)
    other[: abs(lag)] = np.nan
    found = match(other, signal, STEP, LONG_LAGS)
    assert found is not None
    assert found.lag == pytest.approx(lag * STEP, abs=1e-9)
    assert np.sign(found.best) == np.sign(scale)


@settings(max_examples=30)
@given(seed=st.integers(0, 100), shift=st.integers(-20, 20), hole=st.integers(0, 60))
def test_statistics_at_a_shift_are_those_of_the_samples_that_are_common_to_both(seed, shift, hole):
    one, other = 5.0 + noise(seed, 100), -3.0 + noise(seed + 1, 100)
    one[30 : 30 + hole] = np.nan
    curve = lag_curve(one, other, 20)
    a, b = one[max(shift, 0) : 100 + min(shift, 0)], other[max(-shift, 0) : 100 - max(shift, 0)]
    known = np.isfinite(a)
    a, b = a[known], b[known]
    at = shift + 20
    assert curve.count[at] == known.sum()
    assert curve.correlation[at] == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-9)
    assert curve.ratio[at] == pytest.approx(a.std() / b.std(), rel=1e-9)
    assert curve.difference_variance[at] == pytest.approx(np.var(a - b), rel=1e-9)


def test_a_constant_signal_correlates_with_nothing():
    assert match(np.full(400, 9.81), noise(0, 400), STEP) is None
    assert np.isnan(lag_curve(np.full(400, 0.1), noise(0, 400), 5).correlation).all()


def test_shifts_with_too_few_common_samples_are_left_out():
    one = np.full(100, np.nan)
    one[:10] = np.arange(10.0)
    curve = lag_curve(one, np.arange(100.0), 20, least=8)
    assert np.isnan(curve.correlation[23:]).all()
    assert curve.correlation[:23] == pytest.approx(1.0)


def test_an_extremum_between_samples_is_that_of_the_parabola():
    t = np.arange(10.0)
    assert refined(3.0 - (t - 4.3) ** 2, 4) == pytest.approx(4.3)
    assert refined(t, 9) == 9.0
