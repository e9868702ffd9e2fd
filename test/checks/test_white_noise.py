"""The noise of a signal from its own values: what was put in is estimated, and what a car does is not taken for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.checks.noise import SETTINGS, step_of, white_noise


@given(deviation=st.floats(1e-3, 1e3), offset=st.floats(-1e3, 1e3), seed=st.integers(0, 2**16))
def test_the_standard_deviation_of_white_noise_about_a_parabola_is_estimated(deviation, offset, seed):
    t = np.linspace(0.0, 1.0, 2000)
    noise = deviation * np.random.default_rng(seed).standard_normal(len(t))
    values = offset + 5.0 * deviation * t - 3.0 * deviation * t**2 + noise
    assert white_noise(values) == pytest.approx(deviation, rel=0.15)


def test_jumps_and_single_outliers_are_no_noise():
    values = 0.1 * np.random.default_rng(1).standard_normal(500)
    usual = white_noise(values)
    values[250:] += 50.0
    values[[30, 90, 400]] = -1e3
    assert white_noise(values) == pytest.approx(usual, rel=0.1)


def test_a_yaw_rate_of_a_lane_change_is_no_noise():
    t = np.arange(0.0, 2.56, 0.01)
    assert white_noise(0.5 * np.sin(2 * np.pi * 0.7 * t)) < 3e-5


def test_absent_values_are_passed_over():
    values = np.random.default_rng(2).standard_normal(3000)
    values[::50] = np.nan
    assert white_noise(values) == pytest.approx(1.0, rel=0.1)
    assert white_noise(np.full(500, np.nan)) == 0.0


def test_of_a_few_values_no_noise_is_known():
    assert white_noise(np.random.default_rng(3).standard_normal(SETTINGS.least_values - 1)) == 0.0


@pytest.mark.parametrize("held", [1, 5])
def test_values_in_steps_have_the_error_of_rounding(held):
    exact = np.repeat(np.linspace(0.0, 1.5, 400), held)
    read = np.round(exact / 0.05) * 0.05
    assert step_of(read) == pytest.approx(0.05)
    assert white_noise(read) == pytest.approx(np.std(read - exact), rel=0.5)
