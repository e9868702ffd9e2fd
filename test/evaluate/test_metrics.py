"""Scores against closed forms: sinusoids, shifts and ramps whose error is known without computing it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from synthetic_drives import START, channel, odometry, recording, slalom
from vsense_ros.evaluate.metrics import align, compare, lag, score, without_reference
from vsense_ros.evaluate.signals import SIGNALS, Series, curve, euler_angles, read_signals

PERIOD = 2.0  # of the sinusoids [s]
OMEGA = 2.0 * np.pi / PERIOD


def series(seconds, value, name="lateral_velocity") -> Series:
    stamp = START + np.round(np.asarray(seconds) * 1e9).astype(np.int64)
    return Series(SIGNALS[name], stamp, np.asarray(value, dtype=float).reshape(len(stamp), -1))


def sinusoid(rate, late=0.0, amplitude=1.0, offset=0.0, duration=20.0):
    seconds = np.arange(0.0, duration + 1e-9, 1.0 / rate)
    return series(seconds, offset + amplitude * np.sin(OMEGA * (seconds - late)))


def wave(seed, seconds):
    """A smooth aperiodic signal: five sinusoids of random frequency and phase."""
    random = np.random.default_rng(seed)
    frequency, phase = random.uniform(0.5, 6.0, 5), random.uniform(0.0, 6.28, 5)
    return np.sin(np.outer(seconds, frequency) + phase).sum(axis=1)


def test_a_perfect_estimate_scores_zero():
    found = compare(slalom("vsense"), slalom("reference"))
    assert set(found) == set(SIGNALS)
    for name, one in found.items():
        assert one.rmse == pytest.approx(0.0, abs=1e-9), name
        assert one.lag_s is None or one.lag_s == pytest.approx(0.0, abs=1e-6), name


def test_a_late_sinusoid_has_the_closed_form_rmse_and_its_delay():
    late = 0.0537
    found = score(sinusoid(100.0, late), sinusoid(100.0))
    # sin(wt - wd) - sin(wt) has amplitude 2 sin(wd / 2)
    assert found.rmse == pytest.approx(2.0 * np.sin(OMEGA * late / 2.0) / np.sqrt(2.0), rel=1e-3)
    assert found.nrmsd_percent == pytest.approx(100.0 * found.rmse / 2.0, rel=1e-3)
    assert found.lag_s == pytest.approx(late, abs=2e-4)


def test_a_bias_is_reported_and_does_not_pass_for_a_delay():
    found = score(sinusoid(100.0, offset=0.25), sinusoid(100.0))
    assert found.bias == pytest.approx(0.25)
    assert found.rmse == pytest.approx(0.25)
    assert found.lag_s == pytest.approx(0.0, abs=1e-6)


def test_a_wrong_gain_does_not_pass_for_a_delay():
    assert lag(sinusoid(100.0, amplitude=0.6), sinusoid(100.0)) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("estimate_rate", [50.0, 250.0, 1000.0])
@pytest.mark.parametrize("truth_rate", [20.0, 100.0])
@pytest.mark.parametrize("late", [-0.123, 0.0004, 0.31])
def test_the_delay_is_found_below_the_sample_time_whatever_the_rates(estimate_rate, truth_rate, late):
    assert lag(sinusoid(estimate_rate, late), sinusoid(truth_rate)) == pytest.approx(late, abs=1.5e-3)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(-0.4, 0.4))
def test_exchanging_estimate_and_truth_turns_the_sign_of_the_delay(seed, late):
    seconds = np.arange(0.0, 12.0, 0.01)
    first, second = series(seconds, wave(seed, seconds)), series(seconds, wave(seed, seconds - late))
    assert lag(second, first) == pytest.approx(late, abs=3e-3)
    assert lag(first, second) == pytest.approx(-lag(second, first), abs=1e-7)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(-50.0, 50.0))
def test_the_bias_of_a_shifted_signal_is_the_shift(seed, shift):
    seconds = np.arange(0.0, 10.0, 0.02)
    value = wave(seed, seconds)
    found = score(series(seconds, value + shift), series(seconds, value))
    assert found.bias == pytest.approx(shift, abs=1e-9)
    assert found.rmse == pytest.approx(abs(shift), abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(1e-3, 1e4), st.floats(-1e3, 1e3))
def test_nrmsd_depends_neither_on_the_scale_nor_on_the_zero_of_the_signal(seed, scale, zero):
    seconds = np.arange(0.0, 10.0, 0.02)
    truth, estimate = wave(seed, seconds), wave(seed, seconds - 0.05) + 0.1
    plain = score(series(seconds, estimate), series(seconds, truth))
    scaled = score(series(seconds, zero + scale * estimate), series(seconds, zero + scale * truth))
    assert scaled.nrmsd_percent == pytest.approx(plain.nrmsd_percent, rel=1e-6)
    assert scaled.rmse == pytest.approx(scale * plain.rmse, rel=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000))
def test_rmse_is_never_less_than_the_bias(seed):
    random = np.random.default_rng(seed)
    seconds = np.arange(0.0, 5.0, 0.05)
    found = score(series(seconds, random.normal(1.0, 2.0, 100)), series(seconds, random.normal(size=100)))
    assert found.rmse >= abs(found.bias)


def test_interpolation_of_a_straight_line_is_exact_and_nothing_is_extrapolated():
    estimate = series([1.0, 1.4, 1.8], [10.0, 14.0, 18.0])
    truth = series(np.arange(0.0, 3.0, 0.1), np.arange(0.0, 30.0, 1.0))
    aligned = align(estimate, truth)
    assert (aligned.stamp - START) * 1e-9 == pytest.approx(np.arange(1.0, 1.81, 0.1))
    assert aligned.error == pytest.approx(0.0, abs=1e-9)


def test_a_gap_of_more_than_half_a_second_is_not_bridged():
    seconds = np.concatenate([np.arange(0.0, 2.0, 0.1), np.arange(2.8, 5.0, 0.1)])
    truth = series(np.arange(0.0, 4.95, 0.05), np.zeros(99))
    aligned = align(series(seconds, np.zeros(len(seconds))), truth)
    covered = (aligned.stamp - START) * 1e-9
    assert not np.any((covered > 1.901) & (covered < 2.799))
    assert covered.min() < 1.9
    assert covered.max() > 2.8


def test_a_yaw_across_half_a_turn_counts_the_short_way_round():
    seconds = np.arange(0.0, 10.0, 0.1)
    turning = 0.8 * seconds
    truth = read_signals(recording(odometry("reference/odometry", seconds, yaw=turning)), "reference")["yaw"]
    estimate = read_signals(recording(odometry("vsense/odometry", seconds, yaw=turning + 0.02)), "vsense")["yaw"]
    found = score(estimate, truth)
    assert found.bias == pytest.approx(0.02)
    assert found.nrmsd_percent == pytest.approx(100.0 * 0.02 / np.ptp(turning))


def test_the_position_is_scored_by_horizontal_distance_over_the_diagonal():
    seconds = np.arange(0.0, 10.0, 0.1)
    path = np.column_stack([3.0 * seconds, 4.0 * seconds])
    found = compare(
        recording(odometry("vsense/odometry", seconds, position=path + np.array([0.6, -0.8]))),
        recording(odometry("reference/odometry", seconds, position=path)),
    )["position"]
    assert (found.rmse, found.bias) == (pytest.approx(1.0), pytest.approx(1.0))
    assert found.nrmsd_percent == pytest.approx(100.0 / (5.0 * 9.9))
    assert found.lag_s is None  # along a straight line at constant speed a delay is an offset


@pytest.mark.parametrize("shape", [np.zeros(500), np.arange(500.0)], ids=["constant", "ramp"])
def test_no_delay_is_claimed_where_the_signal_cannot_tell(shape):
    seconds = np.arange(500) * 0.02
    assert lag(series(seconds, shape), series(seconds, shape)) is None


def test_no_delay_is_claimed_between_signals_that_have_nothing_in_common():
    random = np.random.default_rng(3)
    seconds = np.arange(500) * 0.02
    assert lag(series(seconds, random.normal(size=500)), series(seconds, random.normal(size=500))) is None


def test_a_constant_truth_has_no_nrmsd():
    seconds = np.arange(0.0, 5.0, 0.1)
    assert score(series(seconds, np.ones(50)), series(seconds, np.zeros(50))).nrmsd_percent is None


def test_a_range_that_errors_make_by_themselves_gives_no_nrmsd_and_no_lag():
    seconds = np.arange(0.0, 20.0, 0.02)
    truth = series(seconds, 0.4 * wave(3, seconds))  # a range of 3
    for deviation, known in ((0.1, True), (1.0, False)):
        estimate = replace(series(seconds, truth.value[:, 0]), deviation=np.full(len(seconds), deviation))
        found = score(estimate, truth)
        assert (found.nrmsd_percent is not None, found.lag_s is not None) == (known, known)
    noisy = series(seconds, np.random.default_rng(1).normal(size=len(seconds)))
    assert score(series(seconds, np.zeros(len(seconds))), noisy).lag_s is None


def test_a_lag_is_absent_where_slow_errors_outweigh_a_single_step():
    seconds = np.arange(0.0, 20.0, 0.01)
    step = np.tanh((seconds - 10.0) / 0.3)
    drift = np.cumsum(np.random.default_rng(2).normal(size=len(seconds)))
    drift *= 0.5 / np.std(drift)
    assert lag(series(seconds, step), series(seconds, step)) == pytest.approx(0.0, abs=1e-6)
    assert lag(series(seconds, step + drift), series(seconds, step)) is None


def test_estimate_and_truth_without_common_time_have_no_score():
    assert score(series([0.0, 0.1], [1.0, 1.0]), series([5.0, 5.1], [1.0, 1.0])) is None


def test_the_side_slip_is_not_scored_while_the_car_creeps():
    seconds = np.arange(0.0, 10.0, 0.1)
    speed = np.where(seconds < 5.0, 1.0, 10.0)
    truth = read_signals(recording(odometry("reference/odometry", seconds, vx=speed, vy=0.1)), "reference")
    assert len(truth["speed"]) == 100
    assert (truth["side_slip"].stamp.min() - START) * 1e-9 == pytest.approx(5.0)
    assert truth["side_slip"].value == pytest.approx(np.arctan2(0.1, 10.0))


def test_what_a_message_marks_absent_or_not_finite_is_no_signal():
    seconds = np.arange(0.0, 5.0, 0.1)
    found = odometry("reference/odometry", seconds, vy=np.nan)
    found.columns["pose_covariance"][:] = -1.0
    found.columns["orientation"][:] = 0.0
    assert set(read_signals(recording(found), "reference")) == {"longitudinal_velocity", "yaw_rate"}


def test_an_angle_whose_variance_is_not_a_number_has_no_truth():
    seconds = np.arange(0.0, 5.0, 0.1)
    found = odometry("reference/odometry", seconds)
    found.columns["pose_covariance"][:, [21, 28]] = np.nan
    signals = read_signals(recording(found), "reference")
    assert "yaw" in signals
    assert not {"roll", "pitch"} & set(signals)


def test_a_stamp_that_comes_twice_counts_with_the_value_that_arrived_last():
    seconds = np.array([0.0, 0.1, 0.1, 0.05])
    found = read_signals(recording(odometry("vsense/odometry", seconds, vx=np.array([1.0, 2.0, 3.0, 4.0]))), "vsense")
    assert found["longitudinal_velocity"].value[:, 0] == pytest.approx([1.0, 4.0, 3.0])


def test_topics_are_found_below_a_namespace():
    seconds = np.arange(0.0, 5.0, 0.1)
    assert "speed" in read_signals(recording(odometry("/car_7/vsense/odometry", seconds)), "vsense")


def test_what_has_no_reference_is_named():
    seconds = np.arange(0.0, 5.0, 0.1)
    output = slalom("vsense", duration=5.0)
    slip = channel("vsense/wheel_slip/fl", "geometry_msgs/msg/Vector3Stamped", seconds, {"vector": np.zeros((50, 3))})
    output = recording(*output.channels.values(), slip)
    missing = without_reference(output, compare(output, recording(odometry("reference/odometry", seconds))))
    assert {"wheel_force_rr_z", "lateral_acceleration", "wheel_slip_fl"} <= set(missing)
    assert "speed" not in missing


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_undo_the_rotations_they_are_defined_by(roll, pitch, yaw):
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation.from_euler("ZYX", [yaw, pitch, roll])
    found = np.array(euler_angles(rotation.as_quat()[None, :])).ravel()
    assert found == pytest.approx([roll, pitch, yaw], abs=1e-6)


def test_shares_within_two_deviations_and_nees_are_those_of_the_normal_distribution():
    random, seconds = np.random.default_rng(4), np.arange(0.0, 400.0, 0.05)
    truth = Series(SIGNALS["speed"], (START + seconds * 1e9).astype(np.int64), np.zeros((len(seconds), 1)))
    deviation = random.uniform(0.1, 3.0, len(seconds))
    error = deviation * random.normal(size=len(seconds))
    found = score(replace(truth, value=error[:, None], deviation=deviation), truth)
    assert found.within_2s == pytest.approx(chi2.cdf(4.0, 1), abs=0.01)
    assert found.nees == pytest.approx(1.0, abs=0.08)
    too_sure = score(replace(truth, value=error[:, None], deviation=deviation / 3), truth)
    assert too_sure.within_2s == pytest.approx(chi2.cdf(4.0 / 9.0, 1), abs=0.02)
    assert too_sure.nees == pytest.approx(9.0 * found.nees)
    assert score(replace(truth, value=error[:, None]), truth).nees is None


def test_a_heading_that_the_filter_does_not_know_is_not_scored():
    seconds = np.arange(0.0, 10.0, 0.1)
    truth = read_signals(recording(odometry("reference/odometry", seconds)), "reference")["yaw"]
    unknown = seconds < 4.0
    estimate = replace(
        truth,
        value=np.where(unknown, 2.0, 0.01)[:, None],
        deviation=np.where(unknown, np.pi, 0.02),
    )
    found = score(estimate, truth)
    assert found.rmse == pytest.approx(0.01)
    assert found.known_share == pytest.approx(0.6)
    assert found.nees == pytest.approx(0.25)
    assert score(replace(estimate, deviation=np.full(len(seconds), np.pi)), truth) is None


def test_an_interruption_of_frequent_estimates_is_not_bridged():
    seconds = np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(2.3, 5.0, 0.01)])
    truth = series(np.arange(0.0, 4.95, 0.05), np.zeros(99))
    covered = (align(series(seconds, np.zeros(len(seconds))), truth).stamp - START) * 1e-9
    assert not np.any((covered > 1.991) & (covered < 2.299))
    assert len(covered) == 93  # 2.00 to 2.25 s are missing


@given(gap=st.floats(0.2, 5.0), at=st.integers(1, 4999), seed=st.integers(0, 100), points=st.sampled_from([50, 5000]))
def test_a_drawn_curve_keeps_its_extremes_and_is_interrupted_where_the_signal_is(gap, at, seed, points):
    seconds = np.arange(points) * 0.01
    at = at % (points - 1) + 1
    seconds[at:] += gap
    value = np.random.default_rng(seed).normal(size=points)
    stamp = START + np.round(seconds * 1e9).astype(np.int64)
    time, drawn, doubled = curve(stamp, START, value, 2.0 * value)
    assert np.all(np.diff(time) > 0)
    assert np.nanmin(drawn) == value.min()
    assert np.nanmax(drawn) == value.max()
    assert np.array_equal(doubled, 2.0 * drawn, equal_nan=True)
    (interrupted,) = np.flatnonzero(np.isnan(drawn))
    assert time[interrupted - 1] == pytest.approx(seconds[at - 1])
    assert time[interrupted + 1] == pytest.approx(seconds[at])
