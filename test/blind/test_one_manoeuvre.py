"""A manoeuvre alone, of cars that are not our model."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind.cases import all_cases
from blind.generate import generate
from vsense_ros.bag.importers import import_recording
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.mismatch.explain import explain_recordings


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case with nothing hidden, on tyres of another formula than the vehicle file has."""
    folder = tmp_path_factory.mktemp("nothing")
    nothing = (c for c in all_cases("public") if c.kind == "nothing" and c.manoeuvres == "rich")
    case = next(c for c in nothing if (c.plant, c.tyre) == ("mujoco_tree", "dugoff"))
    assert not generate([case], folder)
    return folder / case.number


@pytest.mark.exam
@pytest.mark.timeout(600)
@pytest.mark.parametrize("manoeuvre", ["steering_sweep", "step_steers", "slalom"])
def test_of_ten_to_twenty_seconds_with_nothing_hidden_nothing_is_named(drives, manoeuvre):
    """What a few parameters fit to so little is not what lacks, however much of it they take away."""
    car = load_vehicle(drives / "vehicle.yaml")
    (path,) = (drives / "train").glob(f"*{manoeuvre}")
    for kinds in ((), ("gnss_position", "gnss_velocity", "wheel_torques")):
        heard = {name: sensor for name, sensor in car.sensors.items() if sensor.kind not in kinds}
        found = explain_recordings([import_recording(path)], car.model_copy(update={"sensors": heard})).answer
        assert found.verdict == "no_mismatch"
        assert not [effect for effect in found.effects if effect.accepted]
