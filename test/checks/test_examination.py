"""All checks together, on a slalom that is known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from vsense_ros.bag.importers import build
from vsense_ros.checks import examination
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Finding, Kind, Scale
from vsense_ros.checks.inspect import inspect
from vsense_ros.checks.mending import mends
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.relations import signed_correlation
from vsense_ros.checks.roles import Role, topics_of
from vsense_ros.checks.sentences import sentences
from vsense_ros.messages.recording import Channel, Recording

START = 1_600_000_000_000_000_000
FORCES = "linear_acceleration"
SPEED, RADIUS = 15.0, 0.32
IMU, STEERING, WHEELS, VELOCITY, POSITION = (
    "imu/data", "vehicle/steering", "vehicle/wheel_speeds", "gps/velocity", "gps/fix",
)  # fmt: skip


def slalom(amplitude: float = 0.5, frequency: float = 0.5, duration: float = 60.0, delay: float = 0.0) -> Recording:
    """At constant speed with a sinusoidal course, of which the steering is ahead by `delay`."""
    noise = np.random.default_rng(0)
    t = np.arange(0.0, duration, 0.01)
    stamp = build.nanoseconds(t, START)

    def yaw_rate(at: np.ndarray) -> np.ndarray:
        return amplitude * frequency * np.cos(frequency * at)

    course, rate, zero, slow = amplitude * np.sin(frequency * t), yaw_rate(t), np.zeros_like(t), slice(None, None, 10)
    east, north = np.cumsum(SPEED * np.cos(course)) * 0.01, np.cumsum(SPEED * np.sin(course)) * 0.01
    forces = np.column_stack([zero, SPEED * rate, zero + 9.80665])
    rates = np.column_stack([zero, zero, rate])
    latitude, longitude = 50 + north / 111_200, 8 + east / 111_200 / np.cos(np.radians(50))
    velocity = np.column_stack([SPEED * np.cos(course), SPEED * np.sin(course), zero])
    shape = (len(t), 3)
    channels = [
        build.imu(stamp, rates + 1e-3 * noise.normal(size=shape), forces + 1e-2 * noise.normal(size=shape)),
        build.joints(WHEELS, stamp, "velocity", {f"wheel_{w}": zero + SPEED / RADIUS for w in ("fl", "fr")}),
        build.joints(STEERING, stamp, "position", {"steering_wheel": 3.4 * yaw_rate(t + delay)}),
        build.fix(stamp[slow], latitude[slow], longitude[slow], zero[slow]),
        build.velocity(stamp[slow], velocity[slow]),
    ]
    return Recording({c.topic: c for c in channels}, "slalom")


def changed(topic: str, change: Callable[[Channel], Channel]) -> Recording:
    recording = slalom()
    return replace(recording, channels={**recording.channels, topic: change(recording[topic])})


def scaled(field: str, factor: float | np.ndarray) -> Callable[[Channel], Channel]:
    return lambda c: replace(c, columns={**c.columns, field: c.columns[field] * factor})


def late(seconds: float) -> Callable[[Channel], Channel]:
    shift = round(seconds * 1e9)
    return lambda c: replace(c, stamp=c.stamp + shift, received=c.received + shift)


def test_a_drive_in_which_all_is_right_has_no_findings():
    assert findings(slalom()) == []


def with_turning_wheels(front: float, rear: float) -> Recording:
    """The slalom with wheels of both axles whose sides differ by so many times what the turning of the car asks for."""
    spin, rate = SPEED / RADIUS, slalom()[IMU].columns["angular_velocity"][:, 2]
    half = 0.75 * rate / RADIUS  # of a track of 1.5 m
    spins = {f"{axle}{side}": spin + sign * factor * half
             for axle, factor in (("f", front), ("r", rear)) for side, sign in (("l", -1), ("r", 1))}  # fmt: skip
    joints = build.joints(WHEELS, slalom()[IMU].stamp, "velocity", {f"wheel_{w}": v for w, v in spins.items()})
    return changed(WHEELS, lambda _: joints)


@pytest.mark.parametrize(
    ("front", "rear", "expected"),
    [(1.0, 1.0, []), (-1.0, -1.0, [Reason.WHEEL_SIDES]), (1.0, -1.0, [])],
    ids=["as the car turns", "sides exchanged", "a torque across the rear axle, whose wheels slip"],
)
def test_wheels_are_exchanged_only_where_both_axles_turn_against_the_car(front, rear, expected):
    assert [finding.reason for finding in findings(with_turning_wheels(front, rear))] == expected


@pytest.mark.parametrize(
    ("topic", "change", "kind", "reason", "signal"),
    [
        (IMU, scaled("angular_velocity", -1.0), Kind.SIGN, Reason.TURNS_AGAINST, "angular_velocity.z"),
        (IMU, scaled("angular_velocity", 57.3), Kind.UNIT, Reason.RATE_IN_DEGREES, "angular_velocity.z"),
        (IMU, scaled(FORCES, 1 / 9.81), Kind.UNIT, Reason.FORCE_IN_G, FORCES),
        (IMU, scaled(FORCES, np.array([1, -1, 1])), Kind.SIGN, Reason.LATERAL_REVERSED, f"{FORCES}.y"),
        (IMU, scaled(FORCES, np.array([1, 1, -1])), Kind.AXES, Reason.GRAVITY_AXIS, FORCES),
        (STEERING, scaled("position", -1.0), Kind.SIGN, Reason.TURNS_AGAINST, "steering_wheel"),
        (STEERING, scaled("position", 57.3), Kind.UNIT, Reason.STEERING_RANGE, "steering_wheel"),
        (WHEELS, scaled("velocity", RADIUS), Kind.UNIT, Reason.WHEELS_UNIT, ""),
        (WHEELS, scaled("velocity", -1.0), Kind.SIGN, Reason.WHEELS_BACKWARDS, ""),
        (VELOCITY, scaled("linear", np.array([-1, 1, 1])), Kind.SIGN, Reason.VELOCITY_EAST_REVERSED, ""),
        (VELOCITY, scaled("linear", 3.6), Kind.UNIT, Reason.VELOCITY_UNIT, ""),
        (POSITION, scaled("latitude", 60.0), Kind.UNIT, Reason.POSITION_RANGE, ""),
        (VELOCITY, late(0.6), Kind.LAG, Reason.POSITION_OR_VELOCITY_LATE, ""),
    ],
)  # fmt: skip
def test_a_finding_says_which_signal_is_wrong_in_which_way_and_why(topic, change, kind, reason, signal):
    found = [f for f in findings(changed(topic, change)) if f.topic == topic]
    assert (kind, reason, signal) in [(f.kind, f.reason, f.signal) for f in found], sentences(found)


@pytest.mark.parametrize("late_by", [0.0, 0.2, 0.35])
@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.0])
def test_a_healthy_car_that_is_steered_in_a_sine_is_not_mended(frequency, late_by):
    """A sine resembles itself, reversed, half a period later."""
    for duration in (12.0, 30.0):
        assert mends(slalom(0.3 / frequency, frequency, duration, late_by)) == []


@pytest.mark.parametrize("frequency", [0.4, 0.5])
def test_a_roll_rate_that_follows_a_sine_steer_later_does_not_show_the_axis_that_the_car_turns_about(frequency):
    healthy = slalom(0.3 / frequency, frequency)
    channel = healthy[IMU]
    rates = channel.columns["angular_velocity"].copy()
    yaw_rate = rates[:, 2].copy()
    rates[:, 0] = 0.3 * np.roll(yaw_rate, round(1.0 / frequency / 0.01))  # most like the yaw rate a radian later
    rates[:, 2] += 0.3 * yaw_rate.std() * np.sin(0.02 * np.arange(len(yaw_rate)))
    rolling = replace(channel, columns={**channel.columns, "angular_velocity": rates})
    assert mends(replace(healthy, channels={**healthy.channels, IMU: rolling})) == []


def test_a_sine_that_goes_along_without_a_lag_has_its_sign_though_it_is_more_like_its_reverse_half_a_period_later():
    """As where the car turns otherwise than it is steered at first: that part has no partner half a period later."""
    step = 0.02
    t = np.arange(0.0, 8.0, step)
    turning = np.sin(2 * np.pi * 0.25 * t)
    steering = np.where(t < 1.5, 0.0, turning)
    half = round(2.0 / step)
    assert np.corrcoef(steering[half:], turning[:-half])[0, 1] == pytest.approx(-1.0)
    assert signed_correlation(steering, turning, step) == pytest.approx(np.corrcoef(steering, turning)[0, 1])
    assert signed_correlation(-turning, turning, step) == 0.0  # a reversed sine may as well be late
    rng = np.random.default_rng(0)
    other = np.convolve(rng.standard_normal(len(t)), np.ones(10), mode="same")
    assert signed_correlation(-np.roll(other, 40), other, step) < -0.9


@pytest.mark.parametrize("change", [scaled("position", -1.0), scaled("position", 57.29577951308232)])
def test_what_is_mended_has_no_findings_left(change):
    wrong = changed(STEERING, change)
    todo = mends(wrong, radius=RADIUS)
    assert all(isinstance(finding.mend, Scale) for finding in todo)
    assert findings(mended(wrong, todo)) == []


def test_a_check_that_raises_is_said_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(subject: object, earlier: object) -> list[Finding]:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(examination, "OF_MOTION", (broken, *examination.OF_MOTION))
    recording = changed(STEERING, scaled("position", -1.0))
    texts = sentences(findings(recording))
    assert "recording: the check broken failed: ZeroDivisionError: by nothing" in texts
    assert any(text.startswith("vehicle/steering: steering_wheel is against") for text in texts)
    assert "recording: the check broken failed: ZeroDivisionError: by nothing" in inspect(recording).problems


class Sensor:
    kind, topic = "steering", "bus/steering"


def test_a_topic_that_the_vehicle_file_renames_is_checked_by_its_own_name():
    wrong = changed(STEERING, scaled("position", -1.0))
    moved = replace(wrong[STEERING], topic="bus/steering")
    channels = {t: c for t, c in wrong.channels.items() if t != STEERING}
    topics = topics_of([Sensor()])
    assert topics[Role.STEERING] == "bus/steering"
    renamed = replace(wrong, channels={**channels, "bus/steering": moved})
    assert [(f.topic, f.kind) for f in findings(renamed, topics)] == [("bus/steering", Kind.SIGN)]
    assert not [f for f in findings(renamed) if f.kind is Kind.SIGN]
