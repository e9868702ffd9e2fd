"""A new effect is one file: vehicle files, the equations of the car and the mismatch search find it there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from vsense_ros.files.installed import vehicle_path

HERE = Path(__file__).parent
TORQUE = 60.0  # [N m]
pytestmark = pytest.mark.slow


def coast(vehicle_file: Path, torque: float, effects: Path = HERE / "more_effects") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(HERE / "drive_with_more_effects.py"), str(effects), str(vehicle_file), str(torque)],
        env={**os.environ, "VSENSE_COMPILE": "0", "PYTHONPATH": str(HERE.parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def dry(tmp_path: Path) -> Path:
    """The file of a Genesis with the effect."""
    yaml = YAML()
    content = yaml.load(vehicle_path("genesis"))
    content["physics"]["effects"] = {"dry_bearings": {"torque": TORQUE}}
    yaml.dump(content, tmp_path / "dry.yaml")
    return tmp_path / "dry.yaml"


def test_a_car_has_the_effect_that_one_file_defines_and_the_search_tries_it(dry: Path) -> None:
    found, known = coast(dry, 0.0), coast(vehicle_path("genesis"), -TORQUE)
    assert found.stderr == known.stderr == ""
    result, braked = json.loads(found.stdout), json.loads(known.stdout)
    assert braked["speed"] < 17.5
    assert result["speed"] == pytest.approx(braked["speed"], rel=1e-12)
    assert any("dry_bearings" in one for one in result["searched"])


def test_without_its_file_a_vehicle_file_that_lists_it_is_refused(dry: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    refused = coast(dry, 0.0, tmp_path / "empty")
    assert refused.returncode != 0
    assert "dry_bearings" in refused.stderr
