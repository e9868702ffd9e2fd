"""What cannot be true is refused and named, and costs nothing that was good."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drives import (
    FIX,
    IMU,
    SECOND,
    SENSORS,
    STEERING,
    VELOCITY,
    WHEELS,
    Course,
    altered,
    changed,
    distance,
    feed,
    follow,
    messages,
    seconds,
)
from marks import exam_except
from vsense_ros.estimation.health import Health
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.sensors import GnssPosition, Imu
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

NAMES = {topic: name for name, topic in SENSORS.items()}
NAN, INFINITE, HUGE = np.nan, np.inf, 1e300


@pytest.fixture
def observer(vehicle: Vehicle, lane_change: Recording) -> Runner:
    return Runner(vehicle, lane_change.map_origin)


@pytest.fixture
def between(lane_change: Recording) -> Callable[..., Callable[[Sample], bool]]:
    """Makes a condition: messages of a topic in a stretch of time [s]."""

    def condition(topic: str, begin: float, end: float) -> Callable[[Sample], bool]:
        return lambda s: s.topic == topic and begin <= seconds(lane_change, s) < end

    return condition


def filled(sample: Sample, value: float) -> Sample:
    """The message with one value in all its fields that are not empty."""
    return changed(sample, **{f: np.full_like(v, value) for f, v in sample.values.items() if v.size})


def assert_good(course: Course, after: float = 8.0) -> None:
    speed, lateral, yaw_rate = course.largest(after)
    assert speed < 0.3
    assert lateral < 0.4
    assert yaw_rate < 0.06


@pytest.mark.parametrize("value", exam_except([NAN, INFINITE, -INFINITE, HUGE], NAN))
@pytest.mark.parametrize("topic", exam_except(SENSORS.values(), VELOCITY))
def test_numbers_that_are_none_are_refused_and_the_sensor_named(
    topic: str, value: float, observer: Runner, clean: Runner, lane_change: Recording, between
) -> None:
    bad = altered(messages(lane_change), between(topic, 5, 5.2), lambda s: filled(s, value))
    course = follow(observer, bad, lane_change)
    assert course.levels(NAMES[topic], 5.15, 5.3) <= {"WARN"}
    assert "no usable number" in course.words(NAMES[topic])
    assert course.levels(NAMES[topic], 9, 12) == {"OK"}
    health, untouched = (o.health[o.names.index(NAMES[topic])] for o in (observer, clean))
    assert health.used + health.invalid == untouched.used + untouched.invalid
    assert_good(course)


def test_one_gyro_axis_that_is_not_a_number_leaves_the_other_five(
    observer: Runner, lane_change: Recording, between
) -> None:
    def without_pitch_rate(s: Sample) -> Sample:
        return changed(s, angular_velocity=s.values["angular_velocity"] * [1, NAN, 1])

    course = follow(observer, altered(messages(lane_change), between(IMU, 4, 8), without_pitch_rate), lane_change)
    assert observer.health[0].invalid == 0
    assert_good(course, 2.0)


def test_known_offsets_of_an_imu_are_taken_off() -> None:
    imu = Imu(rate_offset=(0.1, 0.2, 0.3), force_offset=(1, 2, 3))
    values = {"angular_velocity": np.zeros(3), "linear_acceleration": np.ones(3)}
    event = Reader(0, imu, Map(None)).read(Sample("imu/data", imu.message, 0, values))
    assert isinstance(event, Event)
    np.testing.assert_allclose(event.value, [-0.1, -0.2, -0.3, 0, -1, -2])


def test_a_variance_that_is_no_number_leaves_its_component_out_each_time() -> None:
    position = GnssPosition()
    reader = Reader(0, position, Map((43.0, -8.0, 0.0)))
    values = {k: np.array([v]) for k, v in (("latitude", 43.0), ("longitude", -8.0), ("altitude", 0.0))}
    values["position_covariance"] = np.diag([2.0, 1e300, 1.0]).ravel()
    for _ in range(2):
        event = reader.read(Sample("gps/fix", position.message, 0, values))
        assert isinstance(event, Event)
        np.testing.assert_allclose(event.value, [0.0, np.nan], atol=1e-6)
        np.testing.assert_allclose(event.variance, [2.0, 1.0])


@pytest.mark.parametrize("value", exam_except([NAN, INFINITE, HUGE, -1.0, 0.0, 1e-30], 1e-30))
def test_a_covariance_that_cannot_be_true_does_no_harm(
    value: float, observer: Runner, lane_change: Recording, between
) -> None:
    def with_covariance(s: Sample) -> Sample:
        return changed(s, **{f: np.full_like(v, value) for f, v in s.values.items() if f.endswith("covariance")})

    stream = altered(messages(lane_change), between(VELOCITY, 4, 6), with_covariance)
    stream = altered(stream, between(IMU, 4, 6), with_covariance)
    assert_good(follow(observer, stream, lane_change))


def test_a_jump_of_the_position_by_20_m_is_refused(observer: Runner, lane_change: Recording, between) -> None:
    def moved(s: Sample) -> Sample:
        return changed(s, latitude=s.values["latitude"] + 20 / 111_200)

    course = follow(observer, altered(messages(lane_change), between(FIX, 5, 7), moved), lane_change)
    assert "WARN" in course.levels("position", 5, 8)
    assert "standard deviations" in course.words("position")
    assert observer.health[observer.names.index("position")].refused == 20
    assert course.position[course.t > 3].max() < 2
    assert_good(course)


def elsewhere(sample: Sample) -> Sample:
    """A velocity as fast as it was, in another direction."""
    east, north, up = sample.values["linear"]
    return changed(sample, linear=np.array([-north, east, up]))


def test_a_heading_that_the_first_velocities_got_wrong_is_found_anew(
    observer: Runner, lane_change: Recording, between
) -> None:
    course = follow(observer, altered(messages(lane_change), between(VELOCITY, 0.0, 0.5), elsewhere), lane_change)
    assert course.position[-1] < 2
    assert abs(observer.snapshot().attitude[2]) < 0.1
    assert_good(course)


def test_a_velocity_that_turns_away_from_the_positions_turns_no_heading(
    observer: Runner, lane_change: Recording, between
) -> None:
    course = follow(observer, altered(messages(lane_change), between(VELOCITY, 3, 10), elsewhere), lane_change)
    assert "ERROR" in course.levels("velocity", 8.5, 10)
    assert course.position[course.t > 1].max() < 3
    assert_good(course, 3.0)


def test_a_frozen_imu_is_named(observer: Runner, lane_change: Recording, between) -> None:
    last = next(s for s in messages(lane_change) if s.topic == IMU and seconds(lane_change, s) >= 4.0)
    frozen = altered(messages(lane_change), between(IMU, 4, 7), lambda s: replace(s, values=last.values))
    course = follow(observer, frozen, lane_change)
    assert course.levels("imu", 4.5, 6.9) == {"WARN"}
    assert "value frozen" in course.words("imu")
    assert course.levels("imu", 9.5, 12) == {"OK"}
    assert_good(course, 9.0)


# Clocks


def test_a_problem_from_before_the_clock_of_arrivals_was_set_back_is_an_old_one() -> None:
    health = Health(last_stamp=SECOND, last_received=7200 * SECOND)
    health.complain("value frozen")
    assert health.diagnostic("imu", Imu(), 7200 * SECOND).level == Level.WARN
    health.last_received = SECOND
    assert health.diagnostic("imu", Imu(), SECOND).level == Level.OK


@pytest.mark.parametrize("jump", exam_except([-3600.0, -10.0, -1.0, 1.0, 10.0, 3600.0], -1.0))
@pytest.mark.parametrize("topic", exam_except(SENSORS.values(), IMU))
def test_one_stray_stamp_is_refused_and_nothing_else(
    topic: str, jump: float, observer: Runner, clean: Runner, lane_change: Recording
) -> None:
    stream = messages(lane_change)
    index = next(i for i, s in enumerate(stream) if s.topic == topic and seconds(lane_change, s) > 5)
    stream[index] = replace(stream[index], stamp=stream[index].stamp + int(jump * SECOND))
    course = follow(observer, stream, lane_change)
    # A second ago there was a message with this very stamp: it cannot be told from one that is repeated.
    expected = ("ahead of all others",) if jump > 0 else ("history is", "stamp repeated")
    assert any(words in course.words(NAMES[topic]) for words in expected)
    for name, health, untouched in zip(observer.names, observer.health, clean.health, strict=True):
        lost = untouched.used + untouched.refused - health.used - health.refused
        assert lost == (name == NAMES[topic]), name
    assert observer.diagnostics()[0].values == {"faults": "0", "restarts": "0"}
    assert_good(course)


@pytest.mark.parametrize("jump", exam_except([-3600.0, 3600.0], 3600.0))
@pytest.mark.parametrize("topic", exam_except(SENSORS.values(), VELOCITY))
def test_a_clock_that_went_elsewhere_for_good_loses_its_sensor_alone(
    topic: str, jump: float, observer: Runner, lane_change: Recording, between
) -> None:
    astray = between(topic, 5, 100)
    stream = altered(messages(lane_change), astray, lambda s: replace(s, stamp=s.stamp + int(jump * SECOND)))
    course = follow(observer, stream, lane_change)
    assert course.levels(NAMES[topic], 6, 12) == {"WARN"}
    assert observer.diagnostics()[0].values["restarts"] == "0"
    assert all(np.isfinite(course.largest(5.0)))


@pytest.mark.parametrize("jump", exam_except([-3600.0, 3600.0], -3600.0))
def test_when_all_clocks_jump_the_observer_follows(
    jump: float, observer: Runner, clean: Runner, lane_change: Recording
) -> None:
    stream = messages(lane_change)
    moved = altered(
        stream,
        lambda s: (s.received or 0) >= lane_change.start + 4 * SECOND,
        lambda s: replace(s, stamp=s.stamp + int(jump * SECOND)),
    )
    feed(observer, moved)
    assert observer.diagnostics()[0].values["restarts"] == "1"
    assert observer.converged
    velocity, rates, _, _ = distance(observer, clean)
    assert velocity < 0.2
    assert rates < 0.05


def test_repeated_messages_count_once(observer: Runner, clean: Runner, lane_change: Recording) -> None:
    feed(observer, (s for s in messages(lane_change) for _ in range(2)))
    assert "repeated" in observer.health[0].problem
    assert [h.used for h in observer.health] == [h.used for h in clean.health]
    assert max(distance(observer, clean)) < 1e-12


def test_messages_that_do_not_say_when_they_arrived_are_used(observer: Runner, lane_change: Recording) -> None:
    """One that is an hour off is as if it had not come: the estimate is that without it, bit by bit."""
    stream = [replace(s, received=None) for s in messages(lane_change)]
    stray = next(i for i, s in enumerate(stream) if s.topic == IMU and seconds(lane_change, s) > 5)
    without = Runner(observer.vehicle, lane_change.map_origin)
    feed(without, [*stream[:stray], *stream[stray + 1 :]])
    stream[stray] = replace(stream[stray], stamp=stream[stray].stamp + 3600 * SECOND)
    feed(observer, stream)
    assert observer.diagnostics()[0].values["restarts"] == "0"
    assert max(distance(observer, without)) == 0.0


# Form


def test_a_wrong_frame_is_named(observer: Runner, lane_change: Recording) -> None:
    stream = altered(messages(lane_change), lambda s: s.topic == IMU, lambda s: replace(s, frame_id="base_link"))
    follow(observer, stream, lane_change)
    imu = next(d for d in observer.diagnostics() if d.name == "imu")
    assert imu.level.name == "STALE"
    assert "frame_id 'base_link', expected 'imu_link'" in imu.message


def test_a_wrong_message_type_is_named(observer: Runner, lane_change: Recording) -> None:
    feed(
        observer,
        altered(messages(lane_change), lambda s: s.topic == WHEELS, lambda s: replace(s, kind="std_msgs/msg/Bool")),
    )
    wheels = next(d for d in observer.diagnostics() if d.name == "wheel_speeds")
    assert "message type std_msgs/msg/Bool, expected sensor_msgs/msg/JointState" in wheels.message


def test_a_message_without_its_fields_is_refused(observer: Runner, lane_change: Recording, between) -> None:
    stream = messages(lane_change)
    for topic in SENSORS.values():
        stream = altered(stream, between(topic, 5, 5.2), lambda s: replace(s, values={}))
    follow(observer, stream, lane_change)
    assert all(health.invalid > 0 for health in observer.health)
    assert all(d.level.name == "OK" for d in observer.diagnostics())


def test_joints_of_other_names_are_refused(observer: Runner, lane_change: Recording, between) -> None:
    stream = messages(lane_change)
    for topic in (WHEELS, STEERING):
        stream = altered(stream, between(topic, 5, 5.2), lambda s: replace(s, names=("door",) * len(s.names)))
    course = follow(observer, stream, lane_change)
    for name in ("wheel_speeds", "steering"):
        assert "no usable number" in course.words(name)
    assert_good(course)


@pytest.mark.parametrize("away", exam_except([-7.0, 7.0, 3600.0], -7.0, 3600.0))
@pytest.mark.parametrize("topic", exam_except([IMU, WHEELS, STEERING, FIX], IMU, FIX))
def test_a_wrong_stamp_before_the_start_does_not_change_the_start(
    topic: str, away: float, vehicle: Vehicle, lane_change: Recording
) -> None:
    """It starts when the first velocity comes."""
    good = messages(lane_change, 0.5)
    undisturbed, observer = (Runner(vehicle, lane_change.map_origin) for _ in range(2))
    feed(undisturbed, good)
    velocity = next(i for i, s in enumerate(good) if s.topic == VELOCITY)
    last = max(i for i, s in enumerate(good[:velocity]) if s.topic == topic)
    feed(observer, [*good[: last + 1], corrupted(good[last], "stamp", away), *good[last + 1 :]])
    assert distance(undisturbed, observer) == (0, 0, 0, 0)


def telling(field: str, value: float) -> Callable[[Sample], Sample]:
    """A field with the same value throughout."""
    return lambda s: changed(s, **{field: np.full_like(s.values[field], value)})


@pytest.mark.parametrize(
    ("topic", "field", "value"),
    exam_except(
        [
            (WHEELS, "velocity", 1e3),
            (WHEELS, "velocity", 1e6),
            (IMU, "angular_velocity", 1e3),
            (VELOCITY, "linear", 1e3),
        ],
        (WHEELS, "velocity", 1e6),
    ),
)
def test_first_messages_that_no_car_could_send_are_refused(
    topic: str, field: str, value: float, observer: Runner, lane_change: Recording, between
) -> None:
    told = altered(messages(lane_change), between(topic, 0.0, 0.2), telling(field, value))
    course = follow(observer, told, lane_change)
    assert observer.diagnostics()[0].values == {"faults": "0", "restarts": "0"}
    assert course.levels(NAMES[topic], 0.1, 0.3) & {"WARN"}
    assert max(course.largest(2.0)[:2]) < 0.3
    assert_good(course, 3.0)


@pytest.mark.parametrize(
    ("topic", "field", "value"),
    exam_except([(WHEELS, "velocity", 300.0), (VELOCITY, "linear", -30.0)], (VELOCITY, "linear", -30.0)),
)
def test_it_does_not_start_while_wheels_and_gnss_contradict_each_other(
    topic: str, field: str, value: float, observer: Runner, lane_change: Recording, between
) -> None:
    told = altered(messages(lane_change), between(topic, 0.0, 0.2), telling(field, value))
    course = follow(observer, told, lane_change)
    assert 0.15 < course.t[0] < 0.5
    assert course.speed[0] == pytest.approx(0.0, abs=0.5)
    assert_good(course, 3.0)


def test_a_filter_that_never_was_sane_starts_anew(observer: Runner, lane_change: Recording) -> None:
    stream = messages(lane_change)
    started = next(i for i, s in enumerate(stream) if feed(observer, [s]).started)
    observer.filter.car.mean[14] = 300.0
    assert observer.estimate() == []
    assert not observer.started
    course = follow(observer, stream[started + 1 :], lane_change)
    assert observer.diagnostics()[0].values == {"faults": "1", "restarts": "1"}
    assert_good(course, 3.0)


# All of it at once

CORRUPTION = st.one_of(
    st.tuples(st.just("value"), st.sampled_from([NAN, INFINITE, -INFINITE, HUGE, -HUGE, 1e12])),
    st.tuples(st.just("stamp"), st.floats(-1e5, -0.6) | st.floats(0.6, 1e5)),
    st.tuples(st.just("frame"), st.just(0.0)),
    st.tuples(st.just("empty"), st.just(0.0)),
    st.tuples(st.just("kind"), st.just(0.0)),
)


def corrupted(sample: Sample, how: str, amount: float) -> Sample:
    match how:
        case "value":
            return filled(sample, amount)
        case "stamp":
            return replace(sample, stamp=sample.stamp + int(amount * SECOND))
        case "frame":
            return replace(sample, frame_id="elsewhere")
        case "empty":
            return replace(sample, values={})
        case _:
            return replace(sample, kind="std_msgs/msg/String")


MIXED_IN = st.lists(st.tuples(st.integers(0, 1800), CORRUPTION), max_size=120)


@pytest.mark.exam
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mixed_in=MIXED_IN)
def test_rubbish_between_good_messages_changes_next_to_nothing(
    mixed_in: list[tuple[int, tuple[str, float]]], vehicle: Vehicle, lane_change: Recording
) -> None:
    _changes_next_to_nothing(mixed_in, vehicle, lane_change)


@pytest.mark.exam
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mixed_in=MIXED_IN)
def test_any_rubbish_between_good_messages_changes_next_to_nothing(
    mixed_in: list[tuple[int, tuple[str, float]]], vehicle: Vehicle, lane_change: Recording
) -> None:
    _changes_next_to_nothing(mixed_in, vehicle, lane_change)


def _changes_next_to_nothing(
    mixed_in: list[tuple[int, tuple[str, float]]], vehicle: Vehicle, lane_change: Recording
) -> None:
    """Frames are no rubbish where a sensor accepts any: then the message is a repeated one."""
    good = messages(lane_change, 4.0)
    stream = []
    by_index: dict[int, list[tuple[str, float]]] = {}
    for index, corruption in mixed_in:
        by_index.setdefault(index, []).append(corruption)
    for i, sample in enumerate(good):
        stream.append(sample)
        stream += [corrupted(sample, *c) for c in by_index.get(i, ())]
    undisturbed, observer = (Runner(vehicle, lane_change.map_origin) for _ in range(2))
    feed(undisturbed, good)
    feed(observer, stream)
    assert observer.diagnostics()[0].values["faults"] == "0"
    assert [h.used for h in observer.health] == pytest.approx([h.used for h in undisturbed.health], abs=60)
    velocity, rates, attitude, position = distance(undisturbed, observer)
    assert velocity < 0.05
    assert rates < 0.01
    assert attitude < 0.005
    assert position < 0.3


@pytest.mark.parametrize(
    ("sensor", "stated", "said"),
    [
        (FIX, 1e6, "its measurements hardly count"),
        (FIX, (1 / 111e3) ** 2, "is none that such a sensor has"),
        (IMU, np.degrees(0.05) ** 2, "its measurements hardly count"),
        (FIX, 0.0, ""),
        (FIX, 1.0, ""),
    ],
)
def test_a_noise_that_is_stated_in_another_unit_is_said_and_an_unknown_one_is_not(
    sensor: str, stated: float, said: str, observer: Runner, lane_change: Recording
) -> None:
    def with_covariance(s: Sample) -> Sample:
        return changed(s, **{f: stated * np.eye(3).ravel() for f in s.values if f.endswith("_covariance")})

    for sample in islice(altered(messages(lane_change), lambda s: s.topic == sensor, with_covariance), 300):
        observer.add(sample)
    name = next(name for name, one in observer.sensors.items() if one.topic == sensor)
    (line,) = (one.message for one in observer.diagnostics() if one.name == name)
    assert said in line
    assert ("standard deviation" in line) == bool(said)
