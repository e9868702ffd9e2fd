"""CDR against rosbags and rclpy as independent implementations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vsense_ros.errors import InputError
from vsense_ros.messages import cdr, cdr_messages, definitions
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import FIELDS, Channel, Sample

STORE = get_typestore(Stores.ROS2_JAZZY)
# As the repositories of these packages define them: ros_canopen, nmea_msgs, autoware_msgs.
for _kind, _text in {
    "can_msgs/msg/Frame": "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\n"
    "uint8[8] data",
    "nmea_msgs/msg/Sentence": "std_msgs/Header header\nstring sentence",
    "autoware_vehicle_msgs/msg/VelocityReport": "std_msgs/Header header\nfloat32 longitudinal_velocity\n"
    "float32 lateral_velocity\nfloat32 heading_rate",
    "autoware_vehicle_msgs/msg/SteeringReport": "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle",
}.items():
    STORE.register(get_types_from_msg(_text, _kind))
NUMBER = st.floats(width=64, allow_nan=True, allow_infinity=True)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
INTEGERS = {"status": (-2, 2), "service": (0, 65535), "position_covariance_type": (0, 3)}


@st.composite
def samples(draw: st.DrawFn, kind: str | None = None) -> Sample:
    kind = kind or draw(st.sampled_from(sorted(FIELDS)))
    names: tuple[str, ...] = ()
    if kind == "sensor_msgs/msg/JointState":
        names = tuple(draw(st.lists(TEXT, max_size=5)))
    values = {}
    for field, length in FIELDS[kind].items():
        if field in INTEGERS:
            values[field] = np.array([float(draw(st.integers(*INTEGERS[field])))])
        else:
            size = length or draw(st.sampled_from([0, len(names)]))
            values[field] = draw(arrays(np.float64, size, elements=NUMBER))
    child = draw(TEXT) if kind == "nav_msgs/msg/Odometry" else ""
    stamp = draw(st.integers(0, 2**31 * 10**9 - 1))
    return Sample("topic", kind, stamp, values, draw(TEXT), names, child, draw(st.integers(0, 2**62)))


def numbers(message: object, kind: str, field: str) -> np.ndarray:
    """A number field out of a message object of rosbags or rclpy."""
    paths = {
        "sensor_msgs/msg/NavSatFix": {"status": "status.status", "service": "status.service"},
        "geometry_msgs/msg/TwistWithCovarianceStamped": {
            "linear": "twist.twist.linear",
            "angular": "twist.twist.angular",
            "covariance": "twist.covariance",
        },
        "geometry_msgs/msg/TwistStamped": {"linear": "twist.linear", "angular": "twist.angular"},
        "geometry_msgs/msg/AccelStamped": {"linear": "accel.linear", "angular": "accel.angular"},
        "geometry_msgs/msg/AccelWithCovarianceStamped": {
            "linear": "accel.accel.linear",
            "angular": "accel.accel.angular",
            "covariance": "accel.covariance",
        },
        "geometry_msgs/msg/WrenchStamped": {"force": "wrench.force", "torque": "wrench.torque"},
        "nav_msgs/msg/Odometry": {
            "position": "pose.pose.position",
            "orientation": "pose.pose.orientation",
            "pose_covariance": "pose.covariance",
            "linear": "twist.twist.linear",
            "angular": "twist.twist.angular",
            "twist_covariance": "twist.covariance",
        },
    }
    value = message
    for part in paths.get(kind, {}).get(field, field).split("."):
        value = getattr(value, part)
    if hasattr(value, "x"):
        value = [getattr(value, axis) for axis in "xyzw" if hasattr(value, axis)]
    return np.atleast_1d(np.array(value, np.float64))


def assert_same(sample: Sample, other: Sample) -> None:
    assert (sample.kind, sample.stamp, sample.frame_id) == (other.kind, other.stamp, other.frame_id)
    assert (sample.names, sample.child_frame_id) == (other.names, other.child_frame_id)
    for field in FIELDS[sample.kind]:
        np.testing.assert_array_equal(sample.values[field], other.values[field])


@given(samples())
def test_what_is_encoded_decodes_to_the_same_sample(sample: Sample) -> None:
    assert_same(cdr.decode(sample.kind, cdr.encode(sample), "topic", sample.received), sample)


@given(samples())
def test_rosbags_reads_what_we_encode(sample: Sample) -> None:
    message = STORE.deserialize_cdr(cdr.encode(sample), sample.kind)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == sample.stamp
    assert message.header.frame_id == sample.frame_id
    if sample.names:
        assert tuple(message.name) == sample.names
    for field in FIELDS[sample.kind]:
        np.testing.assert_array_equal(numbers(message, sample.kind, field), sample.values[field])


@given(samples())
def test_we_read_what_rosbags_encodes(sample: Sample) -> None:
    message = STORE.deserialize_cdr(cdr.encode(sample), sample.kind)
    assert_same(cdr.decode(sample.kind, bytes(STORE.serialize_cdr(message, sample.kind)), "topic"), sample)


@settings(max_examples=40, deadline=None)  # the first message loads the ROS libraries
@given(samples())
def test_rclpy_reads_what_we_encode_and_we_read_what_it_serializes(sample: Sample) -> None:
    serialization = pytest.importorskip("rclpy.serialization", reason="ROS is not installed")
    import importlib

    package, _, name = sample.kind.split("/")
    message_type = getattr(importlib.import_module(f"{package}.msg"), name)
    ours = cdr.encode(sample)
    message = serialization.deserialize_message(ours, message_type)
    for field in FIELDS[sample.kind]:
        np.testing.assert_array_equal(numbers(message, sample.kind, field), sample.values[field])
    # Not compared byte by byte: rclpy leaves whatever was in memory in the alignment gaps.
    assert_same(cdr.decode(sample.kind, serialization.serialize_message(message), "topic"), sample)


@pytest.mark.parametrize("kind", sorted(definitions.TYPE_HASHES))
def test_schema_text_and_type_hash_are_those_of_jazzy(kind: str) -> None:
    assert definitions.schema_text(kind) == STORE.generate_msgdef(kind, ros_version=2)[0]
    assert definitions.TYPE_HASHES[kind] == STORE.hash_rihs01(kind)


@given(st.data())
@settings(max_examples=30)
def test_a_channel_decodes_at_once_to_what_its_messages_decode_to_one_by_one(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(sorted(FIELDS)))
    first = data.draw(samples(kind))
    rows = data.draw(st.integers(1, 5))
    fill = np.random.default_rng(0)
    columns = {
        field: value + (0 if field in INTEGERS else fill.normal(size=(rows, len(value))))
        if field not in INTEGERS
        else np.tile(value, (rows, 1))
        for field, value in first.values.items()
    }
    stamp = first.stamp + np.arange(rows)
    channel = Channel("topic", kind, stamp, stamp, columns, first.frame_id, first.names, first.child_frame_id)
    payloads = [row.tobytes() for row in cdr.encode_channel(channel)]
    decoded = cdr.decode_channel(kind, "topic", payloads, stamp)
    assert decoded.channel is not None
    assert decoded.bad == 0
    for row, payload in enumerate(payloads):
        assert payload == cdr.encode(channel.sample(row))
        assert_same(decoded.channel.sample(row), cdr.decode(kind, payload, "topic"))


def joint(names: tuple[str, ...], values: list[float], stamp: int, frame: str = "") -> bytes:
    kind = "sensor_msgs/msg/JointState"
    return cdr.encode(Sample("wheels", kind, stamp, {"velocity": np.array(values)}, frame, names))


def test_joints_are_matched_by_name_when_their_order_changes_and_nan_when_missing() -> None:
    payloads = [joint(("a", "b"), [1, 2], 1), joint(("b", "a"), [3, 4], 2), joint(("b",), [5], 3)]
    channel = cdr.decode_channel("sensor_msgs/msg/JointState", "wheels", payloads, np.arange(3)).channel
    assert channel is not None
    assert channel.names == ("a", "b")
    np.testing.assert_array_equal(channel.columns["velocity"], [[1, 2], [4, 3], [np.nan, 5]])
    assert channel.columns["position"].shape == (3, 0)
    assert channel.stamp.tolist() == [1, 2, 3]


def test_garbage_in_the_alignment_gaps_does_not_split_a_channel() -> None:
    sample = Sample("t", "geometry_msgs/msg/Vector3Stamped", 1, {"vector": np.ones(3)})
    clean = cdr.encode(sample)
    gap = 17  # between the empty frame id and the first float64
    dirty = clean[:gap] + b"\x67" + clean[gap + 1 :]
    channel = cdr.decode_channel(sample.kind, "t", [clean, dirty], np.arange(2)).channel
    assert channel is not None
    np.testing.assert_array_equal(channel.columns["vector"], np.ones((2, 3)))


def test_messages_with_a_foreign_frame_id_are_left_out_and_counted() -> None:
    payloads = [joint(("a",), [i], i, "odd" if i == 2 else "good") for i in range(5)]
    decoded = cdr.decode_channel("sensor_msgs/msg/JointState", "wheels", payloads, np.arange(5))
    assert decoded.channel is not None
    assert decoded.channel.frame_id == "good"
    assert decoded.channel.received.tolist() == [0, 1, 3, 4]
    assert decoded.foreign == {"odd": 1}


@given(samples(), st.data())
def test_cut_off_bytes_are_an_input_error_never_a_crash(sample: Sample, data: st.DataObject) -> None:
    encoded = cdr.encode(sample)
    cut = encoded[: data.draw(st.integers(0, len(encoded) - 1))]
    with pytest.raises(InputError, match="topic"):
        cdr.decode(sample.kind, cut, "topic")


@given(st.binary(max_size=400), st.sampled_from(sorted(FIELDS)))
def test_garbage_is_an_input_error_or_a_message_never_a_crash(data: bytes, kind: str) -> None:
    try:
        cdr.decode(kind, b"\0\1\0\0" + data, "topic")
    except InputError:
        return


def test_big_endian_messages_are_refused_by_name() -> None:
    sample = Sample("t", "geometry_msgs/msg/Vector3Stamped", 1, {"vector": np.ones(3)})
    with pytest.raises(InputError, match="little-endian"):
        cdr.decode(sample.kind, b"\0\0" + cdr.encode(sample)[2:], "t")


def test_nan_is_refused_for_an_integer_field() -> None:
    values = {"status": np.array([np.nan])}
    with pytest.raises(ValueError, match="status is an integer"):
        cdr.encode(Sample("gps/fix", "sensor_msgs/msg/NavSatFix", 0, values))


def test_a_value_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="vector has 2 values"):
        cdr.encode(Sample("t", "geometry_msgs/msg/Vector3Stamped", 0, {"vector": np.ones(2)}))


@given(
    st.lists(
        st.builds(Diagnostic, TEXT, st.sampled_from(Level), TEXT, st.dictionaries(TEXT, TEXT, max_size=3)),
        max_size=4,
    )
)
def test_rosbags_reads_our_diagnostics(diagnostics: list[Diagnostic]) -> None:
    message = STORE.deserialize_cdr(
        cdr_messages.encode_diagnostics(5_000_000_007, diagnostics, "car"), "diagnostic_msgs/msg/DiagnosticArray"
    )
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 7)
    found = [Diagnostic(s.name, Level(s.level), s.message, {v.key: v.value for v in s.values}) for s in message.status]
    assert found == diagnostics
    assert all(s.hardware_id == "car" for s in message.status)


def test_transforms_are_those_that_rosbags_reads() -> None:
    sent = [
        cdr_messages.Transform("map", "car1/odom", (1.0, -2.0, 3.0), (0.0, 0.0, 0.6, 0.8)),
        cdr_messages.Transform("car1/odom", "b", (4.0, 5.0, 6.0), (0.0, 1.0, 0.0, 0.0)),
        cdr_messages.Transform("β", "", (7.0, 8.0, 9.0), (1.0, 0.0, 0.0, 0.0)),
    ]
    message = STORE.deserialize_cdr(
        cdr_messages.encode_transforms(1_700_000_000_123_456_789, sent), "tf2_msgs/msg/TFMessage"
    )
    assert len(message.transforms) == len(sent)
    for read, expected in zip(message.transforms, sent, strict=True):
        assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
        assert (read.header.frame_id, read.child_frame_id) == (expected.parent, expected.child)
        place, turned = read.transform.translation, read.transform.rotation
        assert (place.x, place.y, place.z) == expected.position
        assert (turned.x, turned.y, turned.z, turned.w) == expected.orientation


@given(
    st.integers(0, 2**31 * 10**9 - 1),
    st.integers(0, 2**29 - 1),
    st.binary(max_size=8),
    st.tuples(st.booleans(), st.booleans(), st.booleans()),
    TEXT,
)
def test_can_frames_are_those_of_rosbags_both_ways(
    stamp: int, identifier: int, data: bytes, flags: tuple[bool, bool, bool], frame_id: str
) -> None:
    frame = cdr_messages.CanFrame(stamp, identifier, b"" if flags[0] else data, *flags, len(data))
    ours = cdr_messages.encode_can_frame(frame, frame_id)
    assert cdr_messages.decode_can_frame(ours) == frame
    message = STORE.deserialize_cdr(ours, "can_msgs/msg/Frame")
    assert (message.id, message.dlc, message.header.frame_id) == (identifier, len(data), frame_id)
    assert (message.is_rtr, message.is_extended, message.is_error) == flags
    assert bytes(message.data[: len(frame.data)]) == frame.data
    assert cdr_messages.decode_can_frame(bytes(STORE.serialize_cdr(message, "can_msgs/msg/Frame"))) == frame


def test_sentences_are_those_of_rosbags() -> None:
    Header, Time = STORE.types["std_msgs/msg/Header"], STORE.types["builtin_interfaces/msg/Time"]
    sentence = STORE.types["nmea_msgs/msg/Sentence"]
    text = "$GPHDT,274.07,T*03"
    for frame_id in ("", "gps", "antenna"):
        message = sentence(header=Header(stamp=Time(sec=1, nanosec=2), frame_id=frame_id), sentence=text)
        data = bytes(STORE.serialize_cdr(message, "nmea_msgs/msg/Sentence"))
        assert cdr_messages.decode_sentence(data) == text.encode()
        for length in range(len(data)):
            with pytest.raises(InputError):
                cdr_messages.decode_sentence(data[:length])


@pytest.mark.parametrize("changed", [None, 0, 700, 1499])
def test_a_field_that_stays_is_there_once_and_one_that_changes_anywhere_is_not(changed: int | None) -> None:
    rows = 1500
    covariance = np.tile(np.eye(6).ravel(), (rows, 1))
    if changed is not None:
        covariance[changed, 3] = 0.5
    linear = np.arange(3.0 * rows).reshape(rows, 3)
    columns = {"linear": linear, "angular": np.zeros((rows, 3)), "covariance": covariance}
    stamp = np.arange(rows, dtype=np.int64)
    kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
    written = Channel("gps/velocity", kind, stamp, stamp, columns, "map")
    read = cdr.decode_channel(kind, "gps/velocity", cdr.encode_channel(written), stamp).channel
    assert read is not None
    for name, column in columns.items():
        np.testing.assert_array_equal(read.columns[name], column)
    assert (read.columns["covariance"].strides[0] == 0) == (changed is None)
    assert read.columns["linear"].strides[0] != 0


@given(st.data())
@settings(max_examples=30)
def test_messages_of_one_length_and_other_texts_are_told_apart(data: st.DataObject) -> None:
    """Layouts are remembered by type and length."""
    kind = "geometry_msgs/msg/Vector3Stamped"
    frames = data.draw(st.lists(st.text("abcdef", min_size=4, max_size=4), min_size=2, max_size=6))
    for frame in frames:
        sample = Sample("t", kind, 5, {"vector": np.array([1.0, 2.0, 3.0])}, frame)
        for _ in range(2):
            encoded = cdr.encode(sample)
            decoded = cdr.decode(kind, encoded, "t")
            assert decoded.frame_id == frame
            np.testing.assert_array_equal(decoded.values["vector"], [1.0, 2.0, 3.0])
            decoded.values["vector"][0] = 7.0  # which is the caller's own
            assert cdr.encode(sample) == encoded
