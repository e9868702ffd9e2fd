"""What a message costs: reading a bag of 100,000 Imu messages with ours and with the libraries around it.

Time per message is the figure divided by the number of messages in `extra_info`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.messages import cdr
from vsense_ros.messages.recording import FIELDS, Channel, Recording

COUNT = 100_000
IMU = "sensor_msgs/msg/Imu"


@pytest.fixture(scope="module")
def recording() -> Recording:
    noise = np.random.default_rng(0)
    stamp = 1_600_000_000_000_000_000 + np.arange(COUNT) * 4_000_000
    columns = {
        field: np.zeros((COUNT, width)) if "covariance" in field else noise.normal(size=(COUNT, width))
        for field, width in FIELDS[IMU].items()
    }
    return Recording({"imu/data": Channel("imu/data", IMU, stamp, stamp, columns, "imu_link")}, "imu")


@pytest.fixture(scope="module")
def bag(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "imu"
    write_bag(path, recording)
    return path


def per_message(benchmark: Any, count: int = COUNT) -> None:
    benchmark.extra_info["messages"] = count
    if benchmark.stats is not None:  # None when benchmarks are disabled
        benchmark.extra_info["us_per_message"] = benchmark.stats.stats.median / count * 1e6


@pytest.mark.benchmark(group="read 100,000 Imu messages")
def test_read_with_vsense_ros(benchmark: Any, bag: Path) -> None:
    found = benchmark.pedantic(lambda: read_bag(bag), rounds=5, warmup_rounds=1)
    assert len(found["imu/data"]) == COUNT
    per_message(benchmark)


@pytest.mark.benchmark(group="read 100,000 Imu messages")
def test_read_with_rosbags(benchmark: Any, bag: Path) -> None:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)

    def read() -> int:
        with Reader(bag) as reader:
            return sum(1 for c, _, data in reader.messages() if store.deserialize_cdr(data, c.msgtype))

    assert benchmark.pedantic(read, rounds=2) == COUNT
    per_message(benchmark)


@pytest.mark.benchmark(group="read 100,000 Imu messages")
def test_read_with_mcap_ros2_support(benchmark: Any, bag: Path) -> None:
    from mcap_ros2.reader import read_ros2_messages

    def read() -> int:
        return sum(1 for message in read_ros2_messages(bag / "imu_0.mcap") if message.ros_msg)

    assert benchmark.pedantic(read, rounds=1) == COUNT
    per_message(benchmark)


@pytest.mark.benchmark(group="write 100,000 Imu messages")
def test_write_with_vsense_ros(benchmark: Any, recording: Recording, tmp_path: Path) -> None:
    benchmark.pedantic(lambda: write_bag(tmp_path / "out", recording, overwrite=True), rounds=3)
    per_message(benchmark)


@pytest.mark.benchmark(group="one Imu message")
def test_encode_one(benchmark: Any, recording: Recording) -> None:
    sample = recording["imu/data"].sample(0)
    assert len(benchmark(cdr.encode, sample)) > 300
    per_message(benchmark, 1)


@pytest.mark.benchmark(group="one Imu message")
def test_decode_one(benchmark: Any, recording: Recording) -> None:
    data = cdr.encode(recording["imu/data"].sample(0))
    assert benchmark(cdr.decode, IMU, data, "imu/data").frame_id == "imu_link"
    per_message(benchmark, 1)
