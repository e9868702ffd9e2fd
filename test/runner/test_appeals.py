"""Appeals of axes that are out: who is believed again, and what is usual of them from then on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from vsense_ros.runner.appeal import Appeals
from vsense_ros.runner.axes import Axes, Out
from vsense_ros.runner.recount import Belief
from vsense_ros.runner.vote_settings import VOTE

SECOND = 1_000_000_000


def axes_without(far: float) -> Axes:
    """A sensor of two axes, the first of which was left out when its sums were so far."""
    axes = Axes(0, cast("Any", SimpleNamespace(name="imu")), ("x", "y"), (0, 1), 0, 16.0)
    axes.leave_out(0, Out(0, "contradicts the others", 0, far=np.full(4, far)))
    return axes


def after_a_second(belief: Belief, far: float = 5.0) -> Axes:
    """The sensor after an appeal at which that follows from believing the axis."""
    axes = axes_without(far)
    timeline = SimpleNamespace(stamp=3 * SECOND // 2, rewind=lambda _: [])
    recount = SimpleNamespace(believing=lambda *_: belief)
    Appeals({0: axes}, [], lambda *_: None).hear(cast("Any", timeline), cast("Any", lambda *_: recount))
    return axes


@pytest.mark.parametrize(
    ("gain", "own", "believed"),
    [(20.0, 9.0, True), (-5.0, 1.0, True), (-5.0, 9.0, False), (-25.0, 1.0, False)],
    ids=["others gain", "it agrees", "it does not agree", "others lose as much as makes one suspect"],
)
def test_an_axis_is_believed_again_if_others_gain_or_if_it_agrees_and_they_lose_little(gain, own, believed):
    assert (0 not in after_a_second(Belief(gain, own)).out) is believed


@pytest.mark.parametrize(("far", "usual"), [(2.0, 1.0), (6.0, 4.0), (30.0, VOTE.usual_at_most**2)])
def test_what_an_axis_was_accused_of_is_usual_then_but_not_without_bound(far, usual):
    sums = after_a_second(Belief(20.0, 1.0), far).sums
    assert sums.usual[:, 0] == pytest.approx(np.full(4, usual))
    assert sums.usual[:, 1] == pytest.approx(np.ones(4))
