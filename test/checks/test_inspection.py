"""What is said of each topic of a recording, on stamps and values that are made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import IMU, STEERING, WHEELS
from vsense_ros.bag.importers import build
from vsense_ros.checks.finding import Confidence, Kind
from vsense_ros.checks.inspect import Gap, TopicInfo, inspect
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import USUAL_TOPICS
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import TOPICS

START = 1_600_000_000_000_000_000


def channel(seconds: np.ndarray, values: np.ndarray | None = None, topic: str = WHEELS) -> Channel:
    stamp = build.nanoseconds(np.asarray(seconds, float), START)
    rough = np.random.default_rng(0).normal(size=len(stamp)) if values is None else values
    return build.joints(topic, stamp, "velocity", {"wheel_fl": rough})


def of(channel: Channel) -> TopicInfo:
    (info,) = inspect(Recording({channel.topic: channel})).topics
    return info


def kinds(info: TopicInfo) -> list[Reason]:
    return [finding.reason for finding in info.findings]


@settings(max_examples=20, deadline=None)
@given(rate=st.sampled_from([10.0, 50.0, 100.0]), begin=st.floats(0, 1e6), missing=st.integers(3, 40))
def test_the_rate_is_that_between_gaps_wherever_a_recording_begins(rate, begin, missing):
    rows = np.arange(200)
    seconds = begin + np.concatenate([rows[:100], rows[100:] + missing]) / rate
    info = of(channel(seconds))
    assert info.rate_hz == pytest.approx(rate, rel=1e-3)
    assert info.count == 200
    (gap,) = info.gaps
    assert gap.start == pytest.approx(99 / rate, abs=1e-5)
    assert gap.length == pytest.approx((missing + 1) / rate, abs=1e-5)
    assert kinds(info) == [Reason.GAPS]
    assert info.findings[0].span == pytest.approx((gap.start, gap.start + gap.length))


def test_pauses_of_less_than_three_periods_are_no_gaps_and_the_longest_gap_is_shown():
    assert of(channel(np.concatenate([np.arange(50), 50.8 + np.arange(50)]) / 10 * 1.0)).gaps == ()
    two = np.concatenate([np.arange(50), 60 + np.arange(50), 150 + np.arange(50)]) / 10
    info = of(channel(two))
    assert [pytest.approx((g.start, g.length)) for g in info.gaps] == [(4.9, 1.1), (10.9, 4.1)]
    assert info.findings[0].evidence == {"count": 2.0}
    assert info.findings[0].span == pytest.approx((10.9, 15.0))
    assert isinstance(info.gaps[0], Gap)


@pytest.mark.parametrize("jump", [599.0, 601.0, -601.0])
def test_a_clock_that_is_set_is_a_jump_and_no_gap(jump):
    seconds = 1000 + np.arange(100) * 0.1 + np.where(np.arange(100) >= 50, jump, 0.0)
    made = channel(seconds)
    arrived = replace(made, received=build.nanoseconds(1000 + np.arange(100) * 0.1, START))
    info = of(arrived)
    if jump == 599.0:
        assert (len(info.gaps), info.jumps) == (1, ())
        return
    assert info.gaps == ()
    assert info.jumps == pytest.approx((jump + 0.1,))
    (finding,) = [f for f in info.findings if f.reason is Reason.CLOCK_JUMPS]
    assert finding.evidence["change"] == pytest.approx(jump + 0.1)
    assert finding.span == pytest.approx((5.0, 5.0))
    assert info.backwards == (jump < 0)
    assert Reason.OLDER_THAN_LAST not in kinds(info)


def test_messages_out_of_order_and_with_the_stamp_of_the_one_before_are_counted():
    seconds = np.arange(100) * 0.1
    seconds[[30, 31, 60]] = seconds[[31, 30, 59]]
    info = of(channel(seconds))
    assert (info.backwards, info.duplicates) == (1, 1)
    evidence = {f.reason: f.evidence for f in info.findings}
    assert evidence[Reason.OLDER_THAN_LAST] == {"count": 1.0}
    assert evidence[Reason.SAME_STAMP] == {"count": 1.0}


@pytest.mark.parametrize(("latency", "named"), [(-0.2, True), (-0.05, False), (1.9, False), (2.1, True)])
def test_stamps_that_are_older_than_the_arrival_by_too_much_are_named(latency, named):
    made = channel(np.arange(100) * 0.1)
    info = of(replace(made, received=made.stamp + round(latency * 1e9)))
    assert info.latency_median == pytest.approx(latency)
    assert info.latency_p99 == pytest.approx(latency)
    assert (Reason.STAMPS_OLD in kinds(info)) == named


@pytest.mark.parametrize(("rows", "named"), [(60, True), (45, False)])
def test_an_inertial_sensor_always_has_noise(rows, named):
    rates = np.random.default_rng(0).normal(size=(200, 3))
    rates[50 : 50 + rows, 1] = 0.5
    forces = np.random.default_rng(1).normal(loc=(0.0, 0.0, 9.81), size=(200, 3))
    info = of(build.imu(build.nanoseconds(np.arange(200) * 0.02, START), rates, forces))
    assert (info.topic, Reason.VALUE_STANDS in kinds(info)) == (IMU, named)
    if named:
        (finding,) = [f for f in info.findings if f.reason is Reason.VALUE_STANDS]
        assert (finding.signal, finding.kind) == ("angular_velocity.y", Kind.FROZEN)
        assert finding.span == pytest.approx((1.0, 1.0 + 0.02 * (rows - 1)))


def test_a_wheel_may_stand():
    assert Reason.VALUE_STANDS not in kinds(of(channel(np.arange(200) * 0.02, np.zeros(200))))


def test_absent_values_are_counted_and_signals_that_never_change_named():
    values = np.random.default_rng(0).normal(size=100)
    values[[3, 50]] = np.nan
    info = of(channel(np.arange(100) * 0.1, values))
    (finding,) = info.findings
    assert (finding.reason, finding.signal) == (Reason.NOT_A_NUMBER, "velocity.wheel_fl")
    assert finding.evidence == {"count": 2.0, "rows": 100.0}
    assert info.nan_share == pytest.approx(0.02)
    assert info.constant == ()
    still = of(channel(np.arange(100) * 0.1, np.full(100, 3.0)))
    assert still.constant == ("velocity.wheel_fl",)
    assert of(channel(np.array([0.0]), np.array([1.0]))).constant == ()


def test_a_signal_that_takes_turns_with_others_is_not_absent():
    values = np.where(np.arange(100) % 2 == 0, np.sin(np.arange(100.0)), np.nan)
    assert of(channel(np.arange(100) * 0.1, values)).findings == ()
    stops = np.where((np.arange(100) % 2 == 0) & (np.arange(100) < 60), np.sin(np.arange(100.0)), np.nan)
    assert kinds(of(channel(np.arange(100) * 0.1, stops))) == [Reason.NOT_A_NUMBER]
    seldom = np.where(np.arange(100) % 12 == 0, np.sin(np.arange(100.0)), np.nan)
    assert kinds(of(channel(np.arange(100) * 0.1, seldom))) == [Reason.NOT_A_NUMBER]


def test_types_frames_and_names_that_nobody_expects_are_named():
    imu = build.imu(build.nanoseconds(np.arange(50) * 0.02, START), np.ones((50, 3)), np.ones((50, 3)) * 9.81)
    moved = of(replace(imu, frame_id="other"))
    labels = {f.reason: f for f in moved.findings if f.confidence is Confidence.CERTAIN}
    assert labels[Reason.FRAME_UNEXPECTED].names == {"what": "frame id", "actual": "other", "expected": "imu_link"}
    wheels = channel(np.arange(50) * 0.1)
    named = of(replace(wheels, names=("wheel_front",)))
    (finding,) = named.findings
    assert finding.reason is Reason.NAMES_UNKNOWN
    assert finding.names == {"actual": "wheel_front", "expected": ", ".join(TOPICS[WHEELS].names)}
    other = of(replace(imu, topic=STEERING))
    assert {"actual": "sensor_msgs/msg/Imu", "expected": "sensor_msgs/msg/JointState"} in [
        f.names for f in other.findings if f.reason is Reason.TYPE_UNEXPECTED
    ]
    unknown = of(replace(wheels, topic="somebody/else"))
    assert kinds(unknown) == [Reason.TOPIC_UNKNOWN]
    assert kinds(of(replace(wheels, topic="vsense/odometry"))) == []


def test_a_recording_lists_what_it_has_and_what_it_lacks():
    wheels = channel(np.arange(50) * 0.1)
    whole = inspect(Recording({WHEELS: wheels}, "drive", notes=("a note",), messages_lost=3))
    assert (whole.name, whole.start, whole.notes, whole.messages_lost) == ("drive", START, ("a note",), 3)
    assert whole.duration == pytest.approx(4.9)
    assert whole.missing == tuple(topic for topic in USUAL_TOPICS.values() if topic != WHEELS)
    assert whole.problems == ("recording: 3 messages are lost; the notes say where",)
    empty = inspect(Recording({WHEELS: wheels.select(slice(0, 0))}))
    assert np.isnan(empty.topics[0].rate_hz)
    assert np.isnan(empty.topics[0].latency_median)
    assert empty.topics[0].nan_share == 0.0
