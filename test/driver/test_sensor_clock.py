"""Times of measurement from the clock of a sensor or an adapter, however late its messages are read."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver.sensor_clock import SETTINGS, SensorClock

MS = 1_000_000
START = 1_700_000_000_000 * MS
WRAP = 60_000  # [ms]


def stamps(clock: SensorClock, delays: list[int]) -> list[int]:
    """Errors [ms] of the times of frames that are sent every 10 ms and read after these delays [ms]."""
    errors = []
    for i, delay in enumerate(delays):
        sent = START + 10 * MS * i
        errors.append((clock.stamp((59_000 + 10 * i) % WRAP, sent + delay * MS) - sent) // MS)
    return errors


@given(delays=st.lists(st.integers(0, 3_000), min_size=1, max_size=300))
def test_frames_that_are_read_late_by_seconds_keep_the_time_at_which_the_adapter_took_them(delays: list[int]) -> None:
    clock = SensorClock(MS, WRAP, lambda *_: None, replace(SETTINGS, late_for=10_000 * MS))
    errors = stamps(clock, [0, *delays])
    assert max(map(abs, errors)) <= 1  # the clocks may drift apart by 1e-4, which is 0.3 ms here


@pytest.mark.parametrize("late_for", [1_000, 10_000])
def test_where_all_frames_come_late_for_long_our_clock_was_set(late_for: int) -> None:
    said: list[str] = []
    clock = SensorClock(MS, WRAP, lambda sentence, _: said.append(sentence), replace(SETTINGS, late_for=late_for * MS))
    errors = stamps(clock, [0] * 100 + [500] * (late_for // 10 + 100))
    assert errors[100:150] == [0] * 50
    assert errors[-10:] == [500] * 10
    assert said == ["clock was set to another time"]
