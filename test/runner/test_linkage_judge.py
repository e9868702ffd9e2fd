"""What is not known of a steering linkage: nothing at small angles, and its error at large ones."""

from __future__ import annotations

from math import sin
from types import SimpleNamespace
from typing import Any, cast

import pytest

from vsense_ros.model.sensors import Steering
from vsense_ros.runner.linkage_judge import LinkageJudge

ERROR = 47  # element of the state


def widened(*angles: float) -> float:
    """Variance that the steering's error has been given when the wheels were turned to these angles in turn [rad²]."""
    adapter = SimpleNamespace(sensors={"steering": Steering()}, steering_error=ERROR, steering_angle=0.0)
    judge, events = LinkageJudge(cast("Any", adapter), 9), []
    timeline = SimpleNamespace(stamp=0, add=events.append)
    for angle in angles:
        adapter.steering_angle = angle
        judge.settle(cast("Any", timeline))
    assert all(event.sensor == 9 and event.value[0] == ERROR for event in events)
    return float(sum(event.value[1] for event in events))


def test_a_linkage_at_its_stop_may_be_off_by_what_a_sine_differs_from_its_angle():
    outwards = [0.005 * step for step in range(121)]
    assert widened(*outwards) ** 0.5 == pytest.approx(0.6 - sin(0.6), rel=0.03)


def test_wheels_that_turn_as_on_a_road_leave_the_steering_as_certain_as_it_was():
    assert widened(*[0.005 * step for step in range(25)]) == 0.0


def test_on_the_way_back_the_error_may_change_as_much_as_on_the_way_out():
    out = [0.005 * step for step in range(121)]
    assert widened(*out, *reversed(out)) == pytest.approx(2 * widened(*out), rel=1e-3)
