"""Closed forms of what sensors allow, against many draws of the errors they are about."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.navigation import accuracy

DRAWS = 20_000
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=20, deadline=None)
@given(seed=seeds, noise=st.floats(0.005, 0.5), faster=st.floats(4.0, 100.0), direction=st.floats(-np.pi, np.pi))
def test_the_course_of_a_fix_is_as_well_known_as_the_closed_form_says(seed, noise, faster, direction):
    speed = noise * faster
    error = noise * np.random.default_rng(seed).standard_normal((2, DRAWS))
    course = np.arctan2(speed * np.sin(direction) + error[1], speed * np.cos(direction) + error[0]) - direction
    off = (course + np.pi) % (2 * np.pi) - np.pi
    # The next term of the series is (noise / speed)².
    assert accuracy.course(noise, speed) == pytest.approx(off.std(), rel=0.03 + 2 / faster**2)


def test_below_twice_the_noise_a_course_has_no_standard_deviation():
    assert np.isnan(accuracy.course(0.5, 0.9))
    assert np.isfinite(accuracy.course(0.5, 1.1))


@settings(max_examples=10, deadline=None)
@given(
    seed=seeds,
    noise=st.floats(1e-4, 1e-2),
    bias=st.floats(0.0, 1e-3),
    walk=st.floats(0.0, 1e-3),
    start=st.floats(0.0, 0.01),
)
def test_an_integrated_gyro_drifts_as_the_closed_form_says(seed, noise, bias, walk, start):
    random, period, steps, draws = np.random.default_rng(seed), 0.1, 400, 4000
    error = start * random.standard_normal(draws)
    drift = bias * random.choice([-1.0, 1.0], draws)
    for _ in range(steps):
        error += period * (drift + noise * random.standard_normal(draws))
        drift += walk * np.sqrt(period) * random.standard_normal(draws)
    stated = accuracy.heading_by_gyro(steps * period, noise, period, start=start, bias=bias, bias_walk=walk)
    assert stated == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.06)


def test_two_antennas_a_metre_apart_tell_a_fifth_of_a_degree_by_carrier_phase():
    random = np.random.default_rng(5)
    across = 0.0025 * random.standard_normal((2, DRAWS))
    heading = np.arctan2(across[1] - across[0], 1.0)
    assert accuracy.heading_by_antennas(0.0025, 1.0) == pytest.approx(heading.std(), rel=0.02)
    assert np.degrees(accuracy.heading_by_antennas(0.0025, 1.0)) == pytest.approx(0.2, abs=0.005)


@given(rate=st.floats(-1, 1), period=st.floats(0.01, 2.0))
def test_an_angle_that_is_held_is_off_by_what_it_has_changed(rate, period):
    time = np.linspace(0.0, period, 2001)
    assert accuracy.held(rate, period) == pytest.approx(np.sqrt(np.mean((rate * time) ** 2)), rel=1e-3, abs=1e-12)
    assert accuracy.late(rate, period) == pytest.approx(abs(rate * period))
