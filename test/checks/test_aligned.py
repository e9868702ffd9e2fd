"""The arithmetic of signals at common times, against integrals and counts in closed form."""

from __future__ import annotations

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.bag.importers import build
from vsense_ros.checks.aligned import AlignedSignals, align, means_around, runs_of_equal_values, stretches
from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.roles import USUAL_TOPICS, Role
from vsense_ros.checks.values import resolution


def grid(count: int = 500) -> AlignedSignals:
    return AlignedSignals(0, 0, np.arange(count) * 0.02, USUAL_TOPICS)


@given(span=st.floats(0.05, 1.0), slope=st.floats(-5, 5))
def test_the_mean_of_a_straight_line_is_its_value_in_the_middle(span, slope):
    t = np.arange(0.0, 10.0, 0.01)
    at = np.array([2.0, 5.0, 7.5])
    assert means_around(at, t, 1.0 + slope * t, span) == pytest.approx(1.0 + slope * at, abs=1e-9)


def test_absent_samples_are_passed_over_and_nothing_is_made_of_one():
    t = np.arange(0.0, 1.0, 0.1)
    value = np.where(np.arange(10) == 4, np.nan, 3.0)
    assert means_around(np.array([0.4]), t, value, 0.3) == pytest.approx([3.0])
    assert np.isnan(means_around(np.array([0.4]), t[:1], value[:1], 0.3)).all()


@given(st.lists(st.booleans(), max_size=40))
def test_stretches_are_those_of_a_loop_over_the_mask(mask):
    covered = [index for first, end in stretches(np.array(mask, bool)) for index in range(first, end)]
    assert covered == [index for index, there in enumerate(mask) if there]


@given(st.lists(st.integers(0, 2), min_size=1, max_size=40))
def test_runs_put_together_again_are_the_values(values):
    first, length = runs_of_equal_values(np.array(values, float))
    assert np.repeat(np.array(values)[first], length).tolist() == values
    assert (np.diff(np.array(values)[first]) != 0).all()


def test_a_mean_is_absent_where_a_part_of_it_is():
    signals = grid()
    values = np.sin(signals.t)
    values[200] = np.nan
    smooth = signals.smooth(values, 0.3)
    assert np.isnan(smooth[193:208]).all()
    assert np.isfinite(smooth[[192, 208]]).all()


def test_the_slope_of_a_parabola_is_exact():
    signals = grid()
    assert signals.slope(signals.t**2, 0.4)[20:-20] == pytest.approx(2 * signals.t[20:-20])


def test_the_course_of_a_circle_turns_at_its_rate_and_says_nothing_when_slow():
    signals = grid()
    east, north = 10 * np.cos(0.3 * signals.t), 10 * np.sin(0.3 * signals.t)
    assert signals.course_rate(east, north, 0.4, 5.0)[20:-20] == pytest.approx(0.3)
    assert np.isnan(signals.course_rate(east, north, 0.4, 11.0)).all()


def test_a_position_in_metres_is_that_of_a_tangential_plane():
    t = np.arange(0.0, 20.0, 0.1)
    latitude, longitude = 48.0 + 1e-4 * t, 11.0 + 2e-4 * t
    fixes = build.fix(build.nanoseconds(t, 0), latitude, longitude, 0 * t)
    aligned = align({Role.POSITION: fixes}, USUAL_TOPICS, 0)
    assert aligned is not None
    east, north, _ = pymap3d.geodetic2enu(latitude[-1], longitude[-1], 0, latitude[0], longitude[0], 0)
    assert aligned.signals["x"][-1] == pytest.approx(east, rel=2e-3)
    assert aligned.signals["y"][-1] == pytest.approx(north, rel=2e-3)


def test_a_hole_in_a_topic_stays_a_hole():
    t = np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(8.0, 12.0, 0.1)])
    velocity = build.velocity(build.nanoseconds(t, 0), np.column_stack([t, t, 0 * t]))
    aligned = align({Role.VELOCITY: velocity}, USUAL_TOPICS, 0)
    assert aligned is not None
    inside = (aligned.t > 5.0) & (aligned.t < 7.9)
    assert np.isnan(aligned.signals["east"][inside]).all()
    assert np.isfinite(aligned.signals["east"][aligned.t < 4.8]).all()


@given(step=st.sampled_from([0.1, 0.25, 1.0]), seed=st.integers(0, 20))
def test_the_resolution_of_rounded_values_is_the_step_of_rounding(step, seed):
    values = np.random.default_rng(seed).normal(scale=3 * step, size=500)
    assert resolution(np.round(values / step) * step) == pytest.approx(step)
    assert resolution(values) == 0.0


def test_values_that_stand_in_every_third_row_have_a_period_of_three():
    fresh = np.random.default_rng(0).normal(size=(200, 1))
    assert period_of_updates(np.repeat(fresh, 3, axis=0)) == 3
    assert period_of_updates(fresh) is None
