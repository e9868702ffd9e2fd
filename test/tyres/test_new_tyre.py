"""A new tyre is one file: the schema, the equations of the car and the simulation find it there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.vehicle import Vehicle

HERE = Path(__file__).parent
STIFFNESS = 20.0  # slope of the forces over the load
pytestmark = pytest.mark.slow


def drive(vehicle_file: Path, tyres: Path = HERE / "more_tyres") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(HERE / "drive_with_more_tyres.py"), str(tyres), str(vehicle_file)],
        env={**os.environ, "VSENSE_COMPILE": "0", "PYTHONPATH": str(HERE.parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )


def write(vehicle: Vehicle, path: Path, front: dict[str, object], rear: dict[str, object]) -> Path:
    """A file of the vehicle with other tyres."""
    save_vehicle(path, vehicle)
    yaml = YAML()
    content = yaml.load(path)
    content["physics"]["front"]["tyre"], content["physics"]["rear"]["tyre"] = front, rear
    yaml.dump(content, path)
    return path


@pytest.fixture
def arctangent(genesis: Vehicle, tmp_path: Path) -> Path:
    tyre = {"model": "arctangent", "stiffness": STIFFNESS, "grip": 1.0}
    return write(genesis, tmp_path / "arctangent.yaml", tyre, dict(tyre))


def test_a_car_drives_on_a_tyre_that_one_file_defines(genesis: Vehicle, arctangent: Path):
    """At small slip it is the linear tyre, whose stiffness is given for the load that a wheel carries at rest."""
    chassis = genesis.physics.chassis
    arms = (chassis.cog_to_rear_axle, chassis.cog_to_front_axle)
    stiffnesses = [STIFFNESS * chassis.mass * GRAVITY * arm / sum(arms) / 2 for arm in arms]
    tyres = [{"model": "linear", "slip_stiffness": c, "cornering_stiffness": c} for c in stiffnesses]
    linear = drive(write(genesis, arctangent.with_name("linear.yaml"), *tyres))
    found = drive(arctangent)
    assert found.stderr == linear.stderr == ""
    yaw_rate = float(found.stdout)
    assert yaw_rate > 0.01  # to the left
    assert yaw_rate == pytest.approx(float(linear.stdout), rel=0.01)


def test_without_its_file_the_tyre_is_refused_with_the_names_of_those_that_are_known(arctangent: Path, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    refused = drive(arctangent, tmp_path / "empty")
    assert refused.returncode != 0
    for name in ("arctangent", "fiala", "linear", "magic_formula", "similarity", "tmeasy"):
        assert f"'{name}'" in refused.stderr
