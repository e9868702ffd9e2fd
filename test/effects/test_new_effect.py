"""A new effect is one file: the schema, the equations of the car and the simulation find it there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

HERE = Path(__file__).parent
FORCE = 1500.0  # [N]
pytestmark = pytest.mark.slow


def drive(vehicle_file: Path, effects: Path = HERE / "more_effects") -> subprocess.CompletedProcess[str]:
    script = HERE.parent / "model/drive_with_more_files.py"
    return subprocess.run(
        [sys.executable, str(script), "vsense_ros.model.effects", str(effects), str(vehicle_file)],
        env={**os.environ, "VSENSE_COMPILE": "0", "PYTHONPATH": str(HERE.parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )


def with_push(folder: Path, force: float) -> Path:
    """The Genesis with a push from behind [N]."""
    text = vehicle_path("genesis").read_text(encoding="utf-8")
    path = folder / f"pushed_{force:g}.yaml"
    path.write_text(text.replace("physics:\n", f"physics:\n  effects: {{tail_wind: {{force: {force}}}}}\n", 1))
    return path


def test_a_car_has_an_effect_that_one_file_defines(tmp_path: Path):
    """What the force adds to the speed in two seconds is its impulse over the mass, with that of the turning wheels."""
    pushed, alone = (drive(with_push(tmp_path, force)) for force in (FORCE, 0.0))
    assert pushed.stderr == alone.stderr == ""
    gained = json.loads(pushed.stdout)["speed"] - json.loads(alone.stdout)["speed"]
    physics = load_vehicle(vehicle_path("genesis")).physics
    turning = sum(2 * axle.wheel_spin_inertia / axle.unloaded_radius**2 for axle in (physics.front, physics.rear))
    assert gained == pytest.approx(FORCE * 2.0 / (physics.chassis.mass + turning), rel=0.02)


def test_without_its_file_the_effect_is_refused_by_its_name(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    refused = drive(with_push(tmp_path, FORCE), tmp_path / "empty")
    assert refused.returncode != 0
    assert "tail_wind" in refused.stderr
