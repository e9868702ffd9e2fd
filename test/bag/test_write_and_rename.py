"""A bag appears in its place when it is complete, whatever ends the program before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.bag.importers import build
from vsense_ros.messages.recording import Recording

KILLED = """
import os, sys, numpy as np
from vsense_ros.bag import write_bag
from vsense_ros.bag import writing
from vsense_ros.bag.importers import build
from vsense_ros.messages.recording import Recording
writing.BagWriter.close = lambda self: os._exit(9)
values = np.zeros((100, 3))
write_bag(sys.argv[1], Recording({"imu/data": build.imu(np.arange(100) * 10**7, values, values)}), overwrite=True)
"""


def recording(rows: int) -> Recording:
    values = np.ones((rows, 3))
    return Recording({"imu/data": build.imu(np.arange(rows) * 10_000_000, values, values)})


@pytest.mark.parametrize("before", [False, True])
def test_an_import_that_was_killed_blocks_no_other_and_costs_no_old_bag(before: bool, tmp_path: Path) -> None:
    if before:
        write_bag(tmp_path / "drive", recording(7))
    run = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "drive")], env=os.environ, check=False)
    assert run.returncode == 9
    assert (tmp_path / "drive").exists() is before
    if before:
        assert len(read_bag(tmp_path / "drive")["imu/data"]) == 7
    write_bag(tmp_path / "drive", recording(9), overwrite=before)
    assert len(read_bag(tmp_path / "drive")["imu/data"]) == 9
    assert sorted(f.name for f in (tmp_path / "drive").iterdir()) == ["drive_0.mcap", "metadata.yaml"]


def test_a_bag_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    broken = recording(5)
    broken["imu/data"].received[0] = -1
    with pytest.raises(Exception, match="before 1970"):
        write_bag(tmp_path / "drive", broken)
    assert list(tmp_path.iterdir()) == []
