"""Recorder and replay: what is kept of what was sent, and how a replay is steered."""

from __future__ import annotations

import re
import signal
import struct
import time
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, TimeReference
from std_msgs.msg import String

from vehicle.workshop import CAR, Workshop, check
from vsense_ros.bag import read_bag, read_whole_bag
from vsense_ros.node.convert import message_type
from vsense_ros.node.rosbag2 import service_type

CAN = "can_msgs/msg/Frame"


def can_message(number: int) -> bytes:
    """A can_msgs/Frame as CDR bytes."""
    header = struct.pack("<iII", number, 0, 5) + b"can0\0\0\0\0"
    return b"\0\1\0\0" + header + struct.pack("<IBBBB8s", number, 0, 0, 0, 8, bytes(8))


@check("messages of any type are recorded and replayed byte by byte, as they were offered")
def any_type(shop: Workshop) -> str:
    node = shop.client.node
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    hasty = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
    frames = node.create_publisher(message_type(CAN), "can/frames", hasty)
    times = node.create_publisher(TimeReference, "time", 500)
    node.create_publisher(String, "about", latched).publish(String(data="there before the recorder"))
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"))
    recorder.wait_until_active()
    shop.client.until(lambda: frames.get_subscription_count() + times.get_subscription_count() == 2)
    shop.client.spin_for(0.5)
    for number in range(100):
        frames.publish(can_message(number))
        times.publish(TimeReference(source=f"clock {number}"))
        time.sleep(0.005)
    shop.client.spin_for(0.5)
    assert recorder.stop() == 0
    bag = read_whole_bag(shop.folder / "bag")
    assert bag.others["can/frames"].payloads == [can_message(n) for n in range(100)]
    assert len(bag.others["time"].payloads) == 100
    assert len(bag.others["about"].payloads) == 1
    for topic, words in {
        "can/frames": ("best_effort", "volatile"),
        "time": ("reliable", "volatile"),
        "about": ("reliable", "transient_local"),
    }.items():
        assert all(word in bag.descriptions[topic].qos for word in words), bag.descriptions[topic].qos
    assert "string source" in bag.descriptions["time"].schema
    for publisher in (frames, times):
        node.destroy_publisher(publisher)

    heard: list[bytes] = []
    node.create_subscription(message_type(CAN), "can/frames", heard.append, hasty, raw=True)
    replay = shop.start("replay", bag=str(shop.folder / "bag"), exit_at_end=False)
    shop.client.until(lambda: len(heard) >= 100, 30.0)
    late: list[String] = []
    node.create_subscription(String, "about", late.append, latched)
    shop.client.until(lambda: bool(late))
    assert heard == [can_message(n) for n in range(100)]
    offered = node.get_publishers_info_by_topic("can/frames")[0].qos_profile.reliability
    assert offered == ReliabilityPolicy.BEST_EFFORT
    assert replay.stop() == 0
    return "100 messages of a type that is not installed, 100 of one that is, and one that was latched"


@check("a recorder that is killed has lost at most a second, on a topic at 10 Hz too")
def killed(shop: Workshop) -> str:
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"))
    recorder.wait_until_active()
    slow = shop.client.node.create_publisher(TimeReference, "slow", 100)
    fast = shop.client.node.create_publisher(Imu, "fast", 1000)
    shop.client.until(lambda: slow.get_subscription_count() + fast.get_subscription_count() == 2)
    began = time.monotonic()
    for sent in range(1250):
        fast.publish(Imu())
        if sent % 25 == 0:
            slow.publish(TimeReference(source=str(sent)))
        time.sleep(max(began + sent / 250 - time.monotonic(), 0.0))
    killed_at = time.time_ns()
    recorder.signal(signal.SIGKILL)
    recorder.wait_until_ended(10.0)
    bag = read_whole_bag(shop.folder / "bag")
    lost = {
        "slow": 1e-9 * (killed_at - int(bag.others["slow"].times[-1])),
        "fast": 1e-9 * (killed_at - int(bag.recording["fast"].received[-1])),
    }
    assert all(seconds <= 1.0 for seconds in lost.values()), lost
    return f"{max(lost.values()):.2f} s at most"


@check("a recording is split by size and by time, and reads as one")
def split(shop: Workshop) -> str:
    found = []
    for name, parameters in {
        "by_time": {"max_bagfile_duration": 1.0},
        "by_size": {"max_bagfile_size": 100_000},
    }.items():
        recorder = shop.start("recorder", name=name, bag=str(shop.folder / name), **parameters)
        recorder.wait_until_active()
        publisher = shop.client.node.create_publisher(Imu, name, 1000)
        shop.client.until(lambda: publisher.get_subscription_count() == 1)  # noqa: B023
        random = np.random.default_rng(1)
        for _ in range(1500):
            publisher.publish(
                Imu(orientation_covariance=random.random(9), angular_velocity_covariance=random.random(9))
            )
            time.sleep(0.002)
        shop.client.spin_for(0.3)
        assert recorder.stop() == 0
        shop.client.node.destroy_publisher(publisher)
        files = list((shop.folder / name).glob("*.mcap"))
        assert len(files) >= 3, f"{name}: {len(files)} files"
        bag = read_bag(shop.folder / name)
        assert len(bag[name]) == 1500
        assert not bag.damage
        found.append(f"{len(files)} files {name.replace('_', ' ')}")
    return ", ".join(found)


@check("a snapshot holds the last seconds before it was asked for")
def snapshot(shop: Workshop) -> str:
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"), snapshot_mode=True, snapshot_duration=1.0)
    recorder.wait_until_active()
    publisher = shop.client.node.create_publisher(TimeReference, "time", 1000)
    shop.client.until(lambda: publisher.get_subscription_count() == 1)
    for number in range(300):
        publisher.publish(TimeReference(source=str(number)))
        time.sleep(0.01)
    kind, _, done = service_type("Snapshot")
    answer = shop.client.call(kind, "recorder/snapshot", kind.Request())
    assert getattr(answer, done)
    assert recorder.stop() == 0
    times = read_whole_bag(shop.folder / "bag").others["time"].times
    length = 1e-9 * int(times[-1] - times[0])
    assert 0.8 <= length <= 1.05, length
    return f"{len(times)} of 300 messages, {length:.2f} s"


@check("a replay waits for readers of measurements, and for none of reference/*")
def nobody_compares(shop: Workshop) -> str:
    drive = shop.drive(2.0)
    assert any(topic.startswith("reference/") for topic in read_bag(drive).channels)
    shop.start("observer", vehicle=CAR, use_sim_time=True).wait_until_active()
    replay = shop.start("replay", bag=str(drive), consumers=1, rate=4.0)
    assert replay.wait_until_ended(60.0) == 0
    waited = re.findall(r"waited .*", replay.output)
    assert not any("reference/" in text for text in waited), waited
    return "no reader of reference/* was missed"


@check("the services of rosbag2's player steer the replay; a rate after a seek does not jump back")
def player(shop: Workshop) -> str:
    heard: list[int] = []

    def receive(message: Clock) -> None:
        heard.append(message.clock.sec * 1_000_000_000 + message.clock.nanosec)

    shop.client.node.create_subscription(Clock, "/clock", receive, QoSProfile(depth=1000))
    replay = shop.start("replay", bag=str(shop.drive()), exit_at_end=False, lead=0.0)
    replay.wait_until_active()
    shop.client.until(lambda: len(heard) > 10)
    first = read_bag(shop.drive()).start

    def ask(name: str, kind_name: str, value: Any = None) -> Any:
        kind, asked, answered = service_type(kind_name)
        request = kind.Request(**({asked: value} if asked else {}))
        answer = shop.client.call(kind, f"replay/{name}", request)
        return getattr(answer, answered) if answered else None

    def at() -> float:
        heard.clear()
        shop.client.until(lambda: len(heard) > 3)
        return 1e-9 * (heard[-1] - first)

    def seek(seconds: float) -> bool:
        return ask("seek", "Seek", Time(sec=(first + round(seconds * 1e9)) // 10**9, nanosec=first % 10**9))

    ask("pause", "Pause")
    assert ask("is_paused", "IsPaused") is True
    shop.client.spin_for(0.3)
    heard.clear()
    shop.client.spin_for(0.5)
    assert not heard, "time goes on while paused"
    assert ask("play_next", "PlayNext") is True
    assert ask("burst", "Burst", 5) == 5
    ask("toggle_paused", "TogglePaused")
    assert ask("is_paused", "IsPaused") is False
    assert ask("get_rate", "GetRate") == 1.0
    assert seek(8.0) is True
    assert seek(1000.0) is False
    assert 7.9 < at() < 10.0
    assert ask("set_rate", "SetRate", 0.5) is True
    assert ask("set_rate", "SetRate", -1.0) is False
    assert 7.9 < at() < 10.0, "the rate jumped"
    position = Parameter("position", value=3.0).to_parameter_msg()
    shop.client.call(SetParameters, "replay/set_parameters", SetParameters.Request(parameters=[position]))
    shop.client.spin_for(1.0)
    before = at()
    assert ask("set_rate", "SetRate", 2.0) is True
    after = at()
    assert 3.0 < before < 6.0, before
    assert after > before, f"the rate jumped back from {before:.2f} to {after:.2f} s"
    ask("stop", "Stop")
    replay.wait_for("finished", 20.0)
    assert replay.stop() == 0
    return "11 services; 2 rates after seeks"


@check("a recorder that stood still for 6 s at 250 Hz has lost nothing")
def stalled(shop: Workshop) -> str:
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"))
    recorder.wait_until_active()
    publisher = shop.client.node.create_publisher(Imu, "imu/data", QoSProfile(depth=4000))
    shop.client.until(lambda: publisher.get_subscription_count() == 1)
    began, sent = time.monotonic(), 0
    stopped = continued = False
    while sent < 2250:
        publisher.publish(Imu())
        sent += 1
        if sent == 250 and not stopped:
            recorder.signal(signal.SIGSTOP)
            stopped = True
        if sent == 1750 and not continued:
            recorder.signal(signal.SIGCONT)
            continued = True
        time.sleep(max(began + sent / 250 - time.monotonic(), 0.0))
    shop.client.spin_for(1.0)
    assert recorder.stop() == 0
    count = len(read_bag(shop.folder / "bag")["imu/data"])
    assert count == sent, f"{sent - count} of {sent} lost"
    return f"{sent} messages"
