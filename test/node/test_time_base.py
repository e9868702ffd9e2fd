"""Wall time to the time of a replay."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vsense_ros.node.time_base import Arrivals, TimeBase

MS = 1_000_000
START = 1_500_000_000_000 * MS


def test_without_a_simulated_clock_wall_time_is_the_time() -> None:
    assert TimeBase(simulated=False).at(123) == 123


def test_before_the_first_tick_there_is_no_time() -> None:
    assert TimeBase(simulated=True).now() is None


@given(
    rate=st.sampled_from([0.5, 1.0, 3.0]),
    delays=st.lists(st.integers(0, 8), min_size=150, max_size=150),
)
def test_ticks_that_come_late_do_not_shift_the_time(rate: float, delays: list[int]) -> None:
    base = TimeBase(simulated=True)
    delays[::10] = [0] * len(delays[::10])
    for i, delay in enumerate(delays):
        base.tick(START + round(10 * MS * i * rate), wall=10 * MS * i + delay * MS)
    wall = 10 * MS * len(delays)
    # The rate is known to the delay of one tick in all of them, the offset to the promptest tick of the last 0.64 s.
    assert base.at(wall) == pytest.approx(START + wall * rate, abs=rate * 4 * MS)


def test_a_jump_of_the_clock_is_followed_at_once() -> None:
    base = TimeBase(simulated=True)
    for i in range(100):
        base.tick(START + 10 * MS * i, wall=10 * MS * i)
    base.tick(START - 3_600_000 * MS, wall=1000 * MS)
    assert base.at(1005 * MS) == START - 3_600_000 * MS + 5 * MS


@given(begin=st.integers(60, 90), length=st.integers(6, 60))
def test_a_process_that_gets_its_ticks_in_one_go_does_not_set_its_time_back(begin: int, length: int) -> None:
    base = TimeBase(simulated=True)
    times = []
    for i in range(200):
        held_up = begin <= i < begin + length
        base.tick(START + 10 * MS * i, wall=10 * MS * (begin + length if held_up else i) + held_up * (i - begin))
        if not held_up:
            times.append(base.at(10 * MS * i))
    assert times == sorted(times)
    assert base.at(2000 * MS) == START + 2000 * MS


@given(length=st.integers(90, 800), spacing=st.floats(0.01, 0.9))
def test_what_arrives_while_a_process_is_held_up_for_seconds_is_never_dated_too_early(
    length: int, spacing: float
) -> None:
    base, early = TimeBase(simulated=True), []
    wall = 0
    for i in range(1000):
        wall = max(10 * MS * (100 + length), wall + round(spacing * MS)) if i >= 100 else 10 * MS * i
        wall = max(wall, 10 * MS * i)
        base.tick(START + 10 * MS * i, wall=wall)
        if i > 10:
            at = base.at(wall)
            assert at is not None
            early.append(START + wall - at)
    assert max(early) < MS


def test_a_clock_that_is_told_to_stand_still_is_followed_at_once() -> None:
    base = TimeBase(simulated=True)
    for i in range(100):
        base.tick(START + 10 * MS * i, wall=10 * MS * i)
    base.tick(START + 990 * MS, wall=1500 * MS)  # as a replay does where it goes on after a pause
    base.tick(START + 1000 * MS, wall=1510 * MS)
    assert base.at(1515 * MS) == START + 1005 * MS


@pytest.mark.parametrize("pause", [80, 400, 3000])
def test_a_clock_that_was_paused_is_followed(pause: int) -> None:
    base = TimeBase(simulated=True)
    for i in range(200):
        base.tick(START + 10 * MS * i, wall=10 * MS * i + (pause * MS if i >= 100 else 0))
    assert base.at((2000 + pause) * MS) == START + 2000 * MS


@example(waited=123, rate=0.5, spacing=0.19921875)
@given(waited=st.integers(6, 150), rate=st.sampled_from([0.5, 1.0, 3.0]), spacing=st.floats(0.01, 0.2))
def test_ticks_that_have_waited_for_a_process_leave_neither_a_wrong_time_nor_a_wrong_rate(
    waited: int, rate: float, spacing: float
) -> None:
    base = TimeBase(simulated=True)
    wall = 0
    for i in range(-waited, 60):
        wall = max(wall + round(spacing * MS), 10 * MS * i)
        base.tick(START + round(10 * MS * i * rate), wall=wall)
        if base.settled(wall) and (rate == 1.0 or i > 40):
            assert base.at(wall) == pytest.approx(START + wall * rate, abs=0.5 * MS)


@given(before=st.integers(0, 30), after=st.integers(51, 60), waiting=st.integers(0, 80))
def test_what_arrives_before_the_time_is_known_is_dated_later_and_not_lost(
    before: int, after: int, waiting: int
) -> None:
    base, arrivals = TimeBase(simulated=True), Arrivals[int]()
    dated: list[tuple[int, int]] = []
    for i in range(before + after):
        if i == before:
            for k in range(-waiting, 1):
                base.tick(START + (i + 10 * k) * MS, wall=i * MS)
        arrivals.add(i, i * MS)
        dated += arrivals.dated(i * MS, base)
    assert dated == [(i, START + i * MS) for i in range(before + after)]
    assert arrivals.dropped == 0


def test_of_what_arrives_without_a_clock_a_second_is_kept_and_the_rest_counted() -> None:
    base, arrivals = TimeBase(simulated=True), Arrivals[bytes](len)
    dated: list[int] = []
    for i in range(301):
        if i == 295:
            base.tick(START, wall=2950 * MS)
        arrivals.add(b"ab", 10 * MS * i)
        dated += (at - START for _, at in arrivals.dated(10 * MS * i, base))
    assert dated == list(range(-1010 * MS, 51 * MS, 10 * MS))
    assert arrivals.dropped == len(b"ab") * (301 - len(dated))


def test_at_the_end_of_the_reading_all_is_dated_that_can_be() -> None:
    base, arrivals = TimeBase(simulated=True), Arrivals[bytes](len)
    arrivals.add(b"before any clock", 0)
    assert not list(arrivals.dated(MS, base, at_the_end=True))
    assert arrivals.dropped == len(b"before any clock")
    base.tick(START, wall=2 * MS)
    arrivals.add(b"last", 3 * MS)
    assert not list(arrivals.dated(3 * MS, base))
    assert list(arrivals.dated(3 * MS, base, at_the_end=True)) == [(b"last", START + MS)]


@pytest.mark.parametrize("standing", [10, 1000])
def test_a_clock_that_stands_still_and_then_runs_unseen_tells_no_time_of_its_own(standing: int) -> None:
    base, arrivals = TimeBase(simulated=True), Arrivals[str]()
    for i in range(standing):
        base.tick(START, wall=2 * MS * i)
    held_up = 2 * MS * standing + 900 * MS
    arrivals.add("frame", held_up)
    assert not list(arrivals.dated(held_up, base))
    for i in range(81):
        base.tick(START + 10 * MS * i, wall=held_up + MS)
    assert list(arrivals.dated(held_up + 60 * MS, base)) == [("frame", START + 799 * MS)]
