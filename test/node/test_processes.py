"""The nodes as processes, each test in a ROS domain of its own."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest

from marks import exam_except
from ros_probe import probe
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.imu import encode_mtdata2
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.samples import imu
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording, Sample
from vsense_ros.node.ports import PtyPort, SlcanAdapter, TcpPort
from vsense_ros.node.processes import NodeProcess, free_domain, ros_environment

pytestmark = pytest.mark.slow

START = 1_700_000_000_000_000_000
NMEA = (
    b"$GNRMC,101112.{0:02d}0,A,4807.0380000,N,01131.0000000,E,22.4000,84.4000,{1}*",
    b"$GNGGA,101112.{0:02d}0,4807.0380000,N,01131.0000000,E,4,12,0.8,545.400,M,46.9,M,,*",
)
DBC = """VERSION ""
BU_: ECU
BO_ 170 WHEELS: 8 ECU
 SG_ FL : 7|16@0+ (0.01,0) [0|250] "km/h" X
 SG_ FR : 23|16@0+ (0.01,0) [0|250] "km/h" X
 SG_ RL : 39|16@0+ (0.01,0) [0|250] "km/h" X
 SG_ RR : 55|16@0+ (0.01,0) [0|250] "km/h" X
"""
MAPPING = """name: test car
outputs:
  - kind: joint_state
    topic: vehicle/wheel_speeds
    message: WHEELS
    field: velocity
    joints:
      wheel_fl: {signals: [FL], unit: km/h, rolling_radius: 0.3}
      wheel_fr: {signals: [FR], unit: km/h, rolling_radius: 0.3}
      wheel_rl: {signals: [RL], unit: km/h, rolling_radius: 0.3}
      wheel_rr: {signals: [RR], unit: km/h, rolling_radius: 0.3}
"""

Start = Callable[..., NodeProcess]


@pytest.fixture
def environment() -> dict[str, str]:
    return ros_environment(free_domain())


@pytest.fixture
def start(environment: Mapping[str, str]) -> Iterator[Start]:
    running: list[NodeProcess] = []

    def begin(node: str, **parameters: Any) -> NodeProcess:
        running.append(NodeProcess(node, parameters, environment))
        return running[-1]

    yield begin
    for process in running:
        process.stop()


def sentence(body: bytes, *values: object) -> bytes:
    text = body.decode().format(*values).encode()
    checksum = 0
    for byte in text[1:-1]:
        checksum ^= byte
    return text + f"{checksum:02X}\r\n".encode()


def small_drive(seconds: float = 3.0, rate: int = 500) -> Recording:
    """An IMU and wheel speeds, every message different."""
    n = round(seconds * rate)
    stamp = START + np.arange(n) * (1_000_000_000 // rate)
    counter = np.arange(n, dtype=float)[:, None]
    zeros = np.zeros((n, 9))
    inertial = {
        "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        "orientation_covariance": zeros,
        "angular_velocity": np.hstack([counter, 0 * counter, -counter]),
        "angular_velocity_covariance": zeros,
        "linear_acceleration": np.hstack([counter, counter, 9.81 + 0 * counter]),
        "linear_acceleration_covariance": zeros,
    }
    wheels = {"position": np.zeros((n, 0)), "velocity": counter + np.arange(4) / 4, "effort": np.zeros((n, 0))}
    names = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    return Recording(
        {
            "imu/data": Channel("imu/data", "sensor_msgs/msg/Imu", stamp, stamp, inertial, "imu_link"),
            "vehicle/wheel_speeds": Channel(
                "vehicle/wheel_speeds", "sensor_msgs/msg/JointState", stamp, stamp, wheels, "", names
            ),
        }
    )


def recorded(process: NodeProcess, bag: Path) -> Recording:
    assert process.stop() == 0, process.output
    return read_bag(bag)


def test_nmea_bytes_at_a_pty_become_fixes_and_velocities(start: Start, tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "gnss"))
    driver = start("gps_driver", port=str(tmp_path / "gnss"))
    recorder = start("recorder", bag=str(tmp_path / "bag"))
    driver.wait_until_active()
    recorder.wait_until_active()
    driver.wait_for("connected", 15.0)
    while not port.ready():
        time.sleep(0.02)
    today = time.strftime("%d%m%y", time.gmtime())
    for tenth in range(0, 100, 10):
        data = sentence(NMEA[0], tenth, f"{today},,,A") + sentence(NMEA[1], tenth)
        assert port.write(b"\xff$GARBAGE\r\n" + data) == 0
        time.sleep(0.02)
    time.sleep(0.5)
    driver.stop()
    port.close()
    bag = recorded(recorder, tmp_path / "bag")
    fix, velocity = bag["gps/fix"], bag["gps/velocity"]
    assert len(fix) == len(velocity) == 10
    assert np.diff(fix.stamp).tolist() == [100_000_000] * 9
    np.testing.assert_allclose(fix.columns["latitude"], 48 + 7.038 / 60, atol=1e-9)
    np.testing.assert_allclose(fix.columns["altitude"], 545.4 + 46.9)
    speed = 22.4 * 1852 / 3600
    east, north = speed * np.sin(np.radians(84.4)), speed * np.cos(np.radians(84.4))
    np.testing.assert_allclose(velocity.columns["linear"][:, :2], [[east, north]] * 10, atol=1e-6)


def test_imu_bytes_over_tcp_become_imu_messages_in_vehicle_axes_also_after_the_port_was_gone(
    start: Start, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
    recorder = start("recorder", bag=str(tmp_path / "bag"))
    driver = start("imu_driver", port=f"socket://127.0.0.1:{number}", mounting="x,-y,-z")
    driver.wait_until_active()  # though nobody listens there yet
    recorder.wait_until_active()
    driver.wait_for("connected", 15.0)
    now = time.time_ns()
    for life in range(2):
        port = TcpPort(f"127.0.0.1:{number}")
        while not port.ready():
            time.sleep(0.02)
        for i in range(50):
            count = 50 * life + i
            sample = imu(
                "",
                now + count * 10_000_000,
                "",
                angular_velocity=[0.01 * count, 0.1, 0.2],
                linear_acceleration=[0.5, 1.0, -9.81],
            )
            assert port.write(encode_mtdata2(sample, count)) == 0
        time.sleep(0.3)
        port.close()
    assert driver.stop() == 0
    channel = recorded(recorder, tmp_path / "bag")["imu/data"]
    assert len(channel) == 100
    assert channel.frame_id == "imu_link"
    np.testing.assert_allclose(channel.columns["angular_velocity"][:, 0], 0.01 * np.arange(100), atol=1e-6)
    np.testing.assert_allclose(channel.columns["linear_acceleration"], [[0.5, -1.0, 9.81]] * 100, atol=1e-6)


def wheel_frame(kph: float) -> can.Message:
    data = b"".join(round((kph + wheel) * 100).to_bytes(2, "big") for wheel in range(4))
    return can.Message(arbitration_id=170, data=data, is_extended_id=False)


def can_settings(folder: Path, interface: str, channel: str) -> dict[str, Any]:
    """Parameters of a `can_driver` for the bus of the test car."""
    (folder / "car.dbc").write_text(DBC)
    (folder / "car.yaml").write_text(MAPPING)
    return {
        "interface": interface,
        "channel": channel,
        "database": str(folder / "car.dbc"),
        "mapping": str(folder / "car.yaml"),
    }


def test_can_frames_on_a_multicast_bus_become_wheel_speeds(start: Start, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe_socket:
        probe_socket.bind(("", 0))
        number = probe_socket.getsockname()[1]
    bus_at: dict[str, Any] = {"channel": "239.74.163.2", "interface": "udp_multicast", "port": number, "hop_limit": 0}
    try:
        with can.Bus(**bus_at) as sender, can.Bus(**bus_at) as receiver:
            sender.send(wheel_frame(0.0))
            if receiver.recv(1.0) is None:
                pytest.skip("multicast does not come back on this machine (no route for it)")
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast on this machine: {error}")
    driver = start("can_driver", port=number, **can_settings(tmp_path, "udp_multicast", bus_at["channel"]))
    recorder = start("recorder", bag=str(tmp_path / "bag"))
    driver.wait_until_active()
    recorder.wait_until_active()
    driver.wait_for("connected", 15.0)
    with can.Bus(**bus_at) as sender:
        for kph in range(50):
            sender.send(wheel_frame(kph))
            sender.send(can.Message(arbitration_id=0x123, data=b"other", is_extended_id=False))
            time.sleep(0.005)
    time.sleep(0.5)
    assert driver.stop() == 0
    channel = recorded(recorder, tmp_path / "bag")["vehicle/wheel_speeds"]
    expected = (np.arange(50)[:, None] + np.arange(4)) / 3.6 / 0.3
    np.testing.assert_allclose(channel.columns["velocity"], expected, atol=1e-9)


def test_a_can_log_replayed_onto_a_bus_reaches_the_driver_frame_by_frame(start: Start, tmp_path: Path) -> None:
    with can.CanutilsLogWriter(str(tmp_path / "drive.log")) as writer:
        for i in range(400):
            frame = wheel_frame(0.5 * i)
            frame.timestamp, frame.channel = START * 1e-9 + 0.005 * i, "can0"
            writer.on_message_received(frame)
    recorder = start("recorder", bag=str(tmp_path / "bag"), use_sim_time=True)
    driver = start("can_driver", use_sim_time=True, **can_settings(tmp_path, "slcan", str(tmp_path / "can")))
    driver.wait_until_active()
    recorder.wait_until_active()
    driver.wait_for("connected", 15.0)
    replay = start("replay", can_log=str(tmp_path / "drive.log"), can_channel=str(tmp_path / "can"), consumers=1)
    assert replay.wait_until_ended(60.0) == 0, replay.output
    time.sleep(0.3)
    assert driver.stop() == 0
    channel = recorded(recorder, tmp_path / "bag")["vehicle/wheel_speeds"]
    expected = (0.5 * np.arange(400)[:, None] + np.arange(4)) / 3.6 / 0.3
    np.testing.assert_allclose(channel.columns["velocity"], expected, atol=1e-9)
    # In the time of the log: arrivals jitter by what the machine's scheduling does, but do not drift.
    late = (channel.stamp - (START + np.arange(400) * 5_000_000)) * 1e-9
    assert abs(np.median(late)) < 0.05


@pytest.mark.parametrize(
    ("garbled", "words"),
    exam_except(
        [(b"t0AG81A6F\r", "broken frames"), (b"t0A\r", "broken frames"), (b"t0AA81A\xff\r", "broken frames")],
        (b"t0A\r", "broken frames"),
    ),
)
def test_a_garbled_line_of_a_can_adapter_does_not_end_reception(
    start: Start, environment: Mapping[str, str], tmp_path: Path, garbled: bytes, words: str
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    adapter = SlcanAdapter(str(tmp_path / "can"))
    start("can_driver", **can_settings(tmp_path, "slcan", str(tmp_path / "can"))).wait_until_active()
    with probe(environment) as client:
        speeds = client.listen(JointState, "vehicle/wheel_speeds")
        told = client.listen(DiagnosticArray, "diagnostics")

        def frames_arrive() -> bool:
            adapter.send(wheel_frame(36.0))
            return bool(speeds)

        client.until(frames_arrive)
        os.write(adapter._port.master, garbled)
        speeds.clear()
        client.until(
            lambda: frames_arrive() and any(words in line.message for message in told for line in message.status)
        )
    adapter.close()


@pytest.fixture
def here(environment: Mapping[str, str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """Makes one node in the tests' own process."""
    import rclpy

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made: list[Any] = []

    def make(node_type: type, model: type, **settings: Any) -> Any:
        parameters = [part for name, value in settings.items() for part in ("-p", f"{name}:={value}")]
        rclpy.init(args=["--ros-args", *parameters], domain_id=int(environment["ROS_DOMAIN_ID"]))
        made.append(node_type("node_here", model))
        made[0].trigger_configure()
        made[0].trigger_activate()
        return made[0]

    yield make
    for node in made:
        node.trigger_shutdown()
        node.destroy_node()
        rclpy.shutdown()


def test_a_fault_that_nobody_foresaw_in_a_frame_is_told_and_frames_are_read_on(
    here: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vsense_ros.node.can_driver import CanDriver, CanDriverParameters

    taken: list[int] = []

    def feed(decoder: CanDecoder, frame: can.Message, received: int) -> list[Sample]:
        taken.append(frame.arbitration_id // (frame.arbitration_id - 0x666))
        return []

    monkeypatch.setattr(CanDecoder, "feed", feed)
    driver = here(CanDriver, CanDriverParameters, **can_settings(tmp_path, "virtual", "faults"))
    with can.Bus(interface="virtual", channel="faults") as bus:

        def send_until(condition: Callable[[], bool], identifier: int) -> None:
            deadline = time.monotonic() + 10.0
            while not condition():
                assert time.monotonic() < deadline
                bus.send(can.Message(arbitration_id=identifier, is_extended_id=False))
                time.sleep(0.02)

        send_until(lambda: "ZeroDivisionError" in driver.diagnostics()[0].message, 0x666)
        send_until(lambda: bool(taken), 0x667)


def test_a_fault_that_nobody_foresaw_in_a_sentence_does_not_come_back_with_the_next_bytes(
    here: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vsense_ros.node.gps_driver import GpsDriver, GpsDriverParameters

    monkeypatch.setattr(NmeaDecoder, "_heading", lambda *_: 1 // 0)
    driver = here(GpsDriver, GpsDriverParameters, port=str(tmp_path / "none"))
    rmc = sentence(NMEA[0], 0, "170524,,,A")
    with pytest.raises(ZeroDivisionError):
        driver._on_bytes(rmc + sentence(b"$GNHDT,90.0,T*"), START)
    driver._on_bytes(rmc, START)
    assert driver.outputs.published["gps/velocity"] == 1


@pytest.mark.exam
def test_a_can_log_whose_times_count_from_its_start_is_replayed_after_the_lead_of_the_clock(
    start: Start, tmp_path: Path
) -> None:
    frames = [f"({0.005 * i:.6f}) can0 0AA#{wheel_frame(0.5 * i).data.hex()}\n" for i in range(200)]
    (tmp_path / "drive.log").write_text("".join(frames))
    recorder = start("recorder", bag=str(tmp_path / "bag"), use_sim_time=True)
    driver = start("can_driver", use_sim_time=True, **can_settings(tmp_path, "slcan", str(tmp_path / "can")))
    driver.wait_until_active()
    recorder.wait_until_active()
    driver.wait_for("connected", 15.0)
    replay = start("replay", can_log=str(tmp_path / "drive.log"), can_channel=str(tmp_path / "can"), lead=2.0)
    assert replay.wait_until_ended(60.0) == 0, replay.output
    time.sleep(0.3)
    assert driver.stop() == 0
    channel = recorded(recorder, tmp_path / "bag")["vehicle/wheel_speeds"]
    np.testing.assert_allclose(channel.columns["velocity"][:, 0], 0.5 * np.arange(200) / 3.6 / 0.3, atol=1e-9)
    assert np.median(channel.stamp * 1e-9 - 0.005 * np.arange(200)) == pytest.approx(2.0, abs=0.05)


def test_a_bag_replayed_as_fast_as_can_be_is_recorded_without_loss(start: Start, tmp_path: Path) -> None:
    drive = small_drive(20.0)
    write_bag(tmp_path / "drive", drive)
    recorder = start("recorder", bag=str(tmp_path / "copy"), use_sim_time=True)
    recorder.wait_until_active()
    replay = start("replay", bag=str(tmp_path / "drive"), rate=0)
    assert replay.wait_until_ended(120.0) == 0, replay.output
    copy = recorded(recorder, tmp_path / "copy")
    for topic, channel in drive.channels.items():
        assert copy[topic].names == channel.names
        np.testing.assert_array_equal(copy[topic].stamp, channel.stamp)
        for field, column in channel.columns.items():
            np.testing.assert_array_equal(copy[topic].columns[field], column, err_msg=f"{topic} {field}")


def test_a_consumer_that_had_no_processor_when_the_topics_were_announced_gets_every_message(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    """Another one has heard of them all: what the replay waits for is each consumer, not a subscriber of each topic."""
    drive = small_drive(5.0)
    write_bag(tmp_path / "drive", drive)
    with ExitStack() as running:

        def record(name: str) -> NodeProcess:
            parameters = {"bag": str(tmp_path / name), "use_sim_time": True}
            return running.enter_context(NodeProcess("recorder", parameters, environment, name=name))

        prompt, held_up = record("prompt"), record("held_up")
        for recorder in (prompt, held_up):
            recorder.wait_until_active()
        _replay_while_one_is_held_up(start, tmp_path / "drive", held_up)
        for recorder in (prompt, held_up):
            copy = recorded(recorder, tmp_path / recorder.name)
            for topic, channel in drive.channels.items():
                np.testing.assert_array_equal(copy[topic].stamp, channel.stamp)


def test_a_recorder_says_that_it_listens_only_to_who_knows_its_newest_subscription(
    here: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay that knows older ones alone would send its first messages to nobody."""
    from std_msgs.msg import Header

    from vsense_ros.node.recorder import Recorder, RecorderParameters

    recorder = here(Recorder, RecorderParameters, bag=str(tmp_path / "bag"))
    said: list[Header] = []
    monkeypatch.setattr(recorder.answers, "_listening", SimpleNamespace(publish=said.append))
    asked = recorder.answers.question.topic
    publisher = recorder.create_publisher(Header, "vehicle/something", 1)
    deadline = time.monotonic() + 10.0
    while recorder.count_publishers("vehicle/something") == 0 and time.monotonic() < deadline:
        time.sleep(0.01)
    recorder.answers.answer(asked)  # finds the new topic
    recorder.answers.answer(asked)  # which whoever asks there may not know
    assert not said
    recorder.answers.answer(recorder.answers.question.topic)
    assert [message.frame_id for message in said] == [recorder.get_fully_qualified_name()]
    recorder.trigger_deactivate()
    recorder.answers.expect_question()
    recorder.answers.answer(recorder.answers.question.topic)
    assert len(said) == 1
    monkeypatch.undo()
    recorder.destroy_publisher(publisher)


def test_a_node_knows_the_time_as_soon_as_its_own_reader_has_heard_the_clock(
    here: Callable[..., Any], tmp_path: Path
) -> None:
    """rclpy's own may still know of nobody who tells it: what came meanwhile was not recorded."""
    from rclpy.executors import SingleThreadedExecutor
    from rosgraph_msgs.msg import Clock

    from vsense_ros.node.recorder import Recorder, RecorderParameters

    recorder = here(Recorder, RecorderParameters, bag=str(tmp_path / "bag"), use_sim_time=True)
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    assert recorder.now() == 0
    message = Clock()
    message.clock.sec = 7
    recorder._on_clock(message)
    executor.remove_node(recorder)
    assert recorder.now() == 7_000_000_000


def _replay_while_one_is_held_up(start: Start, bag: Path, held_up: NodeProcess) -> None:
    held_up.signal(signal.SIGSTOP)
    try:
        replay = start("replay", bag=str(bag), rate=0, consumers=2, wait=60.0)
        replay.wait_for("active", 60.0)
        time.sleep(1.0)
        assert not replay.says("begins")
    finally:
        held_up.signal(signal.SIGCONT)
    assert replay.wait_until_ended(120.0) == 0, replay.output


@pytest.mark.parametrize(
    "first", exam_except([True, False], True), ids=["a publisher that was there", "a publisher that comes later"]
)
def test_publishers_with_best_effort_are_heard_like_all_others(
    start: Start, environment: Mapping[str, str], tmp_path: Path, first: bool
) -> None:
    from builtin_interfaces.msg import Time
    from rclpy.qos import qos_profile_sensor_data
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu
    from std_msgs.msg import Header

    def record() -> NodeProcess:
        recorder = start("recorder", bag=str(tmp_path / "bag"), topics=["imu/data"], use_sim_time=True)
        recorder.wait_until_active()
        return recorder

    with probe(environment) as client:
        recorder = None if first else record()
        clock = client.node.create_publisher(Clock, "/clock", qos_profile_sensor_data)
        inertial = client.node.create_publisher(Imu, "imu/data", qos_profile_sensor_data)
        recorder = recorder or record()
        progress = client.listen(Header, "vsense/progress")
        client.until(lambda: inertial.get_subscription_count() > 0)
        for second in range(100):
            clock.publish(Clock(clock=Time(sec=1 + second)))
            inertial.publish(Imu())
            client.spin_for(0.02)
        client.until(lambda: bool(progress) and progress[-1].stamp.sec == 100)
    assert len(recorded(recorder, tmp_path / "bag")["imu/data"]) > 90


def test_a_recorder_tells_which_of_its_topics_nobody_publishes_and_on_which_nothing_comes(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState, NavSatFix

    topics = ["gps/fix", "vehicle/steering", "vehicle/wheel_speeds"]
    recorder = start("recorder", bag=str(tmp_path / "bag"), topics=topics)
    recorder.wait_until_active()
    with probe(environment) as client:
        health = client.listen(DiagnosticArray, "diagnostics")
        client.listen(NavSatFix, "gps/fix")
        client.node.create_publisher(JointState, "vehicle/steering", 10)
        wheels = client.node.create_publisher(JointState, "vehicle/wheel_speeds", 10)
        client.until(lambda: wheels.get_subscription_count() == 1)
        wheels.publish(JointState(name=["wheel_fl"], velocity=[1.0]))
        expected = "nobody publishes gps/fix; nothing came yet on vehicle/steering"
        client.until(lambda: bool(health) and health[-1].status[0].message == expected)


@pytest.mark.exam
def test_a_recorder_tells_times_of_arrival_also_after_the_clock_was_set_back(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from builtin_interfaces.msg import Time
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    pace = 0.15  # [s] in which the other process has seen a message, on a busy machine too
    recorder = start("recorder", bag=str(tmp_path / "bag"), topics=["vehicle/steering"], use_sim_time=True)
    recorder.wait_until_active()
    ticks = [10_000 + i for i in range(20)] + [2_800 + i for i in range(20)]  # [s]
    with probe(environment) as client:
        clock = client.node.create_publisher(Clock, "/clock", 10)
        steering = client.node.create_publisher(JointState, "vehicle/steering", 10)
        client.until(lambda: clock.get_subscription_count() == 2 and steering.get_subscription_count() == 1)
        for second in ticks:
            clock.publish(Clock(clock=Time(sec=second)))
            client.spin_for(pace)
            steering.publish(JointState(name=["steering_wheel"], position=[float(second)]))
            client.spin_for(pace)
    channel = recorded(recorder, tmp_path / "bag")["vehicle/steering"]
    np.testing.assert_array_equal(channel.received, 1_000_000_000 * channel.columns["position"][:, 0])
    assert sorted(channel.received) == sorted(1_000_000_000 * second for second in ticks)


def test_a_recorder_in_simulated_time_waits_for_its_first_clock_message_and_counts_what_it_drops(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    summary = tmp_path / "summary.json"
    recorder = start(
        "recorder", bag=str(tmp_path / "bag"), topics=["vehicle/steering"], use_sim_time=True, summary=str(summary)
    )
    recorder.wait_until_active()
    with probe(environment) as client:
        health = client.listen(DiagnosticArray, "diagnostics")
        clock = client.node.create_publisher(Clock, "/clock", 10)
        steering = client.node.create_publisher(JointState, "vehicle/steering", 10)
        client.until(lambda: clock.get_subscription_count() == 2 and steering.get_subscription_count() == 1)
        for _ in range(5):
            steering.publish(JointState(name=["steering_wheel"], position=[0.1]))
        client.until(lambda: any("no /clock message yet" in s.message for m in health for s in m.status))
        for _ in range(10):
            clock.publish(Clock(clock=Time(sec=1000)))
            client.spin_for(0.02)
            steering.publish(JointState(name=["steering_wheel"], position=[0.1]))
        client.spin_for(0.2)
    channel = recorded(recorder, tmp_path / "bag")["vehicle/steering"]
    assert channel.received.tolist() == [1000_000_000_000] * 10
    assert json.loads(summary.read_text())["before_clock"] == 5


def test_replay_pauses_seeks_and_starts_again_on_request(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import Imu
    from std_srvs.srv import Trigger

    from vsense_ros.node.rosbag2 import service_type

    (pause, *_), (resume, *_) = service_type("Pause"), service_type("Resume")

    write_bag(tmp_path / "drive", small_drive(30.0, rate=100))
    with probe(environment) as client:
        heard = client.listen(Imu, "imu/data")
        replay = start("replay", bag=str(tmp_path / "drive"), topics=["imu/data"], exit_at_end=False, loop=True)
        replay.wait_until_active()
        client.until(lambda: len(heard) > 20)
        client.call(pause, "replay/pause", pause.Request())
        client.spin_for(0.3)
        count = len(heard)
        client.spin_for(0.5)
        assert len(heard) == count

        parameter = Parameter("position", value=29.0).to_parameter_msg()
        result = client.call(SetParameters, "replay/set_parameters", SetParameters.Request(parameters=[parameter]))
        assert result.results[0].successful
        heard.clear()
        client.call(resume, "replay/resume", resume.Request())
        client.until(lambda: len(heard) > 10)
        assert heard[0].angular_velocity.x == pytest.approx(2900, abs=2)
        client.until(lambda: any(m.angular_velocity.x < 100 for m in heard))  # the loop has begun again

        assert client.call(Trigger, "replay/restart", Trigger.Request()).success
        heard.clear()
        client.until(lambda: len(heard) > 3)
        assert heard[-1].angular_velocity.x < 200
        assert replay.stop() == 0


def test_a_node_goes_through_its_lifecycle_on_request(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from sensor_msgs.msg import NavSatFix

    port = PtyPort(str(tmp_path / "gnss"))
    driver = start("gps_driver", port=str(tmp_path / "gnss"), autostart=False)
    with probe(environment) as client:
        heard = client.listen(NavSatFix, "gps/fix")
        health = client.listen(DiagnosticArray, "diagnostics")

        def change(transition: int) -> bool:
            request = ChangeState.Request(transition=Transition(id=transition))
            return client.call(ChangeState, "gps_driver/change_state", request).success

        def state() -> str:
            return client.ask(GetState, "gps_driver/get_state", GetState.Request()).current_state.label

        def send() -> None:
            today = time.strftime("%d%m%y", time.gmtime())
            for tenth in range(0, 100, 10):
                port.write(sentence(NMEA[0], tenth, f"{today},,,A") + sentence(NMEA[1], tenth))

        assert state() == "unconfigured"
        assert change(Transition.TRANSITION_CONFIGURE)
        assert state() == "inactive"
        assert not port.ready()
        assert change(Transition.TRANSITION_ACTIVATE)
        client.until(port.ready)
        time.sleep(0.5)
        send()
        client.until(lambda: len(heard) >= 5)
        client.until(lambda: any(s.name == "/gps_driver: gnss: port" for m in health for s in m.status))
        assert change(Transition.TRANSITION_DEACTIVATE)
        assert not port.ready()
        assert change(Transition.TRANSITION_CLEANUP)
        assert state() == "unconfigured"
        assert change(Transition.TRANSITION_CONFIGURE)
        assert change(Transition.TRANSITION_ACTIVATE)
        heard.clear()
        client.until(port.ready)
        time.sleep(0.5)
        send()
        client.until(lambda: len(heard) >= 5)
    assert driver.stop() == 0
    port.close()


def test_a_node_has_no_socket_that_another_machine_could_reach(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    psutil = pytest.importorskip("psutil", reason="psutil lists the sockets of a process")
    from diagnostic_msgs.msg import DiagnosticArray

    port = PtyPort(str(tmp_path / "gnss"))
    driver = start("gps_driver", port=str(tmp_path / "gnss"))
    with probe(environment) as client:  # which looks for others as any program of ROS on this machine
        health = client.listen(DiagnosticArray, "diagnostics")
        client.until(lambda: bool(health))
        sockets = psutil.Process(driver.pid).net_connections(kind="inet")
    assert sockets
    assert {socket.laddr.ip for socket in sockets} == {"127.0.0.1"}
    port.close()


def test_an_observer_that_hears_no_sensor_any_more_says_that_its_estimate_is_old(
    start: Start, environment: Mapping[str, str]
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from sensor_msgs.msg import JointState

    observer = start("observer", vehicle="rav4")
    observer.wait_until_active(180.0)
    with probe(environment) as client:
        health = client.listen(DiagnosticArray, "diagnostics")
        wheels = client.node.create_publisher(JointState, "vehicle/wheel_speeds", 10)
        steering = client.node.create_publisher(JointState, "vehicle/steering", 10)
        client.until(lambda: wheels.get_subscription_count() == steering.get_subscription_count() == 1)

        def told() -> tuple[bytes, str]:
            return next(
                ((s.level, s.message) for m in health[-1:] for s in m.status if s.name == "/observer: observer"),
                (b"", ""),
            )

        def drive() -> bool:
            message = JointState(name=["wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"], velocity=[30.0] * 4)
            message.header.stamp = client.node.get_clock().now().to_msg()
            wheels.publish(message)
            message.name, message.velocity, message.position = ["steering_wheel"], [], [0.0]
            steering.publish(message)
            return told() == (
                DiagnosticStatus.ERROR,
                "heading unknown until GNSS comes, without imu: no message on imu/data",
            )

        client.until(drive)
        client.until(lambda: told()[0] == DiagnosticStatus.STALE)
        assert told()[1] == "no sensor is heard any more: the estimate is an old one"


def test_an_observer_names_topics_whose_stamps_are_too_far_behind_those_of_others(
    start: Start, environment: Mapping[str, str]
) -> None:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import TwistWithCovarianceStamped
    from sensor_msgs.msg import JointState

    words = "stamps of vehicle/wheel_speeds are 3.0 s behind those of gps/velocity; are the clocks synchronised?"
    observer = start("observer", vehicle="rav4")
    observer.wait_until_active(180.0)
    with probe(environment) as client:
        health = client.listen(DiagnosticArray, "diagnostics")
        wheels = client.node.create_publisher(JointState, "vehicle/wheel_speeds", 10)
        velocity = client.node.create_publisher(TwistWithCovarianceStamped, "gps/velocity", 10)
        client.until(lambda: wheels.get_subscription_count() == velocity.get_subscription_count() == 1)

        def told() -> bool:
            now = time.time_ns()
            message = JointState(name=["wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"], velocity=[30.0] * 4)
            message.header.stamp = Time(sec=now // 10**9 - 3, nanosec=now % 10**9)
            wheels.publish(message)
            twist = TwistWithCovarianceStamped()
            twist.header.frame_id = "map"
            twist.header.stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
            twist.twist.twist.linear.x = 10.0
            velocity.publish(twist)
            return words in [s.message for m in health[-1:] for s in m.status if s.name == "/observer: clocks"]

        client.until(told)


def run_node(environment: Mapping[str, str], node: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", f"vsense_ros.node.{node}", "--ros-args", *arguments]
    return subprocess.run(command, env=dict(environment), capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize(
    ("node", "arguments", "words"),
    exam_except(
        [
            ("gps_driver", ["-p", "port:=/dev/x", "-p", "protocol:=sirf"], "parameter protocol is 'sirf'"),
            ("gps_driver", [], "parameter port is empty"),
            ("imu_driver", ["-p", "port:=/dev/x", "-p", "mounting:=x,y,y"], "is no rotation"),
            ("imu_driver", ["-p", "prot:=/dev/x"], "no parameter 'prot'"),
            ("can_driver", ["-p", "database:=/none.dbc", "-p", "mapping:=/none.yaml"], "/none.dbc: no such file"),
            ("observer", ["-p", "vehicle:=batmobile"], "no vehicle file 'batmobile'"),
            ("observer", ["-p", "vehicle:=genesis", "-p", "rate:=-1.0"], "parameter rate is -1.0"),
            ("replay", ["-p", "bag:=/nowhere"], "/nowhere"),
            ("replay", [], "nothing to replay"),
            ("recorder", [], "parameter bag is empty"),
            ("recorder", ["-p", "bag:=/proc/bag"], "/proc/bag: cannot be written: "),
        ],
        ("imu_driver", ["-p", "prot:=/dev/x"], "no parameter 'prot'"),
        ("can_driver", ["-p", "database:=/none.dbc", "-p", "mapping:=/none.yaml"], "/none.dbc: no such file"),
        ("observer", ["-p", "vehicle:=batmobile"], "no vehicle file 'batmobile'"),
        ("recorder", ["-p", "bag:=/proc/bag"], "/proc/bag: cannot be written: "),
    ),
)
def test_bad_input_ends_a_node_with_one_line_and_exit_code_2(
    environment: Mapping[str, str], node: str, arguments: list[str], words: str
) -> None:
    ended = run_node(environment, node, *arguments)
    assert ended.returncode == 2, ended.stderr
    lines = ended.stderr.strip().splitlines()
    assert len(lines) == 1, ended.stderr
    assert words in lines[0]


def test_a_recorder_does_not_touch_what_is_no_bag(environment: Mapping[str, str], tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    ended = run_node(environment, "recorder", "-p", f"bag:={tmp_path}", "-p", "overwrite:=true")
    assert ended.returncode == 2
    assert "no bag" in ended.stderr
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


@pytest.mark.exam
def test_a_recorder_that_is_started_again_goes_on_beside_what_it_has_recorded(start: Start, tmp_path: Path) -> None:
    for _ in range(3):
        recorder = start("recorder", bag=str(tmp_path / "bag"))
        recorder.wait_until_active()
        recorder._process.kill()
        recorder.wait_until_ended(10.0)
    assert sorted(file.name for file in tmp_path.rglob("*.mcap")) == ["bag_0.mcap", "bag_1_0.mcap", "bag_2_0.mcap"]


def test_a_recorder_whose_disk_is_full_says_so_and_leaves_what_it_has_recorded(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from sensor_msgs.msg import Imu

    # A limit of the size of its files stands for the end of the disk.
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, limits[1]))
    try:
        recorder = start("recorder", bag=str(tmp_path / "bag"), topics=["imu/data"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    recorder.wait_until_active()
    noise = np.random.default_rng(5).random((3000, 2, 9))  # nothing that could be compressed
    with probe(environment) as client:
        health = client.listen(DiagnosticArray, "diagnostics")
        inertial = client.node.create_publisher(Imu, "imu/data", 3000)
        client.until(lambda: inertial.get_subscription_count() == 1)
        for one, other in noise:
            inertial.publish(Imu(orientation_covariance=one, linear_acceleration_covariance=other))
        client.until(lambda: any("cannot be written any more" in s.message for m in health for s in m.status))
        assert health[-1].status[0].level == DiagnosticStatus.ERROR
    assert recorder.exit_code is None
    assert recorder.stop() == 1
    assert "Traceback" not in recorder.output
    assert 500 < len(read_bag(tmp_path / "bag")["imu/data"]) < 3000


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_in_good_order(start: Start, tmp_path: Path, number: signal.Signals) -> None:
    recorder = start("recorder", bag=str(tmp_path / "bag"))
    recorder.wait_until_active()
    recorder._process.send_signal(number)
    assert recorder.wait_until_ended(10.0) == 0
    assert "Traceback" not in recorder.output
    assert (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_node_that_is_ended_works_off_what_has_come(
    start: Start, environment: Mapping[str, str], tmp_path: Path
) -> None:
    """Three thousand messages at once, more than it has read when the signal comes."""
    from geometry_msgs.msg import Vector3Stamped
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile

    recorder = start("recorder", bag=str(tmp_path / "bag"), topics=["some/topic"])
    recorder.wait_until_active()
    with probe(environment) as client:
        publisher = client.node.create_publisher(Vector3Stamped, "some/topic", QoSProfile(depth=4000))
        client.until(lambda: publisher.get_subscription_count() == 1)
        for _ in range(3000):
            publisher.publish(Vector3Stamped())
        assert publisher.wait_for_all_acked(Duration(seconds=10))
        recorder.signal(signal.SIGINT)
        assert recorder.wait_until_ended(10.0) == 0
    assert len(read_bag(tmp_path / "bag")["some/topic"]) == 3000


def test_a_node_that_fails_is_reported_with_its_words(start: Start) -> None:
    with pytest.raises(InputError, match=r"node observer ended with 2: .*vehicle is empty"):
        start("observer").wait_until_active()
