"""Bags with any names and types of topics: what is proposed for them, and what is read with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.bag import write_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.guess import guess
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import TOPICS

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "double_lane_change"
NAMES = {
    "imu/data": "sensing/imu/tamagawa/imu_raw",
    "gps/fix": "ublox/fix",
    "gps/velocity": "ublox/fix_velocity",
    "vehicle/wheel_speeds": "joint_states",
    "vehicle/steering": "steering_joint",
}
JOINTS = {"wheel_fl": "front_left_wheel", "wheel_fr": "front_right_wheel", "wheel_rl": "rear_left_wheel",
          "wheel_rr": "rear_right_wheel", "steering_wheel": "steering_wheel_joint"}  # fmt: skip


def renamed(channel: Channel, topic: str) -> Channel:
    names = tuple(JOINTS[name] for name in channel.names)
    return Channel(topic, channel.kind, channel.stamp, channel.received, channel.columns, "somewhere", names)


@pytest.fixture(scope="module")
def original() -> Recording:
    return vs.read(BAG)


@pytest.fixture
def foreign(original, tmp_path) -> Path:
    """The drive under names of other people's drivers."""
    channels = {name: renamed(original[topic], name) for topic, name in NAMES.items()}
    write_bag(tmp_path / "foreign", Recording(channels))
    return tmp_path / "foreign"


def test_the_proposed_mapping_reads_unedited_what_the_bag_says(foreign, original, tmp_path):
    """Whatever topics, joints and frames are called, the sensors of a vehicle file find their messages."""
    (tmp_path / "topics.yaml").write_text(guess(foreign).text, encoding="utf-8")
    recording = import_recording(foreign, mapping=tmp_path / "topics.yaml")
    for topic in NAMES:
        mine, theirs = recording[topic], original[topic]
        assert (mine.kind, mine.names) == (theirs.kind, theirs.names)
        assert mine.frame_id == (TOPICS[topic].frame_id or "somewhere")
        np.testing.assert_array_equal(mine.stamp, theirs.stamp)
        for field, values in theirs.columns.items():
            np.testing.assert_array_equal(mine.columns[field], values)


def test_the_command_prints_the_proposal_for_a_folder(foreign):
    done = CliRunner().invoke(main, ["import", str(foreign), "--guess"])
    assert done.exit_code == 0, done.output
    assert "imu/data: /sensing/imu/tamagawa/imu_raw" in done.output
    assert "# /ublox/fix_velocity: a velocity to the east and north" in done.output


def test_a_topic_with_its_name_but_another_frame_gets_the_frame_of_its_sensor(original, tmp_path):
    imu = original["imu/data"]
    moved = Channel(imu.topic, imu.kind, imu.stamp, imu.received, imu.columns, "imu")
    write_bag(tmp_path / "bag", Recording({"imu/data": moved}))
    (tmp_path / "topics.yaml").write_text(guess(tmp_path / "bag").text, encoding="utf-8")
    assert import_recording(tmp_path / "bag", mapping=tmp_path / "topics.yaml")["imu/data"].frame_id == "imu_link"


def test_a_velocity_forward_is_told_from_one_over_ground(original, tmp_path):
    """Both are TwistStamped, under names that say nothing."""
    ground, wheels = original["gps/velocity"], original["vehicle/wheel_speeds"]
    speed = 0.27 * wheels.columns["velocity"].mean(axis=1)
    zero = np.zeros((len(speed), 3))
    body = {"linear": np.column_stack([speed, zero[:, :2]]), "angular": zero}
    kind = "geometry_msgs/msg/TwistStamped"
    over_ground = {field: ground.columns[field] for field in ("linear", "angular")}
    channels = {
        "a": Channel("a", kind, wheels.stamp, wheels.received, body),
        "b": Channel("b", kind, ground.stamp, ground.received, over_ground),
        "c": renamed(original["gps/fix"], "c"),
    }
    write_bag(tmp_path / "bag", Recording(channels))
    (tmp_path / "topics.yaml").write_text(guess(tmp_path / "bag").text, encoding="utf-8")
    recording = import_recording(tmp_path / "bag", mapping=tmp_path / "topics.yaml")
    np.testing.assert_array_equal(recording["gps/velocity"].columns["linear"], ground.columns["linear"])
    np.testing.assert_allclose(recording["vehicle/velocity"].columns["linear"][:, 0], speed)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_reports_of_autoware_and_poses_are_read_with_their_values(storage, tmp_path):
    """The bag is written by rosbags, from Autoware's own definitions."""
    rosbags = pytest.importorskip("rosbags.rosbag2", reason="needs requirements/formats.txt")
    typesys = pytest.importorskip("rosbags.typesys", reason="needs requirements/formats.txt")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    velocity_report, steering_report = (
        "autoware_vehicle_msgs/msg/VelocityReport",
        "autoware_vehicle_msgs/msg/SteeringReport",
    )
    definitions = {
        velocity_report: "std_msgs/Header header\nfloat32 longitudinal_velocity\nfloat32 lateral_velocity\n"
        "float32 heading_rate\n",
        steering_report: "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle\n",
    }
    for kind, text in definitions.items():
        store.register(typesys.get_types_from_msg(text, kind))
    types = store.types
    pose_kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    plugin = getattr(rosbags.StoragePlugin, storage)
    with rosbags.Writer(tmp_path / "autoware", version=9, storage_plugin=plugin) as writer:
        connections = {
            kind: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in (("/v", velocity_report), ("/s", steering_report), ("/p", pose_kind))
        }
        for row in range(20):
            stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=row * 10_000_000)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
            point = types["geometry_msgs/msg/Point"](x=float(row), y=2.0, z=3.0)
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
            with_covariance = types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.full(36, 0.25))
            messages = (
                types[velocity_report](header, 10.0 + row, 0.5, 0.125),
                types[steering_report](stamp, 0.25),
                types[pose_kind](header, with_covariance),
            )
            for message in messages:
                data = store.serialize_cdr(message, message.__msgtype__)
                time = 1_700_000_000_000_000_000 + row * 10_000_000
                writer.write(connections[message.__msgtype__], time, data)
    mapping = {"topics": {"vehicle/velocity": "/v", "vehicle/steering": "/s", "reference/odometry": "/p"}}
    recording = import_recording(tmp_path / "autoware", mapping=mapping)
    velocity = recording["vehicle/velocity"]
    np.testing.assert_array_equal(velocity.columns["linear"][:, 0], 10.0 + np.arange(20))
    np.testing.assert_array_equal(velocity.columns["linear"][:, 1], 0.5)
    np.testing.assert_array_equal(velocity.columns["angular"][:, 2], 0.125)
    assert velocity.stamp[3] == 1_700_000_000_030_000_000
    steering = recording["vehicle/steering"]
    assert steering.names == ("road_wheel_front",)
    np.testing.assert_array_equal(steering.columns["position"], 0.25)
    pose_read = recording["reference/odometry"]
    np.testing.assert_array_equal(pose_read.columns["position"][:, 0], np.arange(20.0))
    np.testing.assert_array_equal(pose_read.columns["pose_covariance"], 0.25)
    assert np.isnan(pose_read.columns["linear"]).all()
    assert yaml_topics(guess(tmp_path / "autoware").text) >= {"vehicle/velocity", "vehicle/steering"}


def yaml_topics(text: str) -> set[str]:
    from ruamel.yaml import YAML

    return set(YAML(typ="safe").load(text)["topics"])


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ({"topics": {"imu/data": "/nothing"}}, "the bag has no topic '/nothing' for imu/data; it has"),
        ({"topics": {"imu": "/ublox/fix"}}, "'imu' is no topic of this project; known: imu/data"),
        ({"topics": {"imu/data": "/ublox/fix"}}, "imu/data needs sensor_msgs/msg/Imu"),
        (
            {"topics": {"vehicle/steering": {"topic": "/steering_joint", "names": {"steering_wheel": "x"}}}},
            "no joint 'x'",
        ),
        ({"topic": {}}, "topics"),
    ],
)
def test_a_mapping_that_does_not_fit_the_bag_is_refused_with_what_is_there(mapping, words, foreign):
    with pytest.raises(InputError, match=words):
        import_recording(foreign, mapping=mapping)


def test_a_bag_in_which_nothing_is_of_use_gives_no_mapping(tmp_path, original):
    force = Channel("f", "geometry_msgs/msg/WrenchStamped", np.array([1, 2]), np.array([1, 2]),
                    {"force": np.zeros((2, 3)), "torque": np.zeros((2, 3))})  # fmt: skip
    write_bag(tmp_path / "bag", Recording({"f": force}))
    with pytest.raises(InputError, match="no topic of it measures"):
        guess(tmp_path / "bag")
