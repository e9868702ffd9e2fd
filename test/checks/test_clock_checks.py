"""Clocks that are late, that run or step, on drives and stamps in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from synthetic_motion import (
    GNSS_SIGNALS,
    IMU,
    INERTIAL,
    POSITION,
    STEERED,
    STEERING,
    STEP,
    VELOCITY,
    WHEEL_SIGNALS,
    WHEELS,
    Drive,
    late,
    only,
    recorded,
    subject_of,
)
from vsense_ros.bag.importers import build
from vsense_ros.checks.clocks import apart, lags, repeated, running
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.reason import Reason
from vsense_ros.messages.recording import Channel

TORQUES = "vehicle/wheel_torques"
START = 1_600_000_000_000_000_000
BY_TOPIC = {IMU: INERTIAL, VELOCITY: GNSS_SIGNALS, WHEELS: WHEEL_SIGNALS}


def test_sensors_that_share_a_clock_are_not_late():
    assert list(lags(subject_of(Drive().signals()), [])) == []


@pytest.mark.parametrize("topic", BY_TOPIC)
@pytest.mark.parametrize("delay", [0.5, -0.5, 0.74])
def test_the_sensor_whose_clock_is_another_one_is_named_with_its_lag(topic, delay):
    (finding,) = lags(
        subject_of(Drive().signals(late(delay, *BY_TOPIC[topic], *("xy" if topic == VELOCITY else ())))), []
    )
    assert (finding.topic, finding.kind, finding.reason) == (topic, Kind.LAG, Reason.LATE)
    assert finding.confidence is Confidence.LIKELY
    for other in BY_TOPIC.keys() - {topic}:
        assert finding.evidence[other] == pytest.approx(delay, abs=0.05)
    assert finding.against == ", ".join(finding.evidence)


def test_an_accelerometer_that_is_smoothed_beside_a_gyro_in_time_is_said_to_be_late():
    signals = only(Drive(pushing=2.0, duration=120.0).signals(), *INERTIAL, *WHEEL_SIGNALS, *GNSS_SIGNALS)
    assert list(lags(subject_of(signals), [])) == []
    low_pass = (
        1.5  # [s] which delays what changes once in ten seconds by arctan(ω τ) / ω = 1.2 s, and faster parts less
    )
    signals["ax"] = lfilter([STEP / low_pass], [1.0 + STEP / low_pass, -1.0], signals["ax"])
    (finding,) = lags(subject_of(signals), [])
    assert (finding.topic, finding.reason, finding.confidence) == (IMU, Reason.GAINS_LATE, Confidence.LIKELY)
    assert finding.evidence.keys() == {VELOCITY, WHEELS}
    assert all(0.6 < seconds < 1.2 for seconds in finding.evidence.values())


@pytest.mark.parametrize("delay", [0.04, -0.36, 0.1, -0.46, 0.3, -0.7])
def test_a_car_may_follow_its_steering_by_a_moment_but_not_be_ahead_of_it(delay):
    signals = only(Drive(pushing=0.0).signals(late(delay, *STEERED)), "wz", "wheel_fl", *STEERED)
    found = list(lags(subject_of(signals), []))
    if delay in (0.04, -0.36):
        assert found == []
        return
    (finding,) = found  # steering is trusted less than the gyro
    assert (finding.topic, finding.reason, finding.against) == (STEERING, Reason.LATE, IMU)
    assert finding.evidence == {IMU: pytest.approx(delay, abs=0.03)}


# Signals of two sources, those of which are late, and lags within and beyond what is allowed for fast and slow GNSS.
TURNING, PUSHING = Drive(pushing=0.0), Drive(turning=0.0, pushing=1.5)
PAIRS = {
    "gyro, wheels": (TURNING, ("wz", *WHEEL_SIGNALS), ("wz",), (-0.1, 0.1), (-0.16, 0.16)),
    "gyro, GNSS": (TURNING, ("wz", *GNSS_SIGNALS), ("wz",), (-0.24, 0.18), (-0.36, 0.28)),
    "accelerometer, GNSS by turning": (TURNING, ("ay", *GNSS_SIGNALS), ("ay",), (-0.12, 0.12), (-0.2, 0.2)),
    "accelerometer, GNSS by pushing": (PUSHING, ("ax", *GNSS_SIGNALS), ("ax",), (-0.08, 0.16), (-0.14, 0.26)),
    "accelerometer, wheels": (PUSHING, ("ax", "wheel_fl"), ("ax",), (-0.08, 0.16), (-0.14, 0.26)),
    "wheels, GNSS by pushing": (PUSHING, ("wheel_fl", *GNSS_SIGNALS), ("wheel_fl",), (-0.12, 0.12), (-0.2, 0.2)),
    "wheels, GNSS by turning": (
        TURNING, (*WHEEL_SIGNALS, *GNSS_SIGNALS), WHEEL_SIGNALS, (-0.26, 0.2), (-0.36, 0.3),
    ),
}  # fmt: skip


@pytest.mark.parametrize("pair", PAIRS)
def test_two_sources_may_be_apart_as_far_as_healthy_cars_are_and_are_both_doubted_beyond(pair):
    drive, names, delayed, within, beyond = PAIRS[pair]
    for delay in within:
        assert list(lags(subject_of(only(drive.signals(late(delay, *delayed)), *names)), [])) == [], delay
    for delay in beyond:
        found = list(lags(subject_of(only(drive.signals(late(delay, *delayed)), *names)), []))
        assert {finding.reason for finding in found} == {Reason.LATE_OR_OTHER}, delay
        assert {finding.confidence for finding in found} == {Confidence.UNDECIDED}
        (one,), (other,) = (finding.evidence.values() for finding in found)
        assert one == -other
        assert abs(one) == pytest.approx(abs(delay), abs=0.05)


@pytest.mark.parametrize("pair", [name for name in PAIRS if "GNSS" in name])
def test_lags_of_a_receiver_with_few_messages_are_known_less_well(pair):
    drive, names, delayed, _, beyond = PAIRS[pair]
    for delay in beyond:
        signals = only(drive.signals(late(delay, *delayed)), *names)
        assert list(lags(subject_of(signals, period=0.55), [])) == [], delay


@pytest.mark.parametrize("period", [0.1, 1.0])
@pytest.mark.parametrize("delay", [1.5, 2.4])
def test_a_receiver_seconds_late_is_seen_by_the_speed_of_the_car(delay, period):
    signals = only(Drive(turning=0.0, pushing=2.0).signals(late(delay, *GNSS_SIGNALS)), "wheel_fl", *GNSS_SIGNALS)
    found = {finding.topic: finding for finding in lags(subject_of(signals, period=period), [])}
    assert found[VELOCITY].reason is Reason.LATE_OR_OTHER
    assert found[VELOCITY].evidence[WHEELS] == pytest.approx(delay, abs=0.1)
    assert found[WHEELS].evidence[VELOCITY] == pytest.approx(-delay, abs=0.1)


@pytest.mark.parametrize("drive", [Drive(turning=0.0, pushing=0.0), Drive(turning=0.05, pushing=0.05)])
def test_a_drive_that_hardly_turns_or_changes_its_speed_shows_no_lag(drive):
    assert list(lags(subject_of(drive.signals(late(0.5, *INERTIAL))), [])) == []


@pytest.mark.parametrize("delay", [0.4, -0.4])
def test_of_position_and_velocity_of_a_receiver_both_are_doubted_if_nothing_else_decides(delay):
    signals = only(Drive().signals(late(delay, "x", "y")), "x", "y", *GNSS_SIGNALS)
    found = {finding.topic: finding for finding in lags(subject_of(signals), [])}
    assert found.keys() == {POSITION, VELOCITY}
    assert {finding.reason for finding in found.values()} == {Reason.POSITION_OR_VELOCITY_LATE}
    assert found[POSITION].evidence[VELOCITY] == pytest.approx(delay, abs=0.03)
    assert found[VELOCITY].evidence[POSITION] == pytest.approx(-delay, abs=0.03)


@pytest.mark.parametrize("delay", [0.4, -0.4])
def test_a_velocity_that_goes_along_with_the_gyro_is_right_and_its_position_late(delay):
    (finding,) = lags(subject_of(Drive().signals(late(delay, "x", "y"))), [])
    assert (finding.topic, finding.reason) == (POSITION, Reason.POSITION_LATE)
    assert finding.evidence[VELOCITY] == pytest.approx(delay, abs=0.03)


def test_a_position_is_not_compared_where_one_of_both_is_blamed_or_the_lag_small_or_nothing_moves():
    signals = Drive().signals(late(0.4, "x", "y"))
    blamed = Finding(POSITION, Kind.FRAME, Reason.POSITION_EXCHANGED)
    assert list(lags(subject_of(signals), [blamed])) == []
    assert list(lags(subject_of(Drive().signals(late(0.12, "x", "y"))), [])) == []
    assert list(lags(subject_of(only(signals, "x", "y", "wz")), [])) == []
    still = Drive(turning=0.0, pushing=0.3).signals(late(0.4, "x", "y"))
    assert list(lags(subject_of(still), [])) == []


def stamped(topic: str, begin: float, end: float, period: float = 0.1, received: np.ndarray | None = None) -> Channel:
    stamp = build.nanoseconds(np.arange(begin, end, period), START)
    names = {STEERING: "steering_wheel"}.get(topic, "wheel_fl")
    channel = build.joints(topic, stamp, "position", {names: np.zeros(len(stamp))})
    return channel if received is None else replace(channel, received=received)


def found_apart(**spans: tuple[float, float]) -> list[tuple[str, Reason, float]]:
    topics = {
        "wheels": WHEELS,
        "steering": STEERING,
        "torques": TORQUES,
        "pressures": "vehicle/brake_pressure",
    }
    channels = [stamped(topics[name], *span) for name, span in spans.items()]
    return [
        (finding.topic, finding.reason, round(sum(finding.evidence.values()), 2))
        for finding in apart(recorded(*channels), [])
    ]


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ({"wheels": (0, 20), "steering": (0, 20), "torques": (0.9, 19.2)}, []),
        ({"wheels": (0, 20)}, []),
        ({"wheels": (0, 20), "steering": (30, 50)}, [(STEERING, Reason.NO_COMMON_TIME_WITH, 0.0)]),
        (
            {"wheels": (0, 20), "steering": (0, 20), "torques": (30, 50)},
            [(TORQUES, Reason.NO_COMMON_TIME, 10.1)],
        ),
        (
            {"wheels": (30, 50), "steering": (30, 50), "torques": (0, 20)},
            [(TORQUES, Reason.NO_COMMON_TIME, 10.1)],
        ),
        ({"wheels": (0, 20), "steering": (0, 20), "torques": (5, 25)}, [(TORQUES, Reason.CLOCK_LATER, 5.0)]),
        ({"wheels": (5, 25), "steering": (5, 25), "torques": (0, 20)}, [(TORQUES, Reason.CLOCK_EARLIER, 5.0)]),
        ({"wheels": (0, 20), "steering": (0, 20), "torques": (0, 17)}, [(TORQUES, Reason.ENDS_EARLY, 3.0)]),
        ({"wheels": (0, 20), "steering": (0, 20), "torques": (4, 20)}, [(TORQUES, Reason.BEGINS_LATE, 4.0)]),
        ({"wheels": (0, 20), "steering": (0, 20), "pressures": (0, 20), "torques": (0, 25)}, []),
    ],
)  # fmt: skip
def test_a_topic_whose_time_is_not_that_of_the_others_is_named(spans, expected):
    assert found_apart(**spans) == expected


def test_where_all_are_apart_from_each_other_nobody_is_named():
    assert found_apart(wheels=(0, 20), steering=(30, 50), torques=(60, 80)) == []


def test_a_slow_topic_may_end_some_of_its_periods_earlier():
    slow = stamped(STEERING, 0.0, 20.1, period=1.0)
    quick = stamped(WHEELS, 0.0, 24.0)
    other = stamped(TORQUES, 0.0, 24.0)
    assert list(apart(recorded(slow, quick, other), [])) == []
    (finding,) = apart(recorded(slow.select(slice(0, 17)), quick, other), [])
    assert (finding.topic, finding.reason) == (STEERING, Reason.ENDS_EARLY)


def with_delay(delay: np.ndarray, period: float = 0.1) -> Channel:
    seconds = np.arange(len(delay)) * period
    stamp = build.nanoseconds(seconds, START)
    channel = build.joints(WHEELS, stamp, "velocity", {"wheel_fl": seconds})
    return replace(channel, received=build.nanoseconds(seconds + delay, START))


@pytest.mark.parametrize("change", [0.4, -0.4, 3.0])
def test_a_clock_that_steps_is_named_with_by_how_much_and_when(change):
    delay = np.where(np.arange(200) < 100, 4.0, 4.0 - change)
    (finding,) = running(recorded(with_delay(delay)), [])
    assert (finding.kind, finding.reason) == (Kind.CLOCK, Reason.CLOCK_STEPS)
    assert finding.evidence["change"] == pytest.approx(change)
    assert finding.span == pytest.approx((10.0 - change, 10.0 - change))


def test_a_message_that_is_late_alone_and_a_delay_that_always_scatters_are_no_step():
    alone = np.full(200, 0.02)
    alone[100] = 0.9
    assert list(running(recorded(with_delay(alone)), [])) == []
    scattered = np.random.default_rng(0).uniform(0.0, 0.6, 200)
    assert list(running(recorded(with_delay(scattered)), [])) == []
    assert list(running(recorded(with_delay(np.where(np.arange(200) < 100, 0.4, 0.2))), [])) == []


@settings(max_examples=20, deadline=None)
@given(rate=st.floats(1.3e-3, 5e-3), sign=st.sampled_from([-1, 1]), seed=st.integers(0, 5))
def test_a_clock_that_runs_is_named_with_its_rate(rate, sign, seed):
    seconds = np.arange(600) * 0.1
    delay = 1.0 + sign * rate * seconds + np.abs(np.random.default_rng(seed).normal(scale=1e-3, size=600))
    (finding,) = running(recorded(with_delay(delay)), [])
    assert finding.reason is (Reason.CLOCK_SLOWER if sign > 0 else Reason.CLOCK_FASTER)
    assert finding.evidence["rate"] == pytest.approx(rate, rel=0.1)


@pytest.mark.parametrize(
    "delay",
    [
        0.5 + 2e-4 * np.arange(600) * 0.1,  # as crystals do
        0.5 + 1.5e-3 * np.arange(200) * 0.1,  # 0.03 s in all
        0.5 + 1.5e-3 * np.arange(30) * 0.1,  # a short drive
        0.5 + 5e-3 * np.arange(19) * 1.0,  # few messages
        np.random.default_rng(0).uniform(0.1, 0.9, 600),
        np.zeros(600),
    ],
    ids=["crystals", "little in all", "short", "few messages", "scatter", "stamps are arrivals"],
)
def test_a_clock_is_not_said_to_run_where_that_is_not_seen(delay):
    assert list(running(recorded(with_delay(delay)), [])) == []


def test_messages_that_come_a_second_time_are_counted():
    channel = stamped(WHEELS, 0.0, 5.0)
    again = channel.select(np.concatenate([np.arange(50), np.arange(10, 17)]))
    again = replace(again, received=build.nanoseconds(np.arange(57) * 0.1, START))
    (finding,) = repeated(recorded(again), [])
    assert (finding.kind, finding.reason, finding.evidence) == (Kind.DUPLICATES, Reason.COPIES, {"count": 7.0})


def test_messages_with_the_stamp_of_the_one_before_or_out_of_order_are_no_copies():
    channel = stamped(WHEELS, 0.0, 5.0)
    in_turn = replace(channel, received=build.nanoseconds(np.arange(50) * 0.1, START))
    twice = in_turn.select(np.sort(np.concatenate([np.arange(50), np.arange(10, 17)])))
    assert list(repeated(recorded(twice), [])) == []
    swapped = np.arange(50)
    swapped[[20, 21]] = 21, 20
    assert list(repeated(recorded(replace(in_turn, stamp=in_turn.stamp[swapped])), [])) == []
    assert list(repeated(recorded(channel.select(slice(0, 5))), [])) == []


def test_a_lateral_acceleration_that_is_later_than_the_gyro_beside_it_is_said_to_be():
    signals = Drive(duration=60.0).signals()
    assert list(lags(subject_of(signals), [])) == []
    rows = round(0.6 / STEP)
    signals["ay"] = np.concatenate([np.full(rows, signals["ay"][0]), signals["ay"][:-rows]])
    (finding,) = lags(subject_of(signals), [])
    assert (finding.topic, finding.reason, finding.signal) == (IMU, Reason.GAINS_LATE, "linear_acceleration.y")
    assert finding.evidence.keys() == {VELOCITY, WHEELS}
    assert all(0.5 < seconds < 0.7 for seconds in finding.evidence.values())
