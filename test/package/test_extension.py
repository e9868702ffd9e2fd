"""Adding a sensor kind or an effect is one file: with one more of each in the package, all tests pass as before."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ADDED = {
    "test/sensors/ride_height.py": "vsense_ros/model/sensors/ride_height.py",
    "test/effects/more_effects/dry_bearings.py": "vsense_ros/model/effects/dry_bearings.py",
}
CONCERNED = ("effects", "sensors", "files", "model", "mismatch", "blind", "package")


@pytest.mark.exam
@pytest.mark.timeout(3000)
def test_a_sensor_kind_and_an_effect_in_a_file_each_make_no_test_fail(tmp_path: Path) -> None:
    copy = tmp_path / "vsense_ros"
    left_out = shutil.ignore_patterns(".git", ".venv*", "out", "__pycache__", ".*_cache", "build", "install")
    shutil.copytree(ROOT, copy, ignore=left_out)
    for source, target in ADDED.items():
        shutil.copyfile(ROOT / source, copy / target)
    tests = [f"test/{name}" for name in CONCERNED]
    marks = ["-m", "not slow and not exam", "-p", "no:cacheprovider"]
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *marks, *tests],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout[-3000:]
