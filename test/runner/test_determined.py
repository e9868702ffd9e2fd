"""What a drive tells a filter: a straight one little, a winding one the rest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sine_drive import SineDrive, without_velocity
from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.runner.determined import determined_by
from vsense_ros.runner.run import run


@pytest.fixture(scope="module")
def car():
    return load_vehicle(vehicle_path("prototype_model"))


@pytest.fixture(scope="module")
def winding():
    return SineDrive(30.0).recording()


def test_a_winding_drive_tells_how_the_body_rolls_and_a_straight_one_does_not(car, winding):
    after_turns = {state.name: state for state in determined_by(winding, car, "inertial").states}
    straight = {state.name: state for state in determined_by(winding.between(0.0, 7.5), car, "inertial").states}
    assert after_turns["roll_gain"].motion == "turning"
    assert after_turns["roll_gain"].determined_at > 8.0  # [s] where the turns begin
    assert straight["roll_gain"].determined_at is None
    assert straight["gyro_bias"].determined_at is not None
    assert straight["gyro_bias"].motion == "going straight"


def test_directions_that_were_not_told_are_named_by_their_states(car, winding):
    found = determined_by(winding.between(0.0, 7.5), car, "inertial")
    named = " ".join(str(one) for one in found.undetermined)
    assert "rear_distance" in named
    assert "rear_slip" in named
    assert "gyro_bias" not in named


def test_deviations_at_the_end_are_those_that_the_filter_states_when_it_runs(car, winding):
    found = {state.name: state for state in determined_by(winding, car, "inertial").states}
    stated = run(winding, car, "inertial").parameters
    for name, (_, deviation) in stated.items():
        assert found[name].after == pytest.approx(deviation, rel=0.05)


def test_of_a_cascade_the_states_of_all_its_filters_are_told(car, winding):
    found = determined_by(winding, car, "dual_kkf")
    assert found.undetermined is None
    assert {"heading.yaw", "velocity.forward_velocity"} <= {state.name for state in found.states}
    assert all(np.isfinite(state.after) for state in found.states)


def test_a_drive_on_which_the_filter_never_starts_is_refused(car, winding):
    with pytest.raises(InputError, match="never started"):
        determined_by(without_velocity(winding, -1.0, 100.0), car, "inertial")


@pytest.mark.exam
def test_the_command_says_what_would_tell_the_rest(tmp_path: Path, winding):
    bag = tmp_path / "straight"
    write_bag(bag, winding.between(0.0, 7.5))
    out = tmp_path / "determined_by"
    options = [str(bag), "--vehicle", "prototype_model", "--filter", "inertial", "--out", str(out)]
    result = CliRunner().invoke(main, ["observability", *options])
    assert result.exit_code == 0, result.output
    assert "not yet" in result.output
    found = json.loads(out.with_suffix(".json").read_text())
    would = found["would_leave"]["rear_distance"]
    assert min(would["turn"], would["weave"]) < 0.6 < would["go straight"]
    assert out.with_suffix(".png").stat().st_size > 20_000
