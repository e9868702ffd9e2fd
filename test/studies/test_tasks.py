"""Work that is cut into tasks: every result is there, in its place, however many processes do it."""

from __future__ import annotations

import operator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.tasks import Failed, Task, in_turn, kept, pool


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


def count(path: Path) -> int:
    """How often it was called with this file."""
    path.write_text(path.read_text() + "x" if path.exists() else "x")
    return len(path.read_text())


def test_what_was_done_is_taken_from_its_folder_and_one_that_fails_stops_no_other(tmp_path: Path) -> None:
    tasks = {"fails": Task(1.0, operator.truediv, (1, 0)), "counts": Task(1.0, count, (tmp_path / "calls",))}
    for _ in range(2):
        failed, counted = in_turn(kept(tasks, tmp_path / "parts"), lambda share: None)
        assert isinstance(failed, Failed)
        assert "ZeroDivisionError" in failed.error
        assert counted == 1
