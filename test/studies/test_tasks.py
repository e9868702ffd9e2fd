"""Work that is cut into tasks: every result is there, in its place, however many processes do it."""

from __future__ import annotations

import operator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.tasks import Task, in_turn, pool


@given(st.lists(st.tuples(st.floats(0.1, 100.0), st.integers()), max_size=20))
def test_results_stand_in_the_order_of_their_tasks_and_progress_ends_at_all(jobs: list[tuple[float, int]]) -> None:
    shares: list[float] = []
    tasks = [Task(seconds, operator.neg, (value,)) for seconds, value in jobs]
    assert in_turn(tasks, shares.append) == [-value for _, value in jobs]
    assert shares == sorted(shares)
    assert len(shares) == len(jobs)
    assert not shares or shares[-1] == pytest.approx(1.0)


@pytest.mark.slow
def test_two_processes_give_what_one_gives() -> None:
    tasks = [Task(float(1 + i % 3), operator.mul, (i, 7)) for i in range(9)]
    shares: list[float] = []
    with pool(2) as side_by_side, pool(1) as alone:
        assert side_by_side(tasks, shares.append) == alone(tasks, lambda share: None) == [7 * i for i in range(9)]
    assert shares[-1] == pytest.approx(1.0)


@pytest.mark.slow
def test_a_task_that_fails_is_told_as_by_one_process() -> None:
    with pool(2) as do_tasks, pytest.raises(ZeroDivisionError):
        do_tasks([Task(1.0, operator.truediv, (1, 0))], lambda share: None)
