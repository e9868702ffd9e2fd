"""Nodes that share a process and its executor."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")

from vsense_ros.bag import read_bag
from vsense_ros.node.processes import NodeProcess, free_domain, ros_environment

pytestmark = pytest.mark.exam
DRIVE = Path(__file__).parents[2] / "bags" / "double_lane_change"
# As docs/nodes.md has it.
PROGRAM = """
import sys
from vsense_ros.node import spin
from vsense_ros.node.observer import ObserverNode, ObserverParameters
from vsense_ros.node.recorder import Recorder, RecorderParameters
spin.init(sys.argv)
stop = spin.Stop()
nodes = [ObserverNode("observer", ObserverParameters), Recorder("recorder", RecorderParameters)]
for node in nodes:
    node.trigger_configure()
    node.trigger_activate()
print("active", flush=True)
spin.spin(nodes, stop)
for node in nodes:
    node.trigger_shutdown()
"""


def test_observer_and_recorder_in_one_process_lose_nothing_of_a_replay(tmp_path: Path) -> None:
    environment = ros_environment(free_domain())
    own = ["observer:vehicle:=prototype_model", "observer:publish_all:=true", f"recorder:bag:={tmp_path / 'bag'}"]
    given = [word for name in (*own, "use_sim_time:=true") for word in ("-p", name)]
    command = [sys.executable, "-c", PROGRAM, "--ros-args", *given]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as both:
        assert both.stdout is not None
        assert any(line == "active\n" for line in both.stdout)
        replay = NodeProcess("replay", {"bag": str(DRIVE), "rate": 0, "consumers": 2, "duration": 2.0}, environment)
        assert replay.wait_until_ended(120.0) == 0, replay.output
        both.terminate()
        both.communicate(timeout=30.0)
    assert both.returncode == 0
    recorded, drive = read_bag(tmp_path / "bag"), read_bag(DRIVE)
    sent = drive["imu/data"].stamp
    assert list(recorded["imu/data"].stamp) == list(sent[sent < drive.first_stamp + 2_000_000_000])
    stamps = recorded["vsense/odometry"].stamp[1:]  # the first is that of the start
    assert stamps[-1] - stamps[0] > 1_800_000_000
    assert set(np.diff(stamps)) == {4_000_000}
