"""Why the errorEKF leaves its place: a drive of the study, with its table."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

import vsense_ros as vs
from studies import thesis_causes
from studies.thesis_causes import causes, show
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES


@pytest.mark.slow
def test_errors_of_forces_that_turn_the_body_let_roll_say_what_it_is_and_both_state_their_drift(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(thesis_causes, "MANOEUVRES", MANOEUVRES[:1])
    monkeypatch.setattr(thesis_causes, "_TRUE", {"all true": ("chassis.mass", "road.friction")})
    drifts = causes(vs.load_vehicle("prototype_real"), vs.load_vehicle("prototype_model"))
    (turning,), (still,) = drifts["all true", True], drifts["all true", False]
    assert turning.roll < 0.5 * still.roll  # else roll takes up what the forces lack
    for drift in (turning, still):
        assert abs(drift.lateral_velocity) < 3 * drift.deviation
        assert drift.position < 0.05
    show(drifts, console := Console(file=io.StringIO()))
    rows = console.file.getvalue().splitlines()
    assert [row.split()[:3] for row in rows[1:]] == [["all", "true", "yes"], ["all", "true", "no"]]
