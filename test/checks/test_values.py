"""Values that no sensor gives: steps, jumps, repetitions and standstills planted in signals of closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import (
    IMU,
    POSITION,
    STEERED,
    STEERING,
    STEP,
    VELOCITY,
    WHEEL_SIGNALS,
    WHEELS,
    Array,
    Drive,
    only,
    recorded,
    subject_of,
)
from vsense_ros.bag.importers import build
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.values import (
    LIMITS,
    frozen_gnss,
    frozen_steering,
    frozen_wheels,
    held,
    jumps,
    limits_of,
    position_jumps,
    quantised,
    resolution,
    standing_signals,
    turns_otherwise,
)
from vsense_ros.messages.recording import Channel

START = 1_600_000_000_000_000_000
ROWS = 400
SECONDS = np.arange(ROWS) * 0.02
STAMP = build.nanoseconds(SECONDS, START)
SLOW = build.nanoseconds(np.arange(ROWS) * 0.1, START)


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=shape)


def repeated(values: Array, times: int) -> Array:
    return np.repeat(values[::times], times, axis=0)[: len(values)]


def wheels(values: Array) -> Channel:
    return build.joints(WHEELS, STAMP, "velocity", {"wheel_fl": values, "wheel_fr": values + 1.0})


@pytest.mark.parametrize("times", [2, 3, 10])
def test_values_that_stand_in_several_messages_are_named_with_both_rates(times):
    (finding,) = held(recorded(wheels(repeated(noise(ROWS), times))), [])
    assert (finding.topic, finding.kind, finding.reason) == (WHEELS, Kind.HELD, Reason.REPEATED_VALUES)
    assert finding.evidence["rows"] == times
    assert finding.evidence["sent"] == pytest.approx(50.0)
    assert finding.evidence["measured"] == pytest.approx(50.0 / times)


def test_values_that_are_new_in_each_message_or_rest_or_are_rounded_are_not_held():
    assert list(held(recorded(wheels(noise(ROWS))), [])) == []
    assert list(held(recorded(wheels(np.zeros(ROWS))), [])) == []
    assert list(held(recorded(wheels(np.round(5 * np.sin(SECONDS)))), [])) == []


def test_an_inertial_sensor_is_held_where_most_of_its_signals_are():
    rates, forces = noise(ROWS, 3), noise(ROWS, 3, seed=1)
    assert [f.topic for f in held(recorded(build.imu(STAMP, repeated(rates, 3), repeated(forces, 3))), [])] == [IMU]
    assert list(held(recorded(build.imu(STAMP, repeated(rates, 3), forces)), [])) == []
    four = np.column_stack([repeated(forces[:, 0], 3), forces[:, 1:]])
    assert [f.evidence["rows"] for f in held(recorded(build.imu(STAMP, repeated(rates, 3), four)), [])] == [3.0]


def test_the_limits_of_a_signal_follow_from_its_field_or_joint():
    assert limits_of(Role.STEERING, "position.steering_wheel") is LIMITS["steering_wheel"]
    assert limits_of(Role.STEERING, "position.other") is None
    assert limits_of(Role.VELOCITY, "linear.x") is LIMITS["linear"]
    assert limits_of(Role.VELOCITY, "velocity.x") is None
    assert limits_of(Role.WHEELS, "velocity.wheel_fl") is LIMITS["velocity"]
    assert limits_of(Role.IMU, "orientation.x") is None


# The change that is just allowed from one message to the next, 0.02 s later, of a signal without noise.
SIGNALS = {
    "angular_velocity.x": lambda v: build.imu(STAMP, np.outer(v, [1.0, 0, 0]), np.ones((ROWS, 3))),
    "linear_acceleration.y": lambda v: build.imu(STAMP, np.ones((ROWS, 3)), np.outer(v, [0, 1.0, 0])),
    "velocity.wheel_fl": lambda v: build.joints(WHEELS, STAMP, "velocity", {"wheel_fl": v}),
    "position.steering_wheel": lambda v: build.joints(STEERING, STAMP, "position", {"steering_wheel": v}),
    "position.road_wheel_front": lambda v: build.joints(STEERING, STAMP, "position", {"road_wheel_front": v}),
    "linear.x": lambda v: build.velocity(STAMP, np.outer(v, [1.0, 0, 0])),
}


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_change_that_no_car_makes_is_a_jump_and_one_that_a_car_makes_is_none(name, sign):
    limits = LIMITS[name.partition(".")[0]] if name.partition(".")[0] in LIMITS else LIMITS[name.partition(".")[2]]
    allowed = limits.fastest * 0.02 + limits.noise
    later = (np.arange(ROWS) >= 200) * sign * allowed
    assert list(jumps(recorded(SIGNALS[name](0.97 * later)), [])) == []
    (finding,) = jumps(recorded(SIGNALS[name](1.03 * later)), [])
    assert (finding.kind, finding.reason, finding.signal) == (Kind.JUMP, Reason.SIGNAL_JUMPS, name)
    assert finding.evidence == {"change": pytest.approx(1.03 * sign * allowed), "count": 1.0}
    assert finding.span == pytest.approx((4.0, 4.0))


def test_several_jumps_are_counted_and_said_once():
    values = np.zeros(ROWS)
    values[[100, 250, 300]] = 50.0
    (finding,) = jumps(recorded(SIGNALS["velocity.wheel_fl"](values)), [])
    assert (finding.reason, finding.evidence["count"]) == (Reason.SIGNAL_JUMPS_OFTEN, 6.0)
    assert finding.evidence["change"] == 50.0
    assert finding.span == pytest.approx((2.0, 2.0))


def test_noise_and_what_changes_all_the_time_and_what_lies_behind_a_pause_are_no_jumps():
    assert list(jumps(recorded(SIGNALS["velocity.wheel_fl"](20 * noise(ROWS))), [])) == []
    often = np.where(np.arange(ROWS) % 30 == 0, 50.0, 0.0)
    assert list(jumps(recorded(SIGNALS["velocity.wheel_fl"](often)), [])) == []
    later = np.arange(ROWS) >= 200
    channel = SIGNALS["velocity.wheel_fl"](50.0 * later)
    assert list(jumps(recorded(replace(channel, stamp=channel.stamp + later * 1_500_000_000)), [])) == []
    backwards = np.where(later, channel.stamp - 3_000_000_000, channel.stamp)
    assert list(jumps(recorded(replace(channel, stamp=backwards)), [])) == []
    up = build.velocity(STAMP, np.outer(50.0 * later, [0, 0, 1.0]))
    assert list(jumps(recorded(up), [])) == []


def test_a_jump_within_a_pause_is_one_where_the_rate_would_have_had_to_be_more_than_a_car_makes():
    later = np.arange(ROWS) >= 200
    channel = SIGNALS["angular_velocity.x"](30.0 * later)
    assert [f.reason for f in jumps(recorded(channel), [])] == [Reason.SIGNAL_JUMPS]
    paused = replace(channel, stamp=channel.stamp + later * 600_000_000)
    assert list(jumps(recorded(paused), [])) == []


@settings(max_examples=20, deadline=None)
@given(step=st.sampled_from([0.004, 0.02, 0.5]), seed=st.integers(0, 10))
def test_steps_coarser_than_those_of_series_sensors_are_named_with_their_size(step, seed):
    values = np.round(noise(ROWS, seed=seed) * 3) * step
    found = list(quantised(recorded(SIGNALS["angular_velocity.x"](values)), []))
    assert [f.evidence["step"] for f in found] == ([pytest.approx(step)] if step > 0.008 else [])
    for finding in found:
        assert (finding.kind, finding.reason, finding.signal) == (Kind.QUANTISED, Reason.COARSE, "angular_velocity.x")
        assert finding.names == {"unit": " rad/s", "also": ""}


def test_of_several_coarse_signals_the_coarsest_is_named_and_the_others_beside_it():
    rates = np.round(3 * noise(ROWS, 3)) * [0.1, 0.5, 0.2]
    (finding,) = quantised(recorded(build.imu(STAMP, rates, noise(ROWS, 3))), [])
    assert (finding.reason, finding.signal) == (Reason.COARSE_LIKEWISE, "angular_velocity.y")
    assert finding.names["also"] == "angular_velocity.x, angular_velocity.z"


@pytest.mark.parametrize(("step", "named"), [(1e-6, False), (1e-5, True)])
def test_coarse_coordinates_are_named_in_degrees_and_heights_may_be_coarse(step, named):
    rough = np.round(5 * noise(ROWS))
    channel = build.fix(SLOW, 48 + rough * step, 11 + noise(ROWS), rough * 10.0)
    found = list(quantised(recorded(channel), []))
    assert [(f.topic, f.signal, f.names["unit"]) for f in found] == ([(POSITION, "latitude", " deg")] if named else [])


def test_a_resolution_needs_many_values_and_more_than_two_levels():
    coarse = np.round(4 * noise(ROWS))
    assert resolution(coarse[:49]) == 0.0
    assert resolution(coarse[:60]) == 1.0
    assert resolution(np.where(coarse > 0, 1.0, 0.0)) == 0.0
    assert resolution(np.full(ROWS, 3.0)) == 0.0
    assert resolution(np.concatenate([coarse, [0.4, 0.7, 1.6, 2.3, 3.4]])) == 0.0
    assert resolution(np.arange(ROWS) ** 2 * 1.0) == 0.0


def receiver(east: Array, velocity: Array, stamp: np.ndarray = SLOW) -> tuple[Channel, Channel]:
    longitude = 8.0 + east / 111_200 / np.cos(np.radians(50.0))
    zero = np.zeros(len(east))
    linear = np.column_stack([velocity, zero, zero])
    return build.fix(stamp, zero + 50.0, longitude, zero), build.velocity(stamp, linear)


@settings(max_examples=20, deadline=None)
@given(jump=st.sampled_from([-40.0, -8.0, 10.0, 200.0]), speed=st.sampled_from([0.0, 10.0]), seed=st.integers(0, 5))
def test_a_position_that_jumps_is_named_with_how_far_and_when(jump, speed, seed):
    way = speed * np.arange(ROWS) * 0.1 + 0.2 * noise(ROWS, seed=seed) + np.where(np.arange(ROWS) >= 150, jump, 0.0)
    (finding,) = position_jumps(recorded(*receiver(way, np.full(ROWS, speed))), [])
    assert (finding.topic, finding.kind, finding.reason) == (POSITION, Kind.JUMP, Reason.POSITION_JUMPS)
    assert finding.against == VELOCITY
    assert finding.evidence["distance"] == pytest.approx(abs(jump + speed * 0.1), abs=1.5)
    assert finding.evidence["speed"] == pytest.approx(speed)
    assert finding.span == pytest.approx((15.0, 15.0))


def test_a_position_that_jumps_to_the_north_is_named_as_well():
    fix, velocity = receiver(np.zeros(ROWS), np.zeros(ROWS))
    moved = fix.columns["latitude"] + np.where(np.arange(ROWS) >= 150, 20 / 111_200, 0.0)[:, None]
    fix = replace(fix, columns={**fix.columns, "latitude": moved})
    (finding,) = position_jumps(recorded(fix, velocity), [])
    assert finding.evidence["distance"] == pytest.approx(20.0, abs=0.1)


def test_a_position_does_not_jump_by_noise_by_its_speed_in_a_long_pause_or_in_another_unit():
    steady = np.full(ROWS, 10.0)
    way = 10.0 * np.arange(ROWS) * 0.1
    assert list(position_jumps(recorded(*receiver(way + 6.0 * noise(ROWS), steady)), [])) == []
    fast = np.full(ROWS, 60.0)
    assert list(position_jumps(recorded(*receiver(60.0 * np.arange(ROWS) * 0.1, fast)), [])) == []
    later = np.arange(ROWS) >= 150
    paused = SLOW + later * 70_000_000_000
    assert list(position_jumps(recorded(*receiver(way + 3000.0 * later, steady, paused)), [])) == []
    shorter = SLOW + later * 40_000_000_000
    assert len(list(position_jumps(recorded(*receiver(way + 3000.0 * later, steady, shorter)), []))) == 1
    jump = receiver(way + 100.0 * later, steady)
    in_radians = Finding(POSITION, Kind.UNIT, Reason.POSITION_ZERO)
    assert list(position_jumps(recorded(*jump), [in_radians])) == []
    elsewhere = Finding(VELOCITY, Kind.UNIT, Reason.VELOCITY_UNIT)
    assert len(list(position_jumps(recorded(*jump), [elsewhere]))) == 1
    assert list(position_jumps(recorded(jump[0]), [])) == []


def with_a_standstill(values: Array, first: int, rows: int) -> Array:
    return np.concatenate([values[:first], np.full(rows, values[first]), values[first + rows :]])


@pytest.mark.parametrize(
    ("rows", "speed", "named"),
    [(20, 10.0, True), (16, 10.0, False), (40, 0.9, False), (40, 1.1, True), (4, 10.0, False)],
)
def test_a_receiver_that_repeats_a_velocity_while_the_car_moves_is_frozen(rows, speed, named):
    east = with_a_standstill(np.full(ROWS, speed) + 1e-4 * np.sin(np.arange(ROWS)), 100, rows)
    channel = build.velocity(SLOW, np.column_stack([east, 0 * east, 0 * east]))
    found = list(frozen_gnss(recorded(channel), []))
    assert len(found) == named
    for finding in found:
        assert (finding.kind, finding.reason, finding.confidence) == (
            Kind.FROZEN, Reason.VALUE_STANDS, Confidence.CERTAIN,
        )  # fmt: skip
        assert finding.span == pytest.approx((10.1, 10.0 + 0.1 * (rows - 1)))


def test_a_receiver_whose_north_changes_and_one_with_few_messages_are_not_frozen():
    east = with_a_standstill(10 + 1e-4 * np.sin(np.arange(ROWS)), 100, 40)
    changing = np.column_stack([east, np.sin(np.arange(ROWS)), 0 * east])
    assert list(frozen_gnss(recorded(build.velocity(SLOW, changing)), [])) == []
    seldom = build.nanoseconds(np.arange(ROWS) * 1.0, START)
    few = with_a_standstill(10 + 1e-4 * np.sin(np.arange(ROWS)), 100, 4)
    assert list(frozen_gnss(recorded(build.velocity(seldom, np.column_stack([few, 0 * few, 0 * few]))), [])) == []
    assert list(frozen_gnss(recorded(), [])) == []


@pytest.mark.parametrize(("seconds", "named"), [(3.0, True), (1.4, False)])
@pytest.mark.parametrize("name", WHEEL_SIGNALS)
def test_a_wheel_that_keeps_its_speed_while_the_others_change_theirs_is_frozen(name, seconds, named):
    signals = only(Drive().signals(), *WHEEL_SIGNALS)
    signals[name] = with_a_standstill(signals[name], 500, round(seconds / STEP))
    found = list(frozen_wheels(subject_of(signals, begin=2.0), []))
    assert len(found) == named
    for finding in found:
        assert (finding.topic, finding.signal, finding.reason) == (WHEELS, name, Reason.VALUE_STANDS)
        assert finding.span == pytest.approx((12.0 + STEP, 12.0 + seconds), abs=2 * STEP)


def test_wheels_that_all_keep_their_speed_or_hardly_turn_are_not_frozen():
    signals = {name: with_a_standstill(v, 500, 200) for name, v in only(Drive().signals(), *WHEEL_SIGNALS).items()}
    assert list(frozen_wheels(subject_of(signals), [])) == []
    slow = only(Drive(speed=1.2, pushing=0.2).signals(), *WHEEL_SIGNALS)
    slow["wheel_fl"] = with_a_standstill(slow["wheel_fl"], 500, 200)
    assert list(frozen_wheels(subject_of(slow), [])) == []
    one = {"wheel_fl": with_a_standstill(Drive().signals()["wheel_fl"], 500, 200)}
    assert list(frozen_wheels(subject_of(one), [])) == []


@pytest.mark.parametrize("name", STEERED)
@pytest.mark.parametrize(("seconds", "named"), [(5.0, True), (1.9, False)])
def test_a_steering_angle_that_stands_while_the_car_turns_otherwise_is_frozen(name, seconds, named):
    signals = only(Drive().signals(), "east", "north", "wz", name)
    signals[name] = with_a_standstill(signals[name], 500, round(seconds / STEP))
    found = list(frozen_steering(subject_of(signals, begin=2.0), []))
    assert len(found) == named
    for finding in found:
        assert (finding.topic, finding.signal, finding.reason) == (STEERING, name, Reason.STEERING_STANDS)
        assert finding.span == pytest.approx((12.0 + STEP, 12.0 + seconds), abs=2 * STEP)


def test_a_steering_angle_may_stand_while_the_car_goes_on_as_before():
    t = np.arange(0.0, 40.0, STEP)
    circle = {
        "east": 12 * np.cos(0.3 * t),
        "north": 12 * np.sin(0.3 * t),
        "wz": 0 * t + 0.3,
        "steering_wheel": 0 * t + 1.0,
    }
    assert list(frozen_steering(subject_of(circle), [])) == []
    moving = only(Drive().signals(), "east", "north", "steering_wheel")
    moving["steering_wheel"] = 0 * t
    assert list(frozen_steering(subject_of(moving), [])) == []


def test_a_car_turns_otherwise_by_its_curvature_and_not_by_its_speed_alone():
    speed = np.linspace(10.0, 20.0, 100)
    assert not turns_otherwise(0.02 * speed**2, speed, 1.5, 0.5)
    assert turns_otherwise(np.linspace(-0.02, 0.02, 100) * speed**2, speed, 1.5, 0.5)
    steady = np.full(100, 10.0)
    assert not turns_otherwise(np.linspace(0.0, 1.4, 100), steady, 1.5, 0.5)
    assert turns_otherwise(np.linspace(0.0, 1.6, 100), steady, 1.5, 0.5)
    assert not turns_otherwise(np.linspace(6.0, 8.0, 100), steady, 1.5, 0.5)
    assert not turns_otherwise(np.linspace(0.0, 9.0, 10), steady[:10], 1.5, 0.5)


@pytest.mark.parametrize(("rows", "named"), [(60, True), (45, False)])
def test_a_signal_that_keeps_its_value_is_named_where_that_is_longest(rows, named):
    values = with_a_standstill(with_a_standstill(noise(ROWS), 50, 55), 200, rows)
    channel = SIGNALS["velocity.wheel_fl"](values)
    found = list(standing_signals(channel, 1.0, 20))
    first, length = (200, 60) if named else (50, 55)
    assert found == [("velocity.wheel_fl", pytest.approx(first * 0.02), pytest.approx((first + length - 1) * 0.02))]
    assert list(standing_signals(channel, 1.3, 20)) == []
    assert list(standing_signals(channel, 1.0, 60)) == []
