"""Bags with the frames of a bus in them, written by rosbags as an independent writer."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from test_can_buses import DRIVE, STEER, TURN, speed
from vsense_ros.bag.importers import find_importer, import_recording
from vsense_ros.errors import InputError

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs requirements/formats.txt")
typesys = pytest.importorskip("rosbags.typesys", reason="needs requirements/formats.txt")

FRAME = "can_msgs/msg/Frame"
DEFINITION = (
    "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data\n"
)
STORES = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
STORES.register(typesys.get_types_from_msg(DEFINITION, FRAME))
TYPES = STORES.types
START = 1_700_000_000
PERIOD = 0.02  # [s]


def header(seconds: float, frame_id: str = "can0"):
    nanoseconds = round(seconds * 1e9)
    time = TYPES["builtin_interfaces/msg/Time"](sec=START + nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)


def frame(seconds: float, identifier: int, value: int, *, remote: bool = False, error: bool = False):
    data = np.frombuffer(struct.pack("<h6x", value), np.uint8)
    return TYPES[FRAME](
        header=header(seconds), id=identifier, is_rtr=remote, is_extended=False, is_error=error, dlc=8, data=data
    )


def fix(seconds: float):
    kinds = TYPES["sensor_msgs/msg/NavSatStatus"], TYPES["sensor_msgs/msg/NavSatFix"]
    status = kinds[0](status=0, service=1)
    return kinds[1](
        header=header(seconds, "gps"),
        status=status,
        latitude=48.0,
        longitude=11.0,
        altitude=500.0,
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )


@pytest.fixture(params=["MCAP", "SQLITE3"])
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A second of two buses and a receiver; messages arrive 5 ms after their stamps."""
    for name, text in (("drive.dbc", DRIVE), ("turn.dbc", TURN)):
        (tmp_path / name).write_text(text)
    (tmp_path / "drive.yaml").write_text("name: drive\noutputs:\n" + speed("SPIN", "A"))
    (tmp_path / "turn.yaml").write_text("name: turn\noutputs:\n" + STEER)
    plugin = getattr(rosbag2.StoragePlugin, request.param)
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:

        def send(connection, seconds: float, message) -> None:
            arrival = START * 10**9 + round(seconds * 1e9) + 5_000_000
            writer.write(connection, arrival, STORES.serialize_cdr(message, connection.msgtype))

        buses = [writer.add_connection(f"/can{i}/frames", FRAME, typestore=STORES) for i in range(2)]
        receiver = writer.add_connection("/gps/fix", "sensor_msgs/msg/NavSatFix", typestore=STORES)
        for i in range(50):
            send(buses[0], i * PERIOD, frame(i * PERIOD, 50, 1000 + i))
            send(buses[1], i * PERIOD, frame(i * PERIOD, 50, -300))
            send(buses[0], i * PERIOD, frame(i * PERIOD, 50, 9999, remote=True))
            send(buses[0], i * PERIOD, frame(i * PERIOD, 50, 9999, error=True))
            send(receiver, i * PERIOD, fix(i * PERIOD))
    return tmp_path / "bag"


def test_frames_become_the_topics_of_their_mapping_beside_the_bag_s_own(bag: Path) -> None:
    files = [bag.parent / name for name in ("drive.dbc", "turn.dbc")]
    mappings = [path.with_suffix(".yaml") for path in files]
    databases = [f"/can0/frames={files[0]}", f"/can1/frames={files[1]}"]
    found = import_recording(bag, dbc=databases, mapping=mappings)
    assert set(found.channels) == {"vehicle/speed", "vehicle/steering", "gps/fix"}
    driven = found["vehicle/speed"]
    assert driven.columns["linear"][:, 0] == pytest.approx(10.0 + 0.01 * np.arange(50))
    assert (driven.stamp - START * 10**9) * 1e-9 == pytest.approx(PERIOD * np.arange(50), abs=1e-6)
    assert found["vehicle/steering"].columns["position"] == pytest.approx(-3.0)
    assert len(found["gps/fix"]) == 50


def test_one_bus_of_several_is_chosen_by_its_topic(bag: Path) -> None:
    database, mapping = bag.parent / "turn.dbc", bag.parent / "turn.yaml"
    found = import_recording(bag, dbc=database, mapping=mapping, channel="/can1/frames")
    assert found["vehicle/steering"].columns["position"] == pytest.approx(-3.0)
    with pytest.raises(InputError, match="can2/frames"):
        import_recording(bag, dbc=database, mapping=mapping, channel="/can2/frames")


def test_without_a_database_the_bag_is_read_as_before_and_says_what_reads_its_frames(bag: Path) -> None:
    assert find_importer(bag).name != "bag_can"
    found = import_recording(bag)
    assert set(found.channels) == {"gps/fix"}
    assert sum("--dbc" in note for note in found.notes) == 2


def test_a_database_without_a_mapping_is_a_sentence(bag: Path) -> None:
    with pytest.raises(InputError, match="--mapping"):
        import_recording(bag, dbc=bag.parent / "drive.dbc")


def test_a_database_for_a_bag_without_frames_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "drive.dbc").write_text(DRIVE)
    (tmp_path / "drive.yaml").write_text("name: drive\noutputs:\n" + speed("SPIN", "A"))
    bag = Path(__file__).parents[2] / "bags" / "step_steer"
    with pytest.raises(InputError, match="no messages of type can_msgs"):
        import_recording(bag, dbc=tmp_path / "drive.dbc", mapping=tmp_path / "drive.yaml")
