"""Bags against rosbags and the mcap library as independent readers and writers; damaged bags."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from vsense_ros.bag import BagWriter, read_bag, write_bag
from vsense_ros.bag.mcap import Rows
from vsense_ros.bag.reading import glance_at_bag
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr, cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import FIELDS, Channel, Recording, Sample

STORE = get_typestore(Stores.ROS2_JAZZY)
START = 1_600_000_000_000_000_000
IMU = "sensor_msgs/msg/Imu"


def channel(topic: str, kind: str, rows: int, period: int, seed: int = 0, **strings: object) -> Channel:
    fill = np.random.default_rng(seed)
    names = strings.get("names", ())
    assert isinstance(names, tuple)
    stamp = START + np.arange(rows) * period
    columns = {
        field: np.ones((rows, 1))
        if field in ("status", "service", "position_covariance_type")
        else fill.normal(size=(rows, width or len(names)))
        for field, width in FIELDS[kind].items()
    }
    return Channel(
        topic,
        kind,
        stamp,
        stamp + 1_000_000,
        columns,
        str(strings.get("frame_id", "")),
        names,
        str(strings.get("child_frame_id", "")),
    )


@pytest.fixture
def recording() -> Recording:
    channels = [
        channel("imu/data", IMU, 3000, 4_000_000, 1, frame_id="imu_link"),
        channel("gps/fix", "sensor_msgs/msg/NavSatFix", 120, 100_000_000, 2, frame_id="gnss_link"),
        channel(
            "vehicle/wheel_speeds", "sensor_msgs/msg/JointState", 1000, 12_000_000, 3, names=("wheel_fl", "wheel_fr")
        ),
        channel(
            "reference/odometry", "nav_msgs/msg/Odometry", 240, 50_000_000, 4, frame_id="map", child_frame_id="cog"
        ),
    ]
    return Recording({c.topic: c for c in channels}, "drive", ("a note",), 0, {"vehicle": 'say "hi": \\ there'})


def file_of(bag: Path) -> Path:
    return bag / f"{bag.name}_0.mcap"


def assert_same(found: Recording, expected: Recording) -> None:
    assert set(found.channels) == set(expected.channels)
    for topic, wanted in expected.channels.items():
        got = found[topic]
        assert (got.kind, got.frame_id, got.names, got.child_frame_id) == (
            wanted.kind,
            wanted.frame_id,
            wanted.names,
            wanted.child_frame_id,
        )
        np.testing.assert_array_equal(got.stamp, wanted.stamp)
        np.testing.assert_array_equal(got.received, wanted.received)
        for field, column in wanted.columns.items():
            np.testing.assert_array_equal(got.columns[field], column)


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_what_is_written_is_read_back(tmp_path: Path, recording: Recording, compression: str) -> None:
    write_bag(tmp_path / "drive", recording, compression=compression)
    found = read_bag(tmp_path / "drive")
    assert_same(found, recording)
    assert (found.notes, found.metadata, found.messages_lost) == (recording.notes, recording.metadata, 0)
    assert_same(read_bag(file_of(tmp_path / "drive")), recording)


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_rosbags_accepts_the_bag_and_finds_the_same_messages(
    tmp_path: Path, recording: Recording, compression: str
) -> None:
    write_bag(tmp_path / "drive", recording, compression=compression)
    with Reader(tmp_path / "drive") as reader:
        assert reader.message_count == sum(map(len, recording.channels.values()))
        assert {c.topic: c.msgcount for c in reader.connections} == {
            f"/{topic}": len(c) for topic, c in recording.channels.items()
        }
        assert reader.start_time == recording.start
        assert reader.ros_distro == "jazzy"
        seen: dict[str, list[bytes]] = {}
        last = 0
        for connection, time, data in reader.messages():
            assert time >= last
            last = time
            assert connection.digest == STORE.hash_rihs01(connection.msgtype)
            seen.setdefault(connection.topic[1:], []).append(bytes(data))
    for topic, wanted in recording.channels.items():
        assert seen[topic] == [row.tobytes() for row in cdr.encode_channel(wanted)]


def test_the_mcap_library_finds_an_indexed_ros2_file_and_decodes_it(tmp_path: Path, recording: Recording) -> None:
    write_bag(tmp_path / "drive", recording)
    with file_of(tmp_path / "drive").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(map(len, recording.channels.values()))
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 1
        [(*_, last)] = [list(reader.iter_decoded_messages(topics=["/imu/data"]))[-1:]]
        assert last.decoded_message.angular_velocity.z == recording["imu/data"].columns["angular_velocity"][-1, 2]
        assert next(iter(reader.iter_metadata())).name == "rosbag2"


def test_we_read_what_rosbags_writes(tmp_path: Path, recording: Recording) -> None:
    with Writer(tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            c.topic: writer.add_connection(f"/{c.topic}", c.kind, typestore=STORE) for c in recording.channels.values()
        }
        for sample in recording.samples():
            writer.write(connections[sample.topic], sample.received, cdr.encode(sample))
    assert_same(read_bag(tmp_path / "theirs"), recording)


def test_the_same_recording_makes_the_same_bytes(tmp_path: Path, recording: Recording) -> None:
    for parent in ("one", "two"):
        write_bag(tmp_path / parent / "drive", recording)
    for name in ("drive_0.mcap", "metadata.yaml"):
        assert (tmp_path / "one/drive" / name).read_bytes() == (tmp_path / "two/drive" / name).read_bytes()


def test_samples_and_diagnostics_can_be_written_one_by_one(tmp_path: Path, recording: Recording) -> None:
    with BagWriter(tmp_path / "drive") as writer:
        for sample in recording.samples():
            writer.write(sample)
        data = cdr_messages.encode_diagnostics(START, [Diagnostic("imu", Level.WARN, "late")])
        writer.write_raw("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", START, data)
    found = read_bag(tmp_path / "drive")
    assert_same(found, recording)
    assert found.notes == ("diagnostics: 1 messages of type diagnostic_msgs/msg/DiagnosticArray skipped",)
    with Reader(tmp_path / "drive") as reader:
        [message] = [data for c, _, data in reader.messages() if c.topic == "/diagnostics"]
    assert STORE.deserialize_cdr(message, "diagnostic_msgs/msg/DiagnosticArray").status[0].message == "late"


def test_messages_written_out_of_order_come_back_in_order_of_arrival(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as writer:
        for stamp in (30, 10, 20):
            writer.write(Sample("t", "geometry_msgs/msg/Vector3Stamped", stamp, {"vector": np.full(3, stamp)}))
    assert read_bag(tmp_path / "drive")["t"].columns["vector"][:, 0].tolist() == [10, 20, 30]


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.999])
def test_of_a_truncated_bag_every_message_before_the_cut_is_used(
    tmp_path: Path, recording: Recording, compression: str, share: float
) -> None:
    write_bag(tmp_path / "drive", recording, compression=compression)
    file = file_of(tmp_path / "drive")
    data = file.read_bytes()
    cut = int(len(data) * share)
    file.write_bytes(data[:cut])
    found = read_bag(tmp_path / "drive")
    total = sum(map(len, recording.channels.values()))
    got = sum(map(len, found.channels.values()))
    assert found.messages_lost == total - got
    assert any(f"cut off at byte {cut}" in note for note in found.notes)
    for topic, part in found.channels.items():
        assert_same(Recording({topic: part}), Recording({topic: recording[topic].select(slice(0, len(part)))}))
    if compression == "":  # of which the very last whole message is known
        assert got >= int(total * share * 0.97)
    (tmp_path / "drive" / "metadata.yaml").unlink()
    assert sum(map(len, read_bag(tmp_path / "drive").channels.values())) == got


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Position and length of the chunk records of a file."""
    at, found = 8, []
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:
            found.append((at, length + 9))
        at += 9 + length
    return found


def test_a_corrupt_chunk_costs_its_own_messages_and_no_other(tmp_path: Path, recording: Recording) -> None:
    write_bag(tmp_path / "drive", recording)
    file = file_of(tmp_path / "drive")
    data = bytearray(file.read_bytes())
    position, length = chunks(data)[1]
    data[position + length // 2] ^= 0x10
    file.write_bytes(data)
    found = read_bag(file)
    total = sum(map(len, recording.channels.values()))
    assert 0 < found.messages_lost < total / 2
    assert sum(map(len, found.channels.values())) == total - found.messages_lost
    [note] = [note for note in found.notes if "damaged" in note]
    assert f"chunk at byte {position}" in note
    assert f"{found.messages_lost} messages lost" in note
    for topic, part in found.channels.items():
        assert np.isin(part.received, recording[topic].received).all()


def test_the_first_chunk_may_be_the_corrupt_one(tmp_path: Path, recording: Recording) -> None:
    """It holds the definitions of the topics, which the summary has too."""
    write_bag(tmp_path / "drive", recording)
    file = file_of(tmp_path / "drive")
    data = bytearray(file.read_bytes())
    position, length = chunks(data)[0]
    data[position + length // 2] ^= 0x10
    file.write_bytes(data)
    found = read_bag(tmp_path / "drive")
    assert set(found.channels) == set(recording.channels)
    assert sum(map(len, found.channels.values())) + found.messages_lost == sum(map(len, recording.channels.values()))


def test_reading_goes_on_at_the_next_chunk_when_a_record_has_no_end(tmp_path: Path, recording: Recording) -> None:
    write_bag(tmp_path / "drive", recording)
    file = file_of(tmp_path / "drive")
    data = bytearray(file.read_bytes())
    second, third = chunks(data)[1][0], chunks(data)[2][0]
    data[second] = 0
    file.write_bytes(data)
    found = read_bag(file)
    assert any(f"damaged at byte {second}" in note and f"went on at byte {third}" in note for note in found.notes)
    assert sum(map(len, found.channels.values())) + found.messages_lost == sum(map(len, recording.channels.values()))


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10**9), st.integers(1, 255))
def test_no_flipped_byte_crashes_the_reader_or_changes_a_value(
    tmp_path: Path, recording: Recording, where: int, bits: int
) -> None:
    bag = tmp_path / "drive"
    if not bag.exists():
        write_bag(bag, recording)
    data = bytearray(file_of(bag).read_bytes())
    data[where % len(data)] ^= bits
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    try:
        found = read_bag(broken)
    except InputError:
        return
    for topic, part in found.channels.items():
        if topic in recording:
            assert len(part) <= len(recording[topic])
            values = next(iter(part.columns.values()))[:, :1]
            assert np.isin(values, next(iter(recording[topic].columns.values()))[:, :1]).all()


def test_a_damaged_message_in_a_sound_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as writer:
        for stamp in range(3):
            sample = Sample("t", "geometry_msgs/msg/Vector3Stamped", stamp, {"vector": np.full(3, stamp)})
            writer.write_raw("t", sample.kind, stamp, cdr.encode(sample)[: 20 if stamp == 1 else None])
    found = read_bag(tmp_path / "drive")
    assert found["t"].stamp.tolist() == [0, 2]
    assert found.messages_lost == 1
    assert "t: 1 messages are damaged" in found.notes[0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"#ROSBAG V2.0\n", "not an MCAP file"),
        (MCAP0_MAGIC, "no intact message"),
    ],
)
def test_a_file_that_is_no_bag_is_an_input_error(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_bag(file)


def test_a_bag_without_messages_is_an_input_error(tmp_path: Path) -> None:
    write_bag(tmp_path / "drive", Recording({}))
    with pytest.raises(InputError, match="holds no intact message"):
        read_bag(tmp_path / "drive")


def test_a_path_without_a_bag_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        read_bag(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"neither metadata\.yaml nor"):
        read_bag(tmp_path)


def test_a_bag_of_another_storage_is_an_input_error_that_says_how_to_convert(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
    )
    with pytest.raises(InputError, match="ros2 bag convert"):
        read_bag(tmp_path)


def test_a_damaged_metadata_file_is_noted_and_the_messages_are_read(tmp_path: Path, recording: Recording) -> None:
    write_bag(tmp_path / "drive", recording)
    (tmp_path / "drive" / "metadata.yaml").write_bytes(b"\x00: [")
    found = read_bag(tmp_path / "drive")
    assert_same(found, recording)
    assert any(r"metadata.yaml is damaged" in note for note in found.notes)


def test_nothing_but_a_bag_is_overwritten(tmp_path: Path, recording: Recording) -> None:
    write_bag(tmp_path / "drive", recording)
    with pytest.raises(InputError, match="holds something already"):
        write_bag(tmp_path / "drive", recording)
    write_bag(tmp_path / "drive", recording, overwrite=True)
    (tmp_path / "drive" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="no bag"):
        write_bag(tmp_path / "drive", recording, overwrite=True)


def test_a_topic_keeps_its_type(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as writer:
        writer.write(Sample("t", "geometry_msgs/msg/Vector3Stamped", 1, {"vector": np.ones(3)}))
        with pytest.raises(InputError, match="a topic has one type"):
            writer.write_raw("t", IMU, 2, b"")
        with pytest.raises(InputError, match="cannot be written"):
            writer.write_raw("other", "my_msgs/msg/Odd", 2, b"")


def test_an_unfinished_bag_is_readable_while_it_is_being_written(tmp_path: Path, recording: Recording) -> None:
    writer = BagWriter(tmp_path / "drive")
    for sample in recording.samples():
        writer.write(sample)
    found = read_bag(tmp_path / "drive")
    writer.close()
    assert len(found["imu/data"]) > 0.7 * len(recording["imu/data"])
    assert any("not finished" in note for note in found.notes)


def test_unchunked_messages_are_read(tmp_path: Path) -> None:
    sample = Sample("t", "geometry_msgs/msg/Vector3Stamped", 7, {"vector": np.arange(3.0)}, received=9)

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    data = MCAP0_MAGIC + record(1, text("ros2") + text("by hand"))
    data += record(3, struct.pack("<H", 1) + text(sample.kind) + text("ros2msg") + text(""))
    data += record(4, struct.pack("<HH", 5, 1) + text("/t") + text("cdr") + struct.pack("<I", 0))
    data += record(5, struct.pack("<HIQQ", 5, 0, 9, 9) + cdr.encode(sample))
    data += record(0x0F, struct.pack("<I", zlib.crc32(data)))
    file = tmp_path / "plain.mcap"
    file.write_bytes(data + record(2, struct.pack("<QQI", 0, 0, 0)) + MCAP0_MAGIC)
    found = read_bag(file)
    assert found["t"].columns["vector"].tolist() == [[0, 1, 2]]
    assert (found["t"].stamp[0], found["t"].received[0], found.notes) == (7, 9, ())


def test_a_bag_that_cannot_be_written_to_its_end_leaves_nothing_behind(tmp_path):
    stamp = 1_600_000_000_000_000_000 + np.arange(20_000) * 10_000_000
    columns = {field: np.zeros((len(stamp), width)) for field, width in FIELDS["sensor_msgs/msg/NavSatFix"].items()}
    columns["status"][15_000] = np.nan  # an integer in the message
    channel = Channel("gps/fix", "sensor_msgs/msg/NavSatFix", stamp, stamp, columns, "gnss_link")
    with pytest.raises(ValueError, match="status is an integer"):
        write_bag(tmp_path / "bag", Recording({"gps/fix": channel}))
    assert not (tmp_path / "bag").exists()


def test_a_first_look_at_a_large_bag_has_its_messages_from_begin_to_end(tmp_path: Path) -> None:
    whole = Recording({"imu/data": channel("imu/data", IMU, 40_000, 4_000_000, 1)})
    write_bag(tmp_path / "large", whole)
    part = glance_at_bag(tmp_path / "large", most=1 << 20)
    assert part is not None
    seen, known = part["imu/data"], whole["imu/data"]
    assert 0.02 < len(seen) / len(known) < 0.2
    rows = np.searchsorted(known.stamp, seen.stamp)
    assert np.array_equal(known.columns["angular_velocity"][rows], seen.columns["angular_velocity"])
    assert rows[0] == 0
    jumps = np.diff(rows)
    stretches = 1 + np.count_nonzero(jumps > 1)
    assert stretches >= 4
    assert jumps.max() < 1.5 * len(known) / (stretches - 1)  # they lie evenly
    assert glance_at_bag(tmp_path / "large", most=1 << 30) is None  # the whole of it is as quick


def test_messages_in_which_most_bytes_stay_take_the_memory_of_those_that_change() -> None:
    random = np.random.default_rng(1)
    messages = np.tile(random.integers(0, 256, 324, dtype=np.uint8), (500, 1))
    messages[:, 30:78] = random.integers(0, 256, (500, 48), dtype=np.uint8)
    rows = Rows.of(messages)
    again = np.empty_like(messages)
    rows.write(again)
    assert np.array_equal(again, messages)
    assert rows.as_list() == [bytes(one) for one in messages]
    assert rows.values.nbytes < messages.nbytes / 6


def test_a_bag_of_an_hour_holds_no_more_memory_than_a_chunk_and_its_index(tmp_path: Path) -> None:
    chunks, topics, most = 400, 40, 1000  # [byte] for a chunk; an object for each would be 3,800
    data = bytes(100)
    with BagWriter(tmp_path / "long", compression="lz4", split_size=100_000) as writer:
        tracemalloc.start()
        before = 0
        for chunk in range(chunks):
            for topic in range(topics):
                writer.write_raw(f"topic_{topic}", "can_msgs/msg/Frame", 10**9 + chunk, data)
            writer.flush()
            if chunk == chunks // 2:
                before = tracemalloc.get_traced_memory()[0]
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
    assert len(list((tmp_path / "long").glob("*.mcap"))) > 3
    assert grown < most * chunks / 2
