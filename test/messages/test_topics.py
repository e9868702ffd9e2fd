"""Definitions of message types, against those that rosbags ships, and recordings cut in time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.bag.importers import build
from vsense_ros.messages.definitions import TYPE_HASHES, fields, is_message, schema_text
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import INPUTS, REFERENCES, TOPICS

rosbags = pytest.importorskip("rosbags.typesys")
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)


@pytest.mark.parametrize("kind", [kind for kind in TYPE_HASHES if kind in STORE.fielddefs])
def test_a_schema_is_what_rosbags_has_of_the_type(kind):
    parsed = rosbags.get_types_from_msg(schema_text(kind), kind)
    for name, (_, definition) in parsed.items():
        _, expected = STORE.fielddefs[name]
        assert [field for field, _ in definition] == [field for field, _ in expected], name
        assert [str(part) for _, part in definition] == [str(part) for _, part in expected], name


@pytest.mark.parametrize("kind", TYPE_HASHES)
def test_fields_are_without_constants_and_parts_are_messages(kind):
    for part, name in fields(kind):
        assert "=" not in name
        plain = part.partition("[")[0]
        assert is_message(part) == ("/" in plain), part


def test_topics_are_inputs_and_references_with_types_that_have_a_definition():
    assert TOPICS.keys() == INPUTS.keys() | REFERENCES.keys()
    assert {topic.kind for topic in TOPICS.values()} <= TYPE_HASHES.keys()
    assert INPUTS["vehicle/suspension"].names == tuple(f"suspension_{wheel}" for wheel in ("fl", "fr", "rl", "rr"))


def drive(begin: float = 0.0) -> Recording:
    def joints(topic: str, times: np.ndarray) -> Channel:
        return build.joints(topic, build.nanoseconds(times, 100), "position", {"a": times})

    return Recording(
        {
            "vehicle/steering": joints("vehicle/steering", begin + np.arange(11.0)),
            "vehicle/suspension": joints("vehicle/suspension", begin + np.arange(4.0, 7.0)),
        }
    )  # fmt: skip


@given(
    begin=st.none() | st.integers(-2, 12),
    end=st.none() | st.integers(-2, 12),
    first=st.integers(0, 1000),
)
def test_what_lies_between_two_times_is_kept_both_included(begin, end, first):
    cut = drive(float(first)).between(begin, end)
    for topic, times in (("vehicle/steering", range(11)), ("vehicle/suspension", range(4, 7))):
        expected = [t for t in times if (begin is None or t >= begin) and (end is None or t <= end)]
        found = (cut[topic].columns["position"][:, 0] - first).tolist() if topic in cut else []
        assert found == expected


def test_the_digest_of_a_recording_is_that_of_its_copy_and_no_other():
    assert drive().digest() == drive().digest()
    assert drive().digest() != drive(1.0).digest()
    assert drive().digest(["vehicle/steering"]) != drive().digest()
    assert drive().digest(["vehicle/suspension", "vehicle/steering"]) == drive().digest()


@pytest.mark.parametrize("missing", ["origin_latitude_deg", "origin_longitude_deg", "origin_altitude_m", None])
@pytest.mark.parametrize("bad", [None, "north", "nan"])
def test_the_origin_of_a_map_needs_three_numbers(missing, bad):
    metadata = {"origin_latitude_deg": "48.5", "origin_longitude_deg": "11", "origin_altitude_m": "500"}
    metadata.pop(missing or "", None)
    if bad is not None:
        metadata["origin_latitude_deg"] = bad
    origin = Recording({}, metadata=metadata).map_origin
    assert origin == ((48.5, 11.0, 500.0) if missing is None and bad is None else None)


def test_a_channel_whose_columns_do_not_fit_is_refused_with_what_was_expected():
    stamp = np.arange(3)
    with pytest.raises(ValueError, match="no numeric form"):
        Channel("t", "std_msgs/msg/Bool", stamp, stamp, {})
    with pytest.raises(ValueError, match="has no field 'speed'"):
        Channel("t", "geometry_msgs/msg/TwistStamped", stamp, stamp, {"speed": np.zeros((3, 1))})
    for wrong in (np.zeros((2, 3)), np.zeros(3)):
        with pytest.raises(ValueError, match=r"expected \(3, …\)"):
            Channel("t", "geometry_msgs/msg/TwistStamped", stamp, stamp, {"linear": wrong})


def test_times_of_a_recording_are_those_of_its_messages_and_zero_without_any():
    one = drive(5.0)
    assert (one.start, one.first_stamp, one.duration) == (5_000_000_100, 5_000_000_100, 10.0)
    assert (Recording({}).start, Recording({}).first_stamp, Recording({}).duration) == (0, 0, 0.0)
    empty = one["vehicle/steering"].select(slice(0, 0))
    assert empty.seconds.tolist() == []
    assert one["vehicle/suspension"].seconds.tolist() == [0.0, 1.0, 2.0]
    assert len(Recording({"vehicle/steering": empty}).tables()) == 0
