"""What the observer does with messages that are good, whenever they come and whichever there are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from drives import (
    FIX,
    IMU,
    SECOND,
    SENSORS,
    STEERING,
    VELOCITY,
    WHEELS,
    changed,
    distance,
    feed,
    follow,
    messages,
    seconds,
    without_c,
)
from marks import exam_except
from vsense_ros.errors import InputError
from vsense_ros.manoeuvre import MANOEUVRES, drive, generate
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.messages.topics import WHEELS as WHEEL_NAMES
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.sensors import GnssAttitude
from vsense_ros.model.simulation.closed_loop import simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, run


def settings(vehicle: Vehicle, **changes: object) -> Vehicle:
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update=changes)})


def observer_of(vehicle: Vehicle, recording: Recording) -> Runner:
    return Runner(vehicle, recording.map_origin)


# Order of arrival


def without_ties(samples: Iterable[Sample]) -> list[Sample]:
    """Messages that arrive when they are stamped, steering between the measurements.

    An input that has the stamp of a measurement holds from there on if it comes after it, and for the step that leads
    there if it comes before.
    """
    shift = {STEERING: 300_000, VELOCITY: 500_000, FIX: 600_000}
    moved = (replace(s, stamp=s.stamp + shift.get(s.topic, 0)) for s in samples)
    return sorted((replace(s, received=s.stamp) for s in moved), key=lambda s: s.stamp)


def shuffled(samples: list[Sample], seed: int, longest: float, start: float = 1.0) -> list[Sample]:
    """Every message delayed by up to `longest` [s], but none in the first seconds, so that both start alike."""
    random = np.random.default_rng(seed)
    first = samples[0].received or 0

    def arrival(s: Sample) -> int:
        assert s.received is not None
        late = s.received > first + start * SECOND
        return s.received + int(late * random.uniform(0, longest) * SECOND)

    return sorted((replace(s, received=arrival(s)) for s in samples), key=lambda s: s.received or 0)


@pytest.mark.parametrize("seed", exam_except(range(3), 1))
def test_messages_in_any_order_give_the_same_state(seed: int, vehicle: Vehicle, lane_change: Recording) -> None:
    """Without a merge window the filter passes through the same instants whatever the order, so nothing differs."""
    exact = settings(vehicle, merge_window=0.0)
    stream = without_ties(messages(lane_change, 6.0))
    ordered = feed(observer_of(exact, lane_change), stream)
    other = feed(observer_of(exact, lane_change), shuffled(stream, seed, 0.3))
    differences = distance(ordered, other)
    assert other.stamp == ordered.stamp
    assert sum(h.late for h in other.health) > 1000
    assert sum(h.too_late + h.invalid for h in other.health) == 0
    assert [h.used for h in other.health] == [h.used for h in ordered.health]
    assert max(differences) < 1e-9
    np.testing.assert_allclose(other.filter.covariance, ordered.filter.covariance, rtol=1e-9, atol=1e-12)


def test_merged_measurements_in_any_order_give_nearly_the_same_state(vehicle: Vehicle, lane_change: Recording) -> None:
    """Which measurements share an instant depends on their order: a car that brakes or turns hard changes its speed by
    0.02 m/s, its yaw rate by 0.01 rad/s within the window of 2 ms."""
    stream = messages(lane_change, 6.0)
    ordered = feed(observer_of(vehicle, lane_change), stream)
    other = feed(observer_of(vehicle, lane_change), shuffled(stream, 0, 0.3))
    velocity, rates, attitude, position = distance(ordered, other)
    assert velocity < 0.02
    assert rates < 0.01
    assert attitude < 0.002
    assert position < 0.02


@pytest.mark.parametrize("parameter_filter", exam_except(["none", "ekf", "ukf"], "none", "ukf"))
@pytest.mark.parametrize("way", exam_except(["compiled", "without compiled step"], "compiled"))
def test_gnss_that_comes_200_ms_late_gives_the_same_state(
    parameter_filter: str, way: str, vehicle: Vehicle, lane_change: Recording
) -> None:
    """With and without parameters that are estimated, and with what is done again in one call of C or not."""
    stream = messages(lane_change, 4.0)
    in_time = without_ties(stream)
    begin = in_time[0].stamp + SECOND  # both start alike
    late = [
        replace(s, received=s.stamp + SECOND // 5 * (s.topic in (FIX, VELOCITY) and s.stamp > begin)) for s in in_time
    ]
    late.sort(key=lambda s: s.received or 0)
    exact = settings(vehicle, merge_window=0.0)
    if parameter_filter != "none":
        parameters = {
            "chassis.mass": EstimatedParameter(deviation=100.0, drift=1.0),
            "road.friction": EstimatedParameter(deviation=0.2, drift=0.01, lower=0.1),
        }
        exact = settings(exact, parameters=parameters, parameter_filter=parameter_filter)
    ordered, other = (observer_of(exact, lane_change) for _ in range(2))
    if way != "compiled":
        without_c(other.filter)
    for observer, arriving in ((ordered, in_time), (other, late)):
        feed(observer, arriving)
    assert other.health[other.names.index("velocity")].late > 20
    assert max(distance(ordered, other)) < 1e-9
    np.testing.assert_allclose(other.snapshot().state, ordered.snapshot().state, rtol=1e-8, atol=1e-8)


def test_what_is_refused_among_what_is_done_again_is_treated_as_it_was(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    """Every fifth fix is 30 m off, wheel speeds are wrong for longer than the observer's patience, all GNSS is late:
    what happens again in one call of C is what happens again one by one."""

    def spoilt(sample: Sample) -> Sample:
        if sample.topic == FIX and sample.stamp // (SECOND // 10) % 5 == 0:
            return changed(sample, latitude=sample.values["latitude"] + 3e-4)
        if sample.topic == WHEELS and 2.0 < seconds(lane_change, sample) < 3.0:
            return changed(sample, velocity=sample.values["velocity"] + 8.0)
        return sample

    stream = [spoilt(s) for s in messages(lane_change, 5.0)]
    made = [observer_of(vehicle, lane_change) for _ in range(2)]
    without_c(made[1].filter)
    in_c, in_python = (feed(observer, stream) for observer in made)
    assert max(distance(in_c, in_python)) < 1e-9
    assert [vars(h) for h in in_c.health] == [
        {**vars(h), "innovation_ratio": pytest.approx(h.innovation_ratio), "problem": ours.problem}
        for h, ours in zip(in_python.health, in_c.health, strict=True)
    ]
    refused = {name: health.refused for name, health in zip(in_c.names, in_c.health, strict=True)}
    assert refused["position"] > 5
    assert refused["wheel_speeds"] > 50


def test_looking_at_the_estimate_does_not_change_it(vehicle: Vehicle, lane_change: Recording) -> None:
    stream = messages(lane_change, 4.0)
    unseen = feed(observer_of(vehicle, lane_change), stream)
    seen = observer_of(vehicle, lane_change)
    for sample in stream:
        seen.add(sample)
        seen.snapshot()
        seen.diagnostics()
    assert max(distance(unseen, seen)) < 1e-9


@pytest.mark.exam
@pytest.mark.parametrize("way", ["open road", "tunnel"])
def test_the_covariance_stays_symmetric_and_positive_for_ten_minutes(
    vehicle: Vehicle, lane_change: Recording, way: str
) -> None:
    """One drive over and over: GNSS moved on with the car, or none after the first time.

    Smallest eigenvalues of the correlation matrix, which does not depend on units, are looked at after each drive. In
    a tunnel nothing measures the place and the heading: the error of the gyro's bias, times time, is that of the
    heading, which is that of the place, and their correlation goes to one. So they are held against this instead.
    Nothing ever measures the angle about its axle that a wheel has turned since the start: its error is that of the
    wheel's radius, times the way. So the trend is that of all others.
    """
    observer = observer_of(vehicle, lane_change)
    stream = messages(lane_change, 12.0)
    truth = lane_change["reference/odometry"]
    length = np.interp(12.0, (truth.stamp - truth.stamp[0]) / SECOND, truth.columns["position"][:, 0])

    def later(sample: Sample, lap: int) -> Sample:
        shift, values = lap * 12 * SECOND, dict(sample.values)
        if sample.topic == FIX:
            degree = 111_319.49 * np.cos(np.radians(values["latitude"]))  # [m] of longitude
            values["longitude"] = values["longitude"] + lap * length / degree
        return replace(sample, stamp=sample.stamp + shift, received=(sample.received or 0) + shift, values=values)

    names = observer.filter.car.layout.names
    integrals = {f"spin_{wheel}" for wheel in WHEEL_NAMES} | ({"x", "y", "yaw"} if way == "tunnel" else set())
    measured = [i for i, name in enumerate(names) if name not in integrals]
    smallest = []
    for lap in range(50):
        kept = [s for s in stream if lap == 0 or way == "open road" or s.topic in (IMU, WHEELS, STEERING)]
        feed(observer, (later(s, lap) for s in kept))
        observer.snapshot()
        p = observer.filter.covariance
        assert np.array_equal(p, p.T)
        deviation = np.sqrt(np.diag(p))
        correlation = p / deviation / deviation[:, None]
        assert np.linalg.eigvalsh(correlation)[0] > 1e-6
        smallest.append(np.linalg.eigvalsh(correlation[np.ix_(measured, measured)])[0])
    assert smallest[-1] > 0.9 * smallest[0], "no trend"
    if way == "tunnel":
        bias, yaw = names.index("imu.gyro_bias_z"), names.index("yaw")
        assert deviation[yaw] == pytest.approx(deviation[bias] * 49 * 12.0, rel=0.05)
        assert correlation[bias, yaw] < -0.99
    refused = {name: health.refused for name, health in zip(observer.names, observer.health, strict=True)}
    assert sum(refused.values()) == 0, refused


# Start, standstill, convergence


@pytest.fixture(scope="module")
def standing(plant: Vehicle) -> Recording:
    return at_rest(plant, 12.0)


def at_rest(plant: Vehicle, seconds: float) -> Recording:
    """A car that stands for so long [s]."""
    return record(simulate(plant, lambda t, q, u: np.zeros(5), seconds), plant, seed=3, name="standing")


@pytest.mark.exam
def test_standing_still_for_a_minute_nothing_drifts(vehicle: Vehicle, plant: Vehicle) -> None:
    standing = at_rest(plant, 60.0)
    observer = observer_of(vehicle, standing)
    course = follow(observer, messages(standing), standing)
    speed, lateral, yaw_rate = course.largest(5.0)
    assert speed < 0.05
    assert lateral < 0.05
    assert yaw_rate < 0.01
    assert abs(observer.snapshot().attitude[2]) < 0.05
    assert observer.diagnostics()[0].message == "heading unknown until the car moves"
    assert not observer.converged


def with_antennas(samples: list[Sample], yaw: float) -> list[Sample]:
    """The stream with a heading [rad] as often as a fix."""
    orientation = {"orientation": np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])}
    headings = [
        Sample(GnssAttitude().topic, GnssAttitude().message, s.stamp, orientation, received=s.received)
        for s in samples
        if s.topic == FIX
    ]
    return sorted([*samples, *headings], key=lambda s: s.received or 0)


def without(vehicle: Vehicle, *names: str) -> Vehicle:
    return vehicle.model_copy(update={"sensors": {n: s for n, s in vehicle.sensors.items() if n not in names}})


def test_a_car_without_wheel_speeds_knows_that_it_stands_before_it_knows_its_heading(
    vehicle: Vehicle, standing: Recording
) -> None:
    """A GNSS velocity of nothing is that in whatever direction the car stands."""
    observer = feed(Runner(without(vehicle, "wheel_speeds"), standing.map_origin), messages(standing, 12.0))
    assert observer.diagnostics()[0].message == "heading unknown until the car moves"
    estimate = observer.snapshot()
    speed, deviation = estimate.velocity[0], estimate.twist_covariance[0, 0] ** 0.5
    assert abs(speed) < 0.1
    assert deviation < 0.15
    radius = dict(zip(estimate.parameter_names, estimate.parameter_deviations, strict=True))["radius_error"]
    assert radius < 1e-5  # no sensor sees a wheel turn: its radius is that of the file


def test_a_car_that_stands_does_not_roll_away_while_its_wheel_speeds_are_awaited(vehicle: Vehicle) -> None:
    standing = at_rest(vehicle, 30.0)
    heard = [sample for sample in messages(standing) if sample.topic != WHEELS]
    estimate = feed(Runner(vehicle, standing.map_origin), heard).snapshot()
    assert abs(estimate.velocity[0]) < 0.1
    assert estimate.twist_covariance[0, 0] ** 0.5 < 0.15


@pytest.mark.parametrize(
    "missing",
    [
        pytest.param((), marks=pytest.mark.exam),
        pytest.param(("velocity",), marks=pytest.mark.exam),
        ("velocity", "position"),
    ],
)
def test_two_antennas_tell_the_heading_of_a_standing_car(
    missing: tuple[str, ...], vehicle: Vehicle, standing: Recording
) -> None:
    """The base line points to the left of the car, and west: the car points north."""
    kept = without(vehicle, *missing)
    across = kept.model_copy(update={"sensors": {**kept.sensors, "attitude": GnssAttitude(yaw=np.pi / 2)}})
    assert not feed(observer_of(across, standing), messages(standing, 2.0)).converged
    observer = observer_of(across, standing)
    course = follow(observer, with_antennas(messages(standing, 10.0), np.pi), standing)
    assert observer.converged
    assert observer.snapshot().attitude[2] == pytest.approx(np.pi / 2, abs=0.02)
    assert course.levels("attitude", 3.0, 10.0) == {"OK"}
    assert [h.refused for h in observer.health] == [0] * len(observer.health)


def test_it_starts_from_rest_and_finds_its_heading_when_the_car_moves(plant: Vehicle, vehicle: Vehicle) -> None:
    def driver(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = 150.0 if t > 2 else 0.0
        return np.array([0.02 * (t > 6), 0.0, 0.0, torque, torque])

    recording = record(simulate(plant, driver, 12.0), plant, seed=4, name="from rest")
    observer = observer_of(vehicle, recording)
    course = follow(observer, messages(recording), recording)
    assert observer.heading_known
    assert observer.converged
    speed, lateral, yaw_rate = course.largest(8.0)
    assert speed < 0.3
    assert lateral < 0.3
    assert yaw_rate < 0.05


@pytest.fixture(scope="module")
def backwards(plant: Vehicle) -> Recording:
    """From rest 2 s later 4 s into reverse, then forwards; the car points east throughout."""

    def driver(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = 0.0 if t < 2 else -100.0 if t < 6 else 150.0
        return np.array([0.0, 0.0, 0.0, torque, torque])

    return record(simulate(plant, driver, 20.0), plant, seed=7, name="backwards")


def test_a_drive_that_begins_in_reverse_finds_where_the_car_points(vehicle: Vehicle, backwards: Recording) -> None:
    observer = observer_of(vehicle, backwards)
    course = follow(observer, messages(backwards), backwards)
    assert np.cos(observer.snapshot().attitude[2]) > 0.99
    assert course.position[course.t > 6].max() < 2
    assert max(course.largest(6.0)[:2]) < 0.3
    assert observer.health[observer.names.index("velocity")].refused < 3


def test_a_heading_that_wheels_without_a_sign_got_wrong_in_reverse_is_found_anew(
    vehicle: Vehicle, backwards: Recording
) -> None:
    stream = [
        changed(s, velocity=np.abs(s.values["velocity"])) if s.topic == WHEELS else s for s in messages(backwards)
    ]
    observer = observer_of(vehicle, backwards)
    course = follow(observer, stream, backwards)
    assert np.cos(observer.snapshot().attitude[2]) > 0.99
    assert course.position[-1] < 2


def test_in_reverse_inertial_sensors_and_steering_tell_the_direction_that_wheels_without_a_sign_do_not(
    vehicle: Vehicle, backwards: Recording
) -> None:
    """From 2 s after the car has begun to move, and still while it goes backwards."""
    stream = [
        changed(s, velocity=np.abs(s.values["velocity"])) if s.topic == WHEELS else s for s in messages(backwards)
    ]
    observer = observer_of(vehicle, backwards)
    seen = []
    for sample in stream:
        observer.add(sample)
        seconds = (observer.stamp - backwards.start) * 1e-9
        if observer.started and 4.5 < seconds < 6.0:
            estimate = observer.snapshot()
            seen.append((float(np.cos(estimate.attitude[2])), float(estimate.velocity[0])))
    heading, speed = np.array(seen).T
    assert heading.min() > 0.98
    assert speed.max() < 0.0


def turned(recording: Recording, angle: float) -> list[Sample]:
    """What the sensors would send on a map whose east lies in another direction."""
    latitude, longitude, _ = recording.map_origin or (0.0, 0.0, 0.0)
    metres = 111_000.0 * np.array([np.cos(np.radians(latitude)), 1.0])  # of a degree to the east and north
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def on_that_map(sample: Sample) -> Sample:
        if sample.topic == VELOCITY:
            return changed(sample, linear=np.append(turn @ sample.values["linear"][:2], 0.0))
        if sample.topic == FIX:
            degrees = np.array([sample.values[k][0] for k in ("longitude", "latitude")]) - (longitude, latitude)
            degrees = turn @ (degrees * metres) / metres
            return changed(sample, longitude=longitude + degrees[:1], latitude=latitude + degrees[1:])
        return sample

    return [on_that_map(s) for s in messages(recording)]


@pytest.mark.parametrize("why", exam_except(["not in the vehicle file", "silent"], "silent"))
@pytest.mark.parametrize(
    ("drive", "angle"),
    exam_except(
        [("lane_change", 1.5), ("lane_change", -2.8), ("backwards", 2.0)], ("lane_change", -2.8), ("backwards", 2.0)
    ),
)
def test_without_velocities_the_way_between_positions_tells_the_heading(
    drive: str, angle: float, why: str, vehicle: Vehicle, request: pytest.FixtureRequest
) -> None:
    """Begun at 70 km/h, or in reverse from rest."""
    recording: Recording = request.getfixturevalue(drive)
    known = vehicle if why == "silent" else without(vehicle, "velocity")
    observer = feed(observer_of(known, recording), [s for s in turned(recording, angle) if s.topic != VELOCITY])
    truth, found = recording["reference/odometry"], observer.snapshot()
    east, north = (np.interp(observer.stamp, truth.stamp, truth.columns["position"][:, i]) for i in (0, 1))
    place = complex(east, north) * np.exp(1j * angle)
    assert abs(complex(*found.position[:2]) - place) < 2.0
    assert np.sin(found.attitude[2] - angle) == pytest.approx(0.0, abs=0.05)
    assert np.cos(found.attitude[2] - angle) > 0
    assert observer.converged
    assert observer.health[observer.names.index("position")].refused == 0


def test_without_gnss_the_map_is_laid_by_the_start(vehicle: Vehicle, lane_change: Recording) -> None:
    blind = without(vehicle, "velocity", "position")
    observer = observer_of(blind, lane_change)
    course = follow(observer, messages(lane_change, 4.0), lane_change)
    assert observer.converged
    assert course.position.max() < 3


@pytest.mark.parametrize(("angle", "seed"), exam_except([(0.0, 4), (2.0, 5), (-1.2, 6)], (2.0, 5)))
def test_the_positions_of_a_standing_car_count_together(
    angle: float, seed: int, plant: Vehicle, vehicle: Vehicle
) -> None:
    """A hundred fixes of 1.35 m at rest; then the way to where the heading is found, which is 0.3 m in front of the
    antenna, in whatever direction of the map the car stands."""

    def driver(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = 150.0 if t > 10 else 0.0
        return np.array([0.0, 0.0, 0.0, torque, torque])

    recording = record(simulate(plant, driver, 13.0), plant, seed=seed, name="from rest")
    observer = observer_of(vehicle, recording)
    assert observer.heading_known is False
    for sample in turned(recording, angle):
        observer.add(sample)
        if observer.snapshot().stamp and observer.heading_known:
            break
    truth = recording["reference/odometry"]
    along = np.interp(observer.stamp, truth.stamp, truth.columns["position"][:, 0])
    found = observer.snapshot()
    assert 10 < seconds(recording, sample) < 13
    assert np.hypot(*(found.position[:2] - along * np.array([np.cos(angle), np.sin(angle)]))) < 0.5
    assert np.sqrt(found.pose_covariance.diagonal()[:2].max()) < 0.5
    assert np.sin(found.attitude[2] - angle) == pytest.approx(0.0, abs=0.15)


def test_it_starts_in_motion_and_says_when_it_has_converged(vehicle: Vehicle, lane_change: Recording) -> None:
    observer = observer_of(vehicle, lane_change)
    course = follow(observer, messages(lane_change, 4.0), lane_change)
    texts = [d["observer"].message for _, d in course.said]
    assert texts[0].startswith("waiting for")
    assert "converging" in texts
    assert texts[-1] == "converged"
    first = next(t for t, d in course.said if d["observer"].message == "converged")
    assert 1.0 < first < 3.0
    speed, lateral, yaw_rate = course.largest(first)
    assert (speed, lateral, yaw_rate) < (0.2, 0.3, 0.05)


def test_positions_alone_start_nothing_and_it_says_what_would(vehicle: Vehicle, lane_change: Recording) -> None:
    """They come for 8 s before anything else; a start at no speed would be wrong by 19 m/s."""
    observer = observer_of(vehicle, lane_change)
    stream = messages(lane_change)
    feed(observer, [s for s in stream if s.topic == FIX and seconds(lane_change, s) < 8])
    assert not observer.started
    said = observer.diagnostics()[0].message
    assert "nothing measures the speed" in said
    assert "wheel_speeds" in said
    course = follow(observer, [s for s in stream if seconds(lane_change, s) > 8], lane_change)
    assert max(course.largest(10.0)[:2]) < 0.3


# Loss


@pytest.fixture(scope="module")
def circle(plant: Vehicle) -> Recording:
    return generate("steady_state_circle", plant, seed=2)


@pytest.mark.parametrize("name", exam_except(SENSORS, "imu"))
def test_a_sensor_that_falls_silent_is_named_and_survived(name: str, vehicle: Vehicle, circle: Recording) -> None:
    recording = circle
    gone = (4.0, 8.0)
    observer = observer_of(vehicle, recording)
    stream = messages(recording, 13.0)
    lost = [s for s in stream if not (s.topic == SENSORS[name] and gone[0] <= seconds(recording, s) < gone[1])]
    course = follow(observer, lost, recording)
    whole = follow(observer_of(vehicle, recording), stream, recording)
    timeout = observer.sensors[name].timeout
    assert course.levels(name, gone[0] + timeout + 0.3, gone[1]) == {"STALE"}
    assert "STALE" not in course.levels(name, gone[1] + 0.3, 13.0)
    for other in set(SENSORS) - {name}:
        assert "STALE" not in course.levels(other, 2.0, 13.0)
    speed, lateral, yaw_rate = course.largest(3.0)
    assert speed < 1.0
    assert lateral < 1.0
    assert yaw_rate < 0.2
    for with_loss, without in zip(course.largest(11.0), whole.largest(11.0), strict=True):
        assert with_loss < without + 0.1
    assert course.position[-1] < whole.position[-1] + 2.0


@pytest.mark.parametrize("name", exam_except(SENSORS, "wheel_speeds"))
def test_it_works_without_any_one_sensor_from_the_start(name: str, vehicle: Vehicle, lane_change: Recording) -> None:
    observer = observer_of(vehicle, lane_change)
    course = follow(observer, (s for s in messages(lane_change) if s.topic != SENSORS[name]), lane_change)
    said = {d.name: d for d in observer.diagnostics()}
    assert said[name].level.name == "STALE"
    assert SENSORS[name] in said[name].message
    limits = {"velocity": (1.0, 2.0, 0.2), "steering": (1.0, 2.0, 0.2)}.get(name, (0.5, 0.7, 0.1))
    assert all(error < limit for error, limit in zip(course.largest(6.0), limits, strict=True)), course.largest(6.0)


def test_ten_seconds_without_gnss_are_bridged(vehicle: Vehicle, circle: Recording) -> None:
    recording = circle
    stream = messages(recording, 18.0)
    outage = [s for s in stream if not (s.topic in (FIX, VELOCITY) and 5 <= seconds(recording, s) < 15)]
    observer = observer_of(vehicle, recording)
    course = follow(observer, outage, recording)
    speed, lateral, yaw_rate = course.largest(4.0)
    assert speed < 0.5
    assert lateral < 0.5
    assert yaw_rate < 0.05
    assert {d["position"].level.name for t, d in course.said if 8 < t < 15} == {"STALE"}
    assert observer.converged
    assert course.position[-1] < 3


def test_a_pause_of_the_whole_recording_costs_no_more_than_the_pause(vehicle: Vehicle, lane_change: Recording) -> None:
    stream = [s for s in messages(lane_change) if not 4.0 <= seconds(lane_change, s) < 5.2]
    observer = observer_of(vehicle, lane_change)
    course = follow(observer, stream, lane_change)
    assert sum(h.invalid for h in observer.health) == 0
    assert observer.diagnostics()[0].values["restarts"] == "0"
    assert course.largest(8.0) < (0.3, 0.4, 0.05)


def test_after_a_long_pause_it_starts_anew(vehicle: Vehicle, lane_change: Recording) -> None:
    stream = messages(lane_change)
    later = [replace(s, stamp=s.stamp + 60 * SECOND, received=(s.received or 0) + 60 * SECOND) for s in stream]
    observer = feed(observer_of(vehicle, lane_change), stream)
    feed(observer, later)
    assert observer.diagnostics()[0].values["restarts"] == "1"
    assert observer.converged
    assert distance(observer, feed(observer_of(vehicle, lane_change), stream))[0] < 0.05


# Vehicles and recordings that tell too little


@pytest.mark.parametrize(
    ("kept", "missing"), [(("imu", "steering", "position"), "speed"), (("wheel_speeds", "position"), "turns")]
)
def test_a_vehicle_that_tells_too_little_is_refused(kept: tuple[str, ...], missing: str, vehicle: Vehicle) -> None:
    poor = vehicle.model_copy(update={"sensors": {n: vehicle.sensors[n] for n in kept}})
    with pytest.raises(InputError, match=missing):
        Runner(poor)


def test_an_empty_recording_is_refused_with_what_was_expected(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match="expected imu/data"):
        run(Recording({}, name="empty"), vehicle)


def test_a_recording_without_any_speed_is_refused(vehicle: Vehicle, lane_change: Recording) -> None:
    channels = {topic: lane_change[topic].select(slice(0, 100)) for topic in (IMU, STEERING)}
    with pytest.raises(InputError, match="never started"):
        run(Recording(channels, name="blind"), vehicle)


def test_a_run_gives_all_outputs_and_reports_progress(vehicle: Vehicle, lane_change: Recording) -> None:
    done: list[float] = []
    result = run(lane_change, vehicle, progress=done.append)
    assert done[-1] == 1.0
    assert done == sorted(done)
    assert result.realtime_factor > 0
    assert result.step_us_median > 0
    expected = {"odometry", "acceleration", "balance", "road", "sideslip", "parameters", "wheel_torques"}
    expected |= {
        f"wheel_{what}/{wheel}" for what in ("force", "force_deviation", "slip") for wheel in ("fl", "fr", "rl", "rr")
    }
    assert set(result.output.channels) == {f"vsense/{name}" for name in expected}
    rows = len(result.output["vsense/odometry"])
    assert {len(channel) for channel in result.output.channels.values()} == {rows}
    for channel in result.output.channels.values():
        assert np.all(np.diff(channel.stamp) > 0)
    absent = {
        (name.removeprefix("vsense/"), column, place)
        for name, channel in result.output.channels.items()
        for column, values in channel.columns.items()
        for place in np.flatnonzero(np.isnan(values.reshape(rows, -1)).any(axis=0)).tolist()
    }
    assert absent == {("odometry", "position", 2)}  # no sensor of this car measures a height
    assert np.isnan(result.output["vsense/odometry"].columns["position"][:, 2]).all()
    assert "the height of the road is absent" in " ".join(line.message for line in result.diagnostics)


def test_wheel_torques_that_no_sensor_tells_are_found(vehicle: Vehicle, plant: Vehicle) -> None:
    """What the observer's car, 17 % heavier than the one that drives, needs for the same deceleration."""
    manoeuvre, truth = MANOEUVRES["brake_in_turn"], drive("brake_in_turn", plant)
    recording = record(truth, plant, 1, name=manoeuvre.name, about="")
    torques = run(recording, vehicle).output["vsense/wheel_torques"]
    since = (torques.stamp - recording.start) / SECOND
    braked = (since > 6.5) & (since < 9)
    found = torques.columns["effort"][braked].mean(axis=0)
    expected = truth.inputs[(truth.t > 6.5) & (truth.t < 9), 1:5].mean(axis=0)
    heavier = vehicle.physics.chassis.mass / plant.physics.chassis.mass
    assert found.sum() == pytest.approx(heavier * expected.sum(), rel=0.15)
    assert found[:2].sum() < found[2:].sum() < 0  # the front brakes do more
    assert (
        abs(torques.columns["effort"][(since > 2) & (since < 5)].sum(axis=1)).max() < 250
    )  # a constant speed needs little
