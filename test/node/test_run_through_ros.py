"""The whole road: bytes and frames to drivers, observer and recorder, each a process of its own."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.driver import samples
from vsense_ros.driver.imu import encode_mtdata2
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording, Sample
from vsense_ros.node.processes import RosRun, run_through_ros
from vsense_ros.observer.monitor import Limits, Range, save_limits
from vsense_ros.runner.run import run as run_without_ros

pytestmark = pytest.mark.slow

START = 1_700_000_000_000_000_000
SPEED = 20.0  # [m/s] to the east
SECONDS = 8
CAR = "rav4"
DBC = """VERSION ""
BU_: ECU
BO_ 170 WHEELS: 8 ECU
 SG_ FL : 7|16@0+ (0.001,0) [0|65] "m/s" X
 SG_ FR : 23|16@0+ (0.001,0) [0|65] "m/s" X
 SG_ RL : 39|16@0+ (0.001,0) [0|65] "m/s" X
 SG_ RR : 55|16@0+ (0.001,0) [0|65] "m/s" X
BO_ 37 STEERING: 2 ECU
 SG_ ANGLE : 7|16@0- (0.1,0) [-500|500] "deg" X
"""
MAPPING = """name: test car
outputs:
  - kind: joint_state
    topic: vehicle/wheel_speeds
    message: WHEELS
    field: velocity
    joints:
      wheel_fl: {signals: [FL], unit: m/s, rolling_radius: 0.35}
      wheel_fr: {signals: [FR], unit: m/s, rolling_radius: 0.35}
      wheel_rl: {signals: [RL], unit: m/s, rolling_radius: 0.35}
      wheel_rr: {signals: [RR], unit: m/s, rolling_radius: 0.35}
  - kind: joint_state
    topic: vehicle/steering
    message: STEERING
    field: position
    joints:
      steering_wheel: {signals: [ANGLE], unit: deg}
"""


def rows(template: Sample, stamps: np.ndarray, changes: dict[str, np.ndarray] | None = None) -> Channel:
    """A channel that says the same all the time, but for `changes`."""
    columns = {name: np.tile(value, (len(stamps), 1)) for name, value in template.values.items()} | (changes or {})
    return Channel(template.topic, template.kind, stamps, stamps, columns, template.frame_id, template.names)


def straight_drive() -> Recording:
    """A car at constant speed on a straight level road, with the sensors of the RAV4."""
    fast = START + np.arange(100 * SECONDS) * 10_000_000
    slow = START + 2_100_000 + np.arange(10 * SECONDS) * 100_000_000
    generator = np.random.default_rng(7)
    inertial = samples.imu(
        "imu/data",
        0,
        "imu_link",
        angular_velocity=np.zeros(3),
        linear_acceleration=[0.0, 0.0, 9.81],
        angular_velocity_covariance=samples.diagonal([1e-5] * 3),
        linear_acceleration_covariance=samples.diagonal([1e-2] * 3),
    )
    noise = {
        "angular_velocity": generator.normal(0.0, 1e-3, (len(fast), 3)),
        "linear_acceleration": np.array([0.0, 0.0, 9.81]) + generator.normal(0.0, 1e-2, (len(fast), 3)),
    }
    wheels = {f"wheel_{w}": SPEED / 0.35 for w in ("fl", "fr", "rl", "rr")}
    fix = {name: np.zeros(1) for name in ("status", "service", "latitude", "longitude", "altitude")}
    fix |= {"position_covariance": samples.diagonal([1.0, 1.0, 2.0]), "position_covariance_type": np.ones(1)}
    twist = {"linear": np.array([SPEED, 0.0, 0.0]), "angular": np.zeros(3), "covariance": np.zeros(36)}
    longitude = np.degrees((slow - START)[:, None] * 1e-9 * SPEED / 6_378_137.0)
    channels = [
        rows(inertial, fast, noise),
        rows(samples.joint_state("vehicle/wheel_speeds", 0, "velocity", wheels), fast + 4_000_000),
        rows(samples.joint_state("vehicle/steering", 0, "position", {"steering_wheel": 0.0}), fast + 7_000_000),
        rows(Sample("gps/fix", "sensor_msgs/msg/NavSatFix", 0, fix, "gnss_link"), slow, {"longitude": longitude}),
        rows(Sample("gps/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped", 0, twist, "map"), slow),
    ]
    # Its receiver stamps what it measures too early, as the vehicle file says; it sends it afterwards.
    sensors = load_vehicle(vehicle_path(CAR)).sensors
    early = {one.topic: round(one.latency * 1e9) for one in sensors.values() if one.latency < 0}
    dated = [
        dataclasses.replace(one, stamp=one.stamp + early.get(one.topic, 0), received=one.stamp) for one in channels
    ]
    return Recording({channel.topic: channel for channel in dated}, "straight")


def write_frames(path: Path) -> None:
    """The wheel speeds and the steering of `straight_drive` as a CAN log."""
    speed = round(SPEED * 1000).to_bytes(2, "big")
    with can.CanutilsLogWriter(str(path)) as writer:
        for i in range(100 * SECONDS):
            for identifier, data in ((170, 4 * speed), (37, b"\0\0")):
                frame = can.Message(START * 1e-9 + 0.01 * i, identifier, False, data=data, channel="can0")
                writer.on_message_received(frame)


def through_all_six_processes(drive: Recording, folder: Path, progress: Callable[[float], None]) -> RosRun:
    """A drive as bytes and frames to the three drivers."""
    write_frames(folder / "drive.log")
    (folder / "car.dbc").write_text(DBC)
    (folder / "car.yaml").write_text(MAPPING)
    inertial = drive["imu/data"]
    return run_through_ros(
        None,
        CAR,
        can_log=folder / "drive.log",
        can_database=folder / "car.dbc",
        can_mapping=folder / "car.yaml",
        gnss_bytes=gnss_byte_stream(drive),
        imu_bytes=[(int(inertial.received[i]), encode_mtdata2(inertial.sample(i), i)) for i in range(len(inertial))],
        out_bag=folder / "out",
        progress=progress,
    )


def process_of(node: str) -> int:
    """Process number of a node that this process has started."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            mine = f"PPid:\t{os.getpid()}\n" in (folder / "status").read_text()
            if mine and f"vsense_ros.node.{node}".encode() in (folder / "cmdline").read_bytes():
                return int(folder.name)
    raise AssertionError(f"{node} does not run")


@pytest.mark.exam
@pytest.mark.parametrize("driver", ["can_driver", "imu_driver"])
def test_a_driver_that_had_no_processor_when_the_drive_began_loses_nothing_and_dates_it(
    tmp_path: Path, driver: str
) -> None:
    begun: list[float] = []

    def hold_up(done: float) -> None:
        if not begun:
            held = process_of(driver)
            os.kill(held, signal.SIGSTOP)
            threading.Timer(0.9, os.kill, (held, signal.SIGCONT)).start()
        begun.append(done)

    drive = straight_drive()
    run = through_all_six_processes(drive, tmp_path, hold_up)
    assert run.messages_lost == 0
    for topic, channel in drive.channels.items():
        stamps = run.recording[topic].stamp
        assert len(stamps) == len(channel), topic
        assert np.all(np.diff(stamps) > 0), topic
        assert np.all(stamps - channel.stamp > -100_000_000), topic
        np.testing.assert_allclose(stamps[100:], channel.stamp[100:], rtol=0.0, atol=100_000_000, err_msg=topic)


def test_bytes_and_frames_through_all_six_processes_make_an_estimate_and_lose_nothing(tmp_path: Path) -> None:
    drive = straight_drive()
    done: list[float] = []
    run = through_all_six_processes(drive, tmp_path, done.append)
    assert run.messages_lost == 0
    for topic, channel in drive.channels.items():
        assert len(run.recording[topic]) == len(channel), topic
    assert done[-1] == 1.0
    assert run.realtime_factor == pytest.approx(1.0, abs=0.3)
    assert set(run.latency_ms) == {"p50", "p90", "p99", "p99.9"}
    odometry = run.output["vsense/odometry"]
    assert len(odometry) > 60 * (SECONDS - 1)
    late = odometry.stamp > START + 4_000_000_000
    np.testing.assert_allclose(odometry.columns["linear"][late, 0], SPEED, atol=0.3)
    assert len(read_bag(tmp_path / "out")["vsense/sideslip"]) == len(odometry)


def test_a_bag_as_fast_as_can_be_gives_what_the_observer_gives_without_ros(tmp_path: Path) -> None:
    drive = straight_drive()
    write_bag(tmp_path / "drive", drive)
    run = run_through_ros(tmp_path / "drive", CAR, output_rate=1000.0)
    assert run.messages_lost == 0
    through = run.output["vsense/odometry"]
    alone = run_without_ros(drive, load_vehicle(vehicle_path(CAR)), rate=1000.0).output["vsense/odometry"]
    common, here, there = np.intersect1d(through.stamp, alone.stamp, return_indices=True)
    assert len(common) > 0.9 * len(alone)
    for field in ("position", "linear", "angular", "orientation"):
        np.testing.assert_allclose(through.columns[field][here], alone.columns[field][there], atol=1e-9)


@pytest.mark.exam
@pytest.mark.parametrize("name", ["inertial", "yaw_kkf"])
def test_a_gnss_ins_filter_in_the_node_gives_what_it_gives_without_ros(tmp_path: Path, name: str) -> None:
    """It publishes what it estimates, and nothing else."""
    drive = straight_drive()
    write_bag(tmp_path / "drive", drive)
    alone = run_without_ros(drive, load_vehicle(vehicle_path(CAR)), name, rate=1000.0).output
    chosen = {"observer": {"filter": name}}
    through = run_through_ros(tmp_path / "drive", CAR, output_rate=1000.0, driver_parameters=chosen).output
    assert {topic for topic, channel in through.channels.items() if len(channel)} == set(alone.channels)
    assert ("vsense/sideslip" in through) == (name == "inertial")
    here, there = through["vsense/odometry"], alone["vsense/odometry"]
    common, i, j = np.intersect1d(here.stamp, there.stamp, return_indices=True)
    assert len(common) > 0.9 * len(there)
    for field in ("linear", "angular", "orientation"):
        np.testing.assert_allclose(here.columns[field][i], there.columns[field][j], atol=1e-9)


@pytest.mark.exam
def test_the_observer_says_in_its_diagnostics_what_of_its_model_no_longer_fits(tmp_path: Path) -> None:
    write_bag(tmp_path / "drive", straight_drive())
    wide, elsewhere = (Range(unit="N", low=x - 1e6, high=x + 1e6, margin=1.5) for x in (0.0, 1e7))
    limits = Limits(
        vehicle=load_vehicle(vehicle_path(CAR)).name,
        recordings=["another day"],
        seconds=60.0,
        window=2.0,
        quantities={"longitudinal force": wide, "lateral force": elsewhere},
    )
    save_limits(tmp_path / "limits.yaml", limits)
    watching = {"observer": {"monitor": str(tmp_path / "limits.yaml")}}
    run = run_through_ros(tmp_path / "drive", CAR, driver_parameters=watching)
    (said,) = (line for line in run.diagnostics if line.name == "model")
    assert said.level == Level.WARN
    assert said.message.startswith("no longer fits since 22:13:2")
    assert list(said.values) == ["lateral force"]


def test_a_drive_with_none_of_the_cars_sensors_ends_with_what_was_missing(tmp_path: Path) -> None:
    fix = straight_drive()["gps/fix"]
    foreign = dataclasses.replace(fix, topic="another/fix")
    write_bag(tmp_path / "drive", Recording({foreign.topic: foreign}))
    with pytest.raises(InputError, match=r"drive: the observer never started .*imu: "):
        run_through_ros(tmp_path / "drive", CAR)


def test_a_can_log_without_a_database_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="database"):
        run_through_ros(None, CAR, can_log=tmp_path / "drive.log")
