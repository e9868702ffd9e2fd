"""Stamps of arrival after a hold-up are noticed by the period of a sensor, and true stamps are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vsense_ros.estimation.punctuality import SETTINGS, Punctuality

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
PERIODS = [0.004, 0.012, 0.02, 0.1]


def lateness(stamps: NDArray[np.float64]) -> NDArray[np.float64]:
    """What is said of the stamps [s] of a sensor, one by one [s]."""
    judge = Punctuality()
    return np.array([judge.lateness(START + round(stamp * SECOND)) for stamp in stamps])


def read(sent: NDArray[np.float64], begin: float, length: float) -> NDArray[np.float64]:
    """When readings are read that were sent at these times [s], by a driver that is held up once."""
    held = (sent >= begin) & (sent < begin + length)
    return np.where(held, begin + length + 2e-5 * np.cumsum(held), sent)


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("length", [0.3, 1.0, 3.0])
def test_no_reading_that_was_stamped_late_is_believed_and_soon_all_others_are(period: float, length: float) -> None:
    sent = np.arange(0.0, 20.0, period)
    stamped = read(sent, 8.0, length)
    late, refused = stamped - sent, lateness(stamped) > 0
    limit = max(SETTINGS.lateness, SETTINGS.periods * period) + SETTINGS.forgiven * length
    assert not (refused & (sent < 8.0)).any()
    assert refused[late > limit + period].all()
    assert not refused[sent > 8.0 + length + SETTINGS.after_burst + 5 * period].any()


@given(
    period=st.sampled_from(PERIODS),
    jitter=st.floats(0.0, 0.3),
    lost=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**16),
)
def test_jitter_and_loss_that_are_usual_are_no_hold_up(period: float, jitter: float, lost: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    sent = np.arange(0.0, 600 * period, period)
    sent = sent[random.random(len(sent)) >= lost]
    assert (lateness(np.sort(sent + period * jitter * random.random(len(sent)))) > 0).mean() < 0.03 + lost


@pytest.mark.parametrize("period", PERIODS)
def test_after_a_silence_a_few_readings_are_in_doubt_without_a_burst(period: float) -> None:
    sent = np.concatenate((np.arange(0.0, 10.0, period), np.arange(13.0, 20.0, period)))
    judge, doubtful = Punctuality(), []
    for time in sent:
        if judge.lateness(START + round(time * SECOND)) > 0:
            doubtful.append(time)
        assert not judge.is_burst
    assert doubtful
    assert min(doubtful) >= 13.0
    assert max(doubtful) < 13.0 + max(SETTINGS.enough, SETTINGS.fewest * period) + 0.5 * period


@given(longest=st.floats(0.02, 1.0), seed=st.integers(0, 2**16))
def test_stamps_in_another_order_than_that_of_arrival_are_none_of_arrival(longest: float, seed: int) -> None:
    sent = np.arange(0.0, 10.0, 0.01)
    arrival = sent + np.random.default_rng(seed).uniform(0.0, longest, len(sent)) * (sent > 2.0)
    judge = Punctuality()
    for time in sent[np.argsort(arrival, kind="stable")]:
        judge.lateness(START + round(time * SECOND))
        assert not judge.is_burst


@given(factor=st.sampled_from([0.02, 0.1, 0.3, 0.5, 2.0, 3.0, 10.0, 30.0]), seed=st.integers(0, 2**16))
def test_a_sensor_that_sends_at_another_rate_from_now_on_is_believed(factor: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    intervals = np.concatenate((np.full(400, 0.01), np.full(1000, 0.01 * factor))) * random.uniform(0.9, 1.1, 1400)
    assert not (lateness(np.cumsum(intervals))[-700:] > 0).any()


@pytest.mark.parametrize("factor", [0.02, 0.1, 1.0, 10.0, 30.0])
def test_a_sensor_that_comes_back_at_another_rate_is_believed_again(factor: float) -> None:
    stamps = np.concatenate((np.arange(0.0, 5.0, 0.01), np.arange(7.0, 60.0, 0.01 * factor)))
    doubted = stamps[lateness(stamps) > 0]
    assert doubted.max() < 7.0 + SETTINGS.longest_burst + 0.01 * factor


@given(seed=st.integers(0, 2**16))
def test_a_sensor_that_sends_when_it_likes_is_not_judged(seed: int) -> None:
    intervals = np.random.default_rng(seed).exponential(0.02, 2000)
    assert (lateness(np.cumsum(intervals)) > 0).mean() < 0.02


def test_stamps_that_go_back_or_repeat_are_left_to_others() -> None:
    stamps = np.arange(0.0, 2.0, 0.01)
    stamps[100:110] -= 0.5
    stamps[150:155] = stamps[149]
    said = lateness(stamps)
    assert not said[100:110].any()
    assert not said[150:155].any()
