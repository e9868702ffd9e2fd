"""Messages of a recording, one by one."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from vsense_ros.messages.recording import Channel, Recording

ARRIVALS = st.lists(st.integers(0, 20), max_size=12)


def channel(topic: str, arrivals: list[int]) -> Channel:
    """Its values are the numbers of its rows."""
    received = np.array(arrivals, dtype=np.int64)
    rows = np.arange(len(arrivals), dtype=float)
    columns = {"position": rows[:, None], "velocity": -rows[:, None], "effort": np.zeros((len(rows), 0))}
    return Channel(topic, "sensor_msgs/msg/JointState", received - 5, received, columns, "frame", ("wheel_fl",))


@given(st.tuples(ARRIVALS, ARRIVALS, ARRIVALS))
def test_messages_come_in_order_of_arrival_and_ties_in_the_order_of_channels_and_rows(
    arrivals: tuple[list[int], ...],
) -> None:
    channels = {name: channel(name, times) for name, times in zip("abc", arrivals, strict=True)}
    found = list(Recording(channels).samples())
    expected = sorted(
        (int(c.received[row]), place, row) for place, c in enumerate(channels.values()) for row in range(len(c))
    )
    assert [(s.received, "abc".index(s.topic), int(s.values["position"][0])) for s in found] == expected
    for sample, (_, _, row) in zip(found, expected, strict=True):
        one = channels[sample.topic].sample(row)
        assert (sample.kind, sample.stamp, sample.frame_id, sample.names) == (one.kind, one.stamp, "frame", one.names)
        assert {k: v.tolist() for k, v in sample.values.items()} == {k: v.tolist() for k, v in one.values.items()}


def test_only_the_topics_that_are_asked_for_come() -> None:
    recording = Recording({name: channel(name, [1, 2]) for name in "abc"})
    assert [s.topic for s in recording.samples(("c", "a"))] == ["a", "c", "a", "c"]
    assert list(recording.samples(())) == []


@given(constant=st.booleans(), rows=st.integers(0, 40), chosen=st.integers(0, 40), value=st.floats())
def test_a_compact_channel_says_the_same_in_less_memory_where_a_column_never_changes(
    constant: bool, rows: int, chosen: int, value: float
) -> None:
    covariance = np.full((rows, 9), value)
    if not constant and rows:
        covariance[rows // 2, 3] = 1.5
    stamp = np.arange(rows) * 10
    channel = Channel("imu/data", "sensor_msgs/msg/Imu", stamp, stamp, {"angular_velocity_covariance": covariance})
    compact = channel.compact()
    first, same = channel.select(slice(chosen)), compact.select(slice(chosen))
    for one, other in ((channel, compact), (first, same), (first, same.select(np.arange(len(same))))):
        assert_array_equal(one.columns["angular_velocity_covariance"], other.columns["angular_velocity_covariance"])
        assert [repr(sample) for sample in one] == [repr(sample) for sample in other]
    if rows > 1 and (constant or value == 1.5):
        assert compact.columns["angular_velocity_covariance"].strides[0] == 0


def test_an_attitude_that_an_inertial_sensor_says_it_has_not_is_no_signal() -> None:
    stamp = np.arange(3)
    columns = {"orientation": np.zeros((3, 4)), "angular_velocity": np.ones((3, 3))}
    unknown = np.zeros((3, 9))
    unknown[:, 0] = -1  # as sensor_msgs/Imu defines it
    for covariance, count in ((unknown, 3), (np.zeros((3, 9)), 7)):
        channel = Channel("imu", "sensor_msgs/msg/Imu", stamp, stamp, {**columns, "orientation_covariance": covariance})
        assert len(channel.table().columns) == count


def test_of_two_messages_with_one_stamp_each_signal_is_taken_from_the_last_that_has_it() -> None:
    """A recording of a car whose rates and accelerations are in two frames of its bus, sent together."""
    stamp = np.array([1, 1, 2, 2])
    turns, pushes = np.array([0.5, 0, 0.6, 0])[:, None] * np.ones(3), np.array([0, 3.0, 0, 4.0])[:, None] * np.ones(3)
    known, absent = np.eye(1, 9), -np.eye(1, 9)
    columns = {
        "angular_velocity": turns, "angular_velocity_covariance": np.concatenate([known, absent] * 2),
        "linear_acceleration": pushes, "linear_acceleration_covariance": np.concatenate([absent, known] * 2),
    }  # fmt: skip
    table = Channel("imu", "sensor_msgs/msg/Imu", stamp, stamp, columns).table()
    values = {column.name: column.value.tolist() for column in table.columns}
    assert values["imu/angular_velocity.z"] == [0.5, 0.6]
    assert values["imu/linear_acceleration.x"] == [3.0, 4.0]
