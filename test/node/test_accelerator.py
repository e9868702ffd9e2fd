"""Observer and accelerator as processes of their own, over topics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")

from marks import exam_except
from vsense_ros.accelerator.frame import LABEL
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.node.accelerator_link import as_bytes, as_message
from vsense_ros.node.processes import run_through_ros
from vsense_ros.observer.implicit import implicit_error_ekf
from vsense_ros.runner.run import run

pytestmark = pytest.mark.slow

CAR = "prototype_model"
SECONDS = 0.7


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of a generated double lane change."""
    whole = read_bag(shared_folder("bags") / "double_lane_change")
    end = whole.first_stamp + round(SECONDS * 1e9)
    channels = [c.select(c.stamp < end) for c in whole.channels.values() if not c.topic.startswith("reference")]
    path = tmp_path_factory.mktemp("drive") / "bag"
    write_bag(path, dataclasses.replace(whole, channels={c.topic: c for c in channels}))
    return path


@pytest.mark.parametrize("faults", exam_except(["", "bit_flip: 0.004, nan: 0.02"], "bit_flip: 0.004, nan: 0.02"))
def test_a_drive_with_an_accelerator_has_the_estimates_of_one_without(drive: Path, faults: str) -> None:
    found = run_through_ros(drive, CAR, accelerator={"backend": "mock", "faults": faults})
    counts = found.accelerator
    assert counts["accelerated"] > 100
    if faults:
        assert counts["dropped_crc"] + counts["not_finite"] > 0
    else:
        # Once the node has ended, the last readings that wait for late ones are worked off without the accelerator.
        assert counts["accelerated"] > 0.95 * counts["requests"]
    alone = run(read_bag(drive), load_vehicle(vehicle_path(CAR)), rate=1000.0, make=implicit_error_ekf())
    ours, theirs = found.output["vsense/odometry"], alone.output["vsense/odometry"]
    _, here, there = np.intersect1d(ours.stamp, theirs.stamp, return_indices=True)
    assert len(here) > 0.8 * len(ours)
    assert np.allclose(ours.columns["linear"][here], theirs.columns["linear"][there], atol=1e-6)


def test_a_message_carries_the_bytes_and_says_what_they_are() -> None:
    message = as_message(b"\x00\xff anything")
    assert as_bytes(message) == b"\x00\xff anything"
    assert message.layout.dim[0].label == f"{LABEL} unknown"
