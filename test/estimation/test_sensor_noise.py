"""Readings get the variance that they show among themselves, where that is larger than what is stated."""

from __future__ import annotations

import numpy as np
import pytest

from sources import SECOND
from vsense_ros.estimation.sensor_noise import SETTINGS, SensorNoise
from vsense_ros.estimation.timeline import Event

STATED = np.array([0.1, 0.1])  # standard deviations
PERIOD = SECOND // 100


def events(deviations: tuple[float, float], count: int, seed: int = 1) -> list[Event]:
    values = np.array(deviations) * np.random.default_rng(seed).standard_normal((count, 2))
    return [Event(0, k * PERIOD, value, STATED**2) for k, value in enumerate(values)]


def heard(noise: SensorNoise, some: list[Event]) -> np.ndarray:
    for event in some:
        noise.hear(event)
    return np.sqrt([event.variance for event in some])


def test_a_noisy_component_gets_its_own_variance_and_the_other_one_what_is_stated():
    used = heard(SensorNoise(), events((4.4, 0.05), 2000))
    assert used[-1, 0] == pytest.approx(4.4, rel=0.2)
    assert np.all(used[:, 1] == STATED[1])


def test_a_sensor_as_good_as_it_says_keeps_the_very_variance_of_its_messages():
    some = events((0.05, 0.05), 1000)
    stated = [event.variance for event in some]
    noise = SensorNoise()
    heard(noise, some)
    assert all(event.variance is variance for event, variance in zip(some, stated, strict=True))
    assert not noise.noisier


@pytest.mark.parametrize("hertz", [6.0, 9.0, 12.0, 25.0])
@pytest.mark.parametrize("rate", [100, 250])
def test_a_vibration_is_noise_and_what_a_car_does_is_none(hertz, rate):
    t = np.arange(4 * rate) / rate
    motion = 5.0 * np.sin(2 * np.pi * 0.7 * t) + 10.0 * (t > 2.0)  # a slalom, and a jump
    values = np.column_stack([motion + 3.0 * np.sin(2 * np.pi * hertz * t), motion])
    some = [Event(0, k * SECOND // rate, value, STATED**2) for k, value in enumerate(values)]
    used = heard(SensorNoise(), some)
    assert np.all((used[rate:, 0] > 0.3 * 3.0 / 2**0.5) & (used[rate:, 0] < 1.5 * 3.0 / 2**0.5))
    assert np.all(used[:, 1] == STATED[1])


def test_a_sensor_that_is_quiet_again_is_believed_again():
    noise = SensorNoise()
    loud, quiet = events((4.0, 0.05), 1000), events((0.05, 0.05), 3 * SETTINGS.window, seed=2)
    heard(noise, loud)
    assert noise.noisier[0] == pytest.approx((4.0, 0.1), rel=0.2)
    assert heard(noise, quiet)[-1] == pytest.approx(STATED)


def test_an_offset_a_drift_and_a_jump_are_left_to_those_who_judge():
    some = events((0.05, 0.05), 1000)
    for k, event in enumerate(some):
        event.value = event.value + np.array([5.0 if k > 500 else 0.0, 0.01 * k])
    assert np.all(heard(SensorNoise(), some) == STATED)


def test_noise_is_awaited_from_the_first_reading_until_it_is_known_but_not_for_long():
    noise = SensorNoise()
    assert not noise.awaited(0)
    some = events((1.0, 1.0), SETTINGS.first)
    heard(noise, some[:-1])
    assert noise.awaited(some[-2].stamp)
    assert not noise.awaited(SETTINGS.longest)
    heard(noise, some[-1:])
    assert not noise.awaited(some[-1].stamp)


def test_a_reading_from_elsewhere_in_time_or_one_that_was_overtaken_changes_no_estimate():
    some = events((1.0, 1.0), 600)
    strays = [Event(0, some[300].stamp + away, np.array([9.0, 9.0]), STATED**2) for away in (-7 * SECOND, -1, SECOND)]
    usual = heard(SensorNoise(), some)
    again = events((1.0, 1.0), 600)
    heard(SensorNoise(), [*again[:301], *strays, *again[301:]])
    assert np.array_equal(np.sqrt([event.variance for event in again]), usual)


def test_a_clock_that_was_set_begins_a_new_series():
    noise = SensorNoise()
    heard(noise, events((4.0, 0.05), 1000))
    later = events((0.05, 0.05), 2 * SETTINGS.first + 1, seed=3)
    for event in later:
        event.stamp += 3600 * SECOND
    assert heard(noise, later)[-1] == pytest.approx(STATED)
