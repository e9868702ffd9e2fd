"""How to add a filter that `--filter` takes: a file (here gyro_heading.py), and one entry in the catalogue."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.evaluate.signals import wrap

BAG = Path(__file__).parents[2] / "bags" / "double_lane_change"
WITH_THE_FILTER = """
from gyro_heading import GYRO_HEADING
from vsense_ros.cli import main
from vsense_ros.navigation import catalogue

catalogue.add("gyro_heading", "heading by gyro and course", GYRO_HEADING, "as an example")
main(["filters"], standalone_mode=False)
main(["run", BAG, "--vehicle", "prototype_model", "--filter", "gyro_heading", "--out", OUT])
"""


def yaw_of(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    odometry = read_bag(path)[topic]
    x, y, z, w = odometry.columns["orientation"].T
    return odometry.stamp, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@pytest.mark.slow
def test_a_filter_in_a_file_of_its_own_is_listed_and_runs_by_its_name_on_a_recording(tmp_path: Path) -> None:
    script = WITH_THE_FILTER.replace("BAG", repr(str(BAG))).replace("OUT", repr(str(tmp_path)))
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=200)
    assert "as an example" in done.stdout
    stamp, estimated = yaw_of(tmp_path / "output", "vsense/odometry")
    at, true = yaw_of(BAG, "reference/odometry")
    error = wrap(estimated - np.interp(stamp, at, np.unwrap(true)))
    assert len(stamp) > 500
    assert np.sqrt(np.mean(error[len(error) // 4 :] ** 2)) < np.radians(1.0)
