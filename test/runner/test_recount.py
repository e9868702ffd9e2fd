"""Who may be left out by a recount."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from vsense_ros.runner.recount import Ballot, Recount
from vsense_ros.runner.vote_settings import VOTE

YAW_RATE, LATERAL = 2, 4


class Counted(Recount):
    """A recount of which the result is known: all is gained without the yaw rate, `by_place` of it by GNSS."""

    def __init__(self, by_place: float) -> None:
        sums = SimpleNamespace(far=lambda: np.full((4, 6), 10.0))
        self._of: Any = SimpleNamespace(index=0, present=[YAW_RATE, LATERAL], out={}, words=tuple("pqrxyz"), sums=sums)
        self._axes = {0: self._of}
        self._by_place = by_place

    def without(self, axes: Any, left: list[int]) -> Ballot:
        gain = 300.0 if left == [YAW_RATE] else -10.0
        return Ballot(gain, 1.0, axes, left, by_place=self._by_place if left == [YAW_RATE] else 0.0)


def tried(by_place: float, confirmed: set[tuple[int, int]]) -> list[list[int]]:
    return [ballot.left for ballot in Counted(by_place).ballots(confirmed)]


def test_an_axis_that_a_witness_confirms_is_not_left_out_because_of_what_the_model_says() -> None:
    assert [YAW_RATE] not in tried(0.5 * VOTE.gain, {(0, YAW_RATE)})
    assert [YAW_RATE] in tried(0.5 * VOTE.gain, set())


def test_an_axis_that_a_course_confirms_within_wide_margins_is_left_out_where_gnss_itself_says_otherwise() -> None:
    assert [YAW_RATE] in tried(1.1 * VOTE.gain, {(0, YAW_RATE)})
