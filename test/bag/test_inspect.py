"""What inspection finds in drives that were spoilt on purpose, and does not find in good ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from vsense_ros.bag.importers import build
from vsense_ros.checks.inspect import TopicInfo, inspect
from vsense_ros.messages.recording import Channel, Recording

START = 1_600_000_000_000_000_000
RADIUS = 0.32


def drive() -> Recording:
    """A minute of slalom at 15 m/s with all sensors right."""
    noise = np.random.default_rng(0)
    time = np.arange(0, 60, 0.01)
    stamp = build.nanoseconds(time, START)
    course = 0.5 * np.sin(0.5 * time)
    rate = np.gradient(course, time)
    speed = np.full_like(time, 15.0)
    zero = np.zeros_like(time)
    slow = slice(None, None, 10)
    east, north = np.cumsum(speed * np.cos(course)) * 0.01, np.cumsum(speed * np.sin(course)) * 0.01
    degree = 111_200.0
    channels = [
        build.imu(
            stamp,
            np.column_stack([zero, zero, rate]) + 1e-3 * noise.normal(size=(len(time), 3)),
            np.column_stack([zero, speed * rate, zero + 9.81]) + 1e-2 * noise.normal(size=(len(time), 3)),
        ),
        build.joints(
            "vehicle/wheel_speeds", stamp, "velocity", {f"wheel_{w}": speed / RADIUS + 0 * rate for w in ("fl", "fr")}
        ),
        build.joints("vehicle/steering", stamp, "position", {"steering_wheel": rate * 15 * (2.7 / 15 + 0.003 * 15)}),
        build.fix(
            stamp[slow], (50 + north / degree)[slow], (8 + east / degree / np.cos(np.radians(50)))[slow], zero[slow]
        ),
        build.velocity(stamp[slow], np.column_stack([speed * np.cos(course), speed * np.sin(course), zero])[slow]),
    ]
    return Recording({c.topic: c for c in channels}, "slalom")


def changed(topic: str, change: Callable[[Channel], Channel]) -> TopicInfo:
    recording = drive()
    channels = {**recording.channels, topic: change(recording[topic])}
    [info] = [info for info in inspect(replace(recording, channels=channels)).topics if info.topic == topic]
    return info


def scaled(field: str, factor: float | NDArray[np.float64]) -> Callable[[Channel], Channel]:
    return lambda c: replace(c, columns={**c.columns, field: c.columns[field] * factor})


def test_a_good_drive_raises_no_doubt() -> None:
    found = inspect(drive())
    assert found.problems == ()
    rates = {info.topic: info.rate_hz for info in found.topics}
    assert rates["imu/data"] == pytest.approx(100.0)
    assert rates["gps/fix"] == pytest.approx(10.0)
    assert "vehicle/suspension" in found.missing


def test_the_real_recordings_raise_no_doubt(rav4: Recording) -> None:
    found = inspect(rav4)
    assert found.problems == ()
    fix = next(info for info in found.topics if info.topic == "gps/fix")
    assert 0.19 < fix.latency_median < 0.22 < fix.latency_p99 < 0.25


def test_the_laps_raise_no_doubt(genesis: Recording) -> None:
    assert inspect(genesis).problems == ()


@pytest.mark.parametrize(
    ("topic", "field", "factor", "message"),
    [
        ("vehicle/wheel_speeds", "velocity", RADIUS, "look like m/s"),
        ("vehicle/wheel_speeds", "velocity", RADIUS * 3.6, "look like km/h"),
        ("vehicle/wheel_speeds", "velocity", 60 / (2 * np.pi), "look like rpm"),
        ("vehicle/wheel_speeds", "velocity", 180 / np.pi, "look like deg/s"),
        ("vehicle/wheel_speeds", "velocity", -1.0, "turn backwards"),
        ("vehicle/wheel_speeds", "velocity", 0.1, "no rolling radius"),
        ("imu/data", "angular_velocity", 180 / np.pi, "yaw rate looks like deg/s"),
        ("imu/data", "angular_velocity", -1.0, "against the turning"),
        ("imu/data", "linear_acceleration", 1 / 9.81, "looks like g"),
        ("imu/data", "linear_acceleration", np.array([1.0, -1.0, -1.0]), "gravity is on -z"),
        ("imu/data", "linear_acceleration", np.array([1.0, 1.0, 0.0]), "no gravity in it"),
        ("vehicle/steering", "position", 180 / np.pi, "is it in degrees"),
        ("vehicle/steering", "position", -1.0, "against the turning"),
        ("gps/fix", "latitude", 60.0, "out of range"),
    ],
)
def test_a_wrong_unit_or_sign_is_seen(
    topic: str, field: str, factor: float | NDArray[np.float64], message: str
) -> None:
    problems = changed(topic, scaled(field, factor)).problems
    assert any(message in problem for problem in problems), problems


def test_a_gap_is_told_with_its_time_and_length() -> None:
    info = changed("imu/data", lambda c: c.select((c.seconds < 10.0) | (c.seconds > 12.0)))
    [gap] = info.gaps
    assert (gap.start, gap.length) == (pytest.approx(9.99), pytest.approx(2.02))
    assert "1 gaps, the longest 2.02 s at 9.99 s" in info.problems


def test_a_clock_that_jumps_by_an_hour_is_told_as_a_jump_not_as_a_gap() -> None:
    late = np.arange(6000) >= 3000
    info = changed("imu/data", lambda c: replace(c, stamp=c.stamp + late * 3_600_000_000_000))
    assert info.gaps == ()
    assert info.jumps == (pytest.approx(3600.01),)
    assert any("the clock jumps by +3600.0 s at 30.00 s" in problem for problem in info.problems)


def test_time_that_runs_backwards_or_stands_still_is_counted() -> None:
    def swap(channel: Channel) -> Channel:
        stamp = channel.stamp.copy()
        stamp[[100, 101]] = stamp[[101, 100]]
        stamp[200] = stamp[199]
        return replace(channel, stamp=stamp)

    info = changed("imu/data", swap)
    assert (info.backwards, info.duplicates) == (1, 1)
    assert "1 messages are older than the one before them" in info.problems
    assert "1 messages have the time stamp of the one before them" in info.problems


def test_a_frozen_inertial_signal_is_told_with_its_time() -> None:
    def freeze(channel: Channel) -> Channel:
        rates = channel.columns["angular_velocity"].copy()
        rates[2000:2500, 2] = rates[2000, 2]
        return replace(channel, columns={**channel.columns, "angular_velocity": rates})

    assert "angular_velocity.z is frozen for 5.0 s from 20.0 s on" in changed("imu/data", freeze).problems


def test_nan_is_counted_but_a_component_that_is_never_there_is_no_problem() -> None:
    def spoil(channel: Channel) -> Channel:
        rates = channel.columns["angular_velocity"].copy()
        rates[:, 0] = np.nan
        rates[:60, 2] = np.nan
        return replace(channel, columns={**channel.columns, "angular_velocity": rates})

    info = changed("imu/data", spoil)
    assert info.problems == ("angular_velocity.z is NaN in 60 of 6000 messages",)
    assert info.nan_share == pytest.approx((1 + 0.01) / 6)


def test_a_constant_signal_is_listed() -> None:
    info = changed("vehicle/wheel_speeds", lambda c: c)
    assert info.constant == ("velocity.wheel_fl", "velocity.wheel_fr")


def test_a_wrong_frame_id_or_joint_name_is_told_with_the_expected_one() -> None:
    assert changed("imu/data", lambda c: replace(c, frame_id="base_link")).problems == (
        "frame id is 'base_link', expected 'imu_link'",
    )
    [problem] = changed("vehicle/steering", lambda c: replace(c, names=("delta",))).problems
    assert problem == "names delta are unknown, expected steering_wheel, road_wheel_front"


def test_a_topic_that_nothing_reads_is_told() -> None:
    recording = drive()
    odd = replace(recording["imu/data"], topic="imu/raw")
    found = inspect(replace(recording, channels={**recording.channels, "imu/raw": odd}))
    assert found.problems == ("imu/raw: no topic of this project: nothing reads it, unless a mapping says what it is",)


def test_a_jump_of_the_position_is_told_with_time_and_size() -> None:
    def jump(channel: Channel) -> Channel:
        latitude = channel.columns["latitude"].copy()
        latitude[300:] += 20.0 / 111_200.0
        return replace(channel, columns={**channel.columns, "latitude": latitude})

    [problem] = changed("gps/fix", jump).problems
    assert "the position jumps by" in problem
    assert "at 30.00 s, at 15.0 m/s" in problem


def test_a_brake_pressure_in_bar_is_seen() -> None:
    recording = drive()
    stamp = recording["imu/data"].stamp
    pressure = build.joints("vehicle/brake_pressure", stamp, "effort", {"wheel_fl": np.linspace(0, 80, len(stamp))})
    found = inspect(replace(recording, channels={**recording.channels, pressure.topic: pressure}))
    assert found.problems == (
        "vehicle/brake_pressure: reaches 80.0 Pa only, which brakes nothing: is it in bar or kPa?",
    )


def test_an_empty_channel_is_no_crash() -> None:
    recording = drive()
    empty = {topic: channel.select(slice(0, 0)) for topic, channel in recording.channels.items()}
    found = inspect(replace(recording, channels=empty))
    assert [info.count for info in found.topics] == [0] * 5
