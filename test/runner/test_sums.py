"""Sums of whitened innovations, against those of a list, and how well a place is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.runner.placement import Place, Placement
from vsense_ros.runner.sums import SHORT, WINDOWS, Sums
from vsense_ros.runner.vote_settings import VOTE

SECOND = 1_000_000_000
BLOCK = VOTE.block


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 100), blocks=st.integers(1, 130), each=st.integers(1, 4), conditions=st.integers(0, 2))
def test_sums_are_those_of_the_innovations_of_the_last_blocks(seed, blocks, each, conditions):
    rng = np.random.default_rng(seed)
    sums, m = Sums(2, conditions), 2 + conditions
    history = []
    for block in range(blocks):
        rows = rng.normal(size=(each, m))
        rows[rng.random(rows.shape) < 0.1] = np.nan
        for i, row in enumerate(rows):
            # The last message of a block is that which comes when its time is over.
            stamp = (block + 1) * BLOCK if i == each - 1 else block * BLOCK + i
            sums.add(stamp, row)
        history.append(rows)
    if each > 1:
        for place, window in enumerate(WINDOWS):
            last = np.concatenate(history[1:][-window:]) if blocks > 1 else None
            if last is None or blocks <= window:
                continue
            np.testing.assert_allclose(sums.totals[place], np.nansum(last, axis=0), atol=1e-9)
            np.testing.assert_array_equal(sums.counts[place], np.isfinite(last).sum(axis=0))


def test_how_far_a_sum_is_counts_in_what_it_usually_is():
    sums = Sums(2)
    for i in range(60):
        sums.add((i + 1) * BLOCK, np.array([1.0, -0.5]))
    assert sums.far()[:, 0] == pytest.approx(np.sqrt(WINDOWS / sums.usual[:, 0]))
    assert sums.far()[:, 1] == pytest.approx(0.5 * np.sqrt(WINDOWS / sums.usual[:, 1]))
    assert WINDOWS[SHORT] * BLOCK == 0.2 * SECOND


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("share", "alarmed"), [(0.98, False), (1.02, True)])
def test_it_raises_an_alarm_where_a_sum_is_farther_than_the_limit(sign, share, alarmed):
    sums = Sums(1)
    value = sign * share * VOTE.alarm / np.sqrt(10)  # the sum of ten is then this share of the limit
    found = [sums.add((i + 1) * BLOCK, np.array([value])) for i in range(10)]
    assert found == [False] * 9 + [alarmed]


def test_conditions_have_a_limit_of_their_own():
    sums = Sums(1, 1)
    assert not sums.add(BLOCK, np.array([0.0, VOTE.alarm + 1.0]))
    assert sums.add(2 * BLOCK, np.array([0.0, VOTE.alarm_of_conditions * 1.5]))


def test_within_a_block_nothing_is_judged_unless_it_is_full():
    sums = Sums(1)
    sums.add(0, np.array([0.0]))
    loud = np.array([100.0])
    assert not sums.add(BLOCK // 2, loud)
    assert sums.add(BLOCK, loud)
    full = Sums(1)
    full.add(0, np.array([0.0]))
    found = [full.add(1, loud) for _ in range(VOTE.rows)]
    assert found == [False] * (VOTE.rows - 1) + [True]


def test_what_is_forgotten_is_in_no_sum():
    sums = Sums(2)
    for i in range(20):
        sums.add((i + 1) * BLOCK, np.array([1.0, 2.0]))
    assert sums.begun
    sums.forget(0)
    assert sums.totals[:, 0].tolist() == [0.0] * 4
    assert sums.counts[:, 0].tolist() == [0.0] * 4
    sums.add(21 * BLOCK, np.array([1.0, 2.0]))
    assert sums.totals[:, 0].tolist() == [1.0] * 4
    assert sums.totals[SHORT, 1] == pytest.approx(20.0)
    sums.clear()
    assert not sums.begun
    assert not sums.totals.any()
    sums.add(22 * BLOCK, np.array([1.0, 2.0]))
    assert sums.counts.tolist() == [[1.0, 1.0]] * 4


def test_what_sums_usually_are_is_estimated_within_a_minute_and_not_from_a_single_large_one():
    rng, blocks = np.random.default_rng(1), 60 * SECOND // BLOCK
    sums, coloured = Sums(2), 0.0
    for i in range(blocks):
        coloured = 0.9 * coloured + rng.normal()  # of variance 1/(1 - 0.9²)
        sums.add((i + 1) * BLOCK, np.array([rng.normal(), coloured]))
    assert sums.usual[:, 0] == pytest.approx(np.ones(4), abs=0.8)
    assert sums.usual[0, 1] == pytest.approx(1 / (1 - 0.81), rel=0.4)
    before = sums.usual.copy()
    for i in range(10):
        sums.add((blocks + i + 1) * BLOCK, np.array([100.0, 0.0]))
    assert np.all(sums.usual[:, 0] < 1.1 * before[:, 0])
    assert sums.far()[0, 0] > 50.0


def believed(*seconds: float) -> Placement:
    place = Placement()
    for one in seconds:
        place.believed(round(one * SECOND))
    return place


def at(place: Placement, seconds: float) -> Place:
    return place.at(round(seconds * SECOND))


def test_a_place_is_measured_then_reckoned_then_lost():
    place = believed(*np.arange(10.0, 20.01, 0.1))
    assert at(Placement(), 10.0) is Place.NEVER
    assert [at(place, 20.0 + age) for age in (0.0, 0.99, 1.01, 4.9, 5.1)] == [
        Place.KNOWN, Place.KNOWN, Place.RECKONED, Place.RECKONED, Place.LOST,
    ]  # fmt: skip
    assert place.age(23 * SECOND) == pytest.approx(3.0)


def test_a_slow_sensor_may_be_silent_for_ten_of_its_periods():
    place = believed(*np.arange(10.0, 20.01, 0.25))
    assert [at(place, 20.0 + age) for age in (2.4, 2.6)] == [Place.KNOWN, Place.RECKONED]
    very_slow = believed(*np.arange(10.0, 30.01, 0.9))
    assert at(very_slow, 29.8 + 4.9) is Place.KNOWN
    assert at(very_slow, 29.8 + 5.1) is Place.LOST


def test_a_sensor_that_comes_back_is_believed_again_after_five_steady_seconds():
    before, after = np.arange(10.0, 12.01, 0.1), np.arange(20.0, 25.01, 0.1)
    place = believed(*before, *after[:40])
    assert at(place, 24.0) is Place.RECKONED
    place = believed(*before, *after)
    assert at(place, 25.0) is Place.KNOWN
    place = believed(*before, *after[:20], *(after[:20] + 5.0))
    assert at(place, 27.0) is Place.RECKONED
    place.forget()
    assert at(place, 27.0) is Place.NEVER
    place.believed(27 * SECOND)
    assert at(place, 27.1) is Place.KNOWN


def test_a_position_that_comes_late_does_not_make_the_last_one_older():
    place = believed(*np.arange(10.0, 12.01, 0.1), 11.5)
    assert place.age(13 * SECOND) == pytest.approx(1.0, abs=0.01)
