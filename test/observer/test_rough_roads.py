"""Potholes, kerbs, jumps, lifts, ramps and wrong heights: what no model of a smooth road knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drives import IMU, altered, changed, follow, messages, seconds
from marks import exam_except
from studies.road import with_height
from vsense_ros.bag import read_bag
from vsense_ros.manoeuvre.driver import SpeedKeeper
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.track import Track, straight
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
BEGIN = 10.0  # [s] of what happens


@pytest.fixture(scope="module")
def hills() -> Recording:
    return read_bag(Path(__file__).parents[2] / "bags/hills")


def shaken(recording: Recording, shake: Callable[[float, Array, Array], None]) -> list[Sample]:
    """The messages, where `shake(time since BEGIN, rates, forces)` changes those of the inertial sensor in place."""

    def to(sample: Sample) -> Sample:
        rates, force = (sample.values[name].copy() for name in ("angular_velocity", "linear_acceleration"))
        shake(seconds(recording, sample) - BEGIN, rates, force)
        return changed(sample, angular_velocity=rates, linear_acceleration=force)

    return altered(messages(recording, BEGIN + 6.0), lambda sample: sample.topic == IMU, to)


def pothole(t: float, rates: Array, force: Array) -> None:
    if 0 < t < 0.06:
        down = 1 if t < 0.03 else -1
        force[2] -= 40.0 * down
        rates[1] += 2.0 * down


def kerb(t: float, rates: Array, force: Array) -> None:
    if 0 < t < 0.05:
        force[2] += 60.0
        force[0] -= 20.0
        rates[0] += 3.0


def jump(t: float, rates: Array, force: Array) -> None:
    """No wheel touches the ground for 0.4 s; then the car lands with three times its weight."""
    if 0 < t < 0.4:
        force[:] = 0.0
    elif 0.4 <= t < 0.5:
        force[2] += 20.0


@pytest.mark.parametrize(("shake", "velocity"), exam_except([(pothole, 0.1), (kerb, 0.1), (jump, 0.3)], (kerb, 0.1)))
def test_a_blow_is_refused_and_said_and_velocity_stays(
    shake: Callable[[float, Array, Array], None], velocity: float, vehicle: Vehicle, hills: Recording
) -> None:
    course = follow(Runner(vehicle, hills.map_origin), shaken(hills, shake), hills)
    speed, lateral, yaw_rate = course.largest(2.0)
    assert max(speed, lateral) < velocity
    assert yaw_rate < np.radians(2.0)
    assert "WARN" in course.levels("imu", BEGIN, BEGIN + 1.0)
    assert course.levels("imu", BEGIN + 3.0, BEGIN + 6.0) == {"OK"}
    assert course.levels("imu", 2.0, BEGIN) == {"OK"}


@pytest.mark.exam
@pytest.mark.parametrize("degrees", [5.0, -8.0])
def test_a_car_whose_floor_tilts_as_on_a_lift_or_a_ferry_stays_and_says_what_it_cannot_explain(
    degrees: float, vehicle: Vehicle, plant: Vehicle
) -> None:
    """A road does not turn under a car at rest: the observer does not take it for one, and its forces do not add up."""
    q, u = rolling_straight(plant)
    at_rest = record(
        simulate(plant, lambda t, q, u: np.zeros(5), BEGIN + 6.0, q=q, u=u), plant, 3, name="lift", biased=False
    )

    def tilt(t: float, rates: Array, force: Array) -> None:
        angle = np.radians(degrees) * float(np.clip((t + 5.0) / 10.0, 0.0, 1.0))
        rates[1] -= np.radians(degrees) / 10.0 * (0.0 < t + 5.0 < 10.0)
        force[:] = Rotation.from_euler("y", angle).apply(force)

    observer = Runner(vehicle, at_rest.map_origin)
    course = follow(observer, shaken(at_rest, tilt), at_rest)
    speed, lateral, yaw_rate = course.largest(2.0)
    assert max(speed, lateral) < 0.1
    assert yaw_rate < np.radians(0.5)
    assert course.levels("balance of forces", 0.0, BEGIN - 5.0) == {"OK"}
    assert "WARN" in course.levels("balance of forces", BEGIN, BEGIN + 6.0)
    assert "load" in course.words("balance of forces")


@pytest.fixture(scope="module")
def garage(plant: Vehicle) -> Recording:
    """A ramp of 20 % at walking pace."""
    slope = float(np.arctan(0.2))
    track = Track((straight(20.0), straight(30.0, grade=slope), straight(20.0)), blend=6.0)
    q, u = rolling_straight(plant, 3.0)
    feet = SpeedKeeper(plant, lambda t: 3.0)
    drive = simulate(plant, lambda t, q, u: np.append(0.0, feet(t, u)), 20.0, q=q, u=u, surface=RoadSurface(track))
    return record(drive, plant, 5, name="garage", biased=False)


@pytest.mark.exam
def test_a_garage_ramp_of_a_fifth_is_climbed(vehicle: Vehicle, garage: Recording) -> None:
    observer = Runner(vehicle, garage.map_origin)
    pitches: list[float] = []

    def looked_at(samples: Iterable[Sample]) -> Iterator[Sample]:
        for sample in samples:
            yield sample
            if observer.started and 9.0 < (observer.stamp - garage.start) * 1e-9 < 14.0:
                pitches.append(observer.snapshot().attitude[1])

    course = follow(observer, looked_at(messages(garage)), garage)
    assert max(course.largest(2.0)[:2]) < 0.3
    assert course.levels("wheel_speeds", 2.0, 20.0) == {"OK"}
    assert np.degrees(np.mean(pitches)) == pytest.approx(-np.degrees(np.arctan(0.2)), abs=3.0)


def test_a_wrong_height_is_refused_and_turns_no_road(vehicle: Vehicle, hills: Recording) -> None:
    def jumps(sample: Sample) -> Sample:
        later = seconds(hills, sample) > BEGIN
        return changed(sample, altitude=sample.values["altitude"] + 300.0 * later)

    samples = altered(messages(hills, BEGIN + 6.0), lambda s: s.topic == "gps/fix", jumps)
    course = follow(Runner(with_height(vehicle), hills.map_origin), samples, hills)
    assert max(course.largest(2.0)[:2]) < 0.2
    assert "WARN" in course.levels("height", BEGIN, BEGIN + 1.0)
    assert course.levels("position", BEGIN, BEGIN + 6.0) == {"OK"}


def pitch_error(vehicle: Vehicle, hills: Recording) -> float:
    """Root mean square from 6 s on [deg]."""
    observer, off = Runner(vehicle, hills.map_origin), []
    reference = hills["reference/odometry"]
    pitch = Rotation.from_quat(reference.columns["orientation"]).as_euler("ZYX")[:, 1]
    for sample in messages(hills):
        observer.add(sample)
        if observer.started and sample.topic == IMU and seconds(hills, sample) > 6.0:
            estimate = observer.snapshot()
            off.append(estimate.attitude[1] - np.interp(estimate.stamp, reference.stamp, pitch))
    return float(np.degrees(np.sqrt(np.mean(np.square(off)))))


@pytest.mark.exam
def test_the_vertical_velocity_of_a_receiver_tells_the_grade(vehicle: Vehicle, hills: Recording) -> None:
    found = pitch_error(with_height(vehicle), hills)
    assert found < 0.2
    assert found < 0.5 * pitch_error(vehicle, hills)


def test_a_vertical_velocity_that_lies_is_refused_and_turns_no_road(vehicle: Vehicle, hills: Recording) -> None:
    def rises(sample: Sample) -> Sample:
        later = seconds(hills, sample) > BEGIN
        return changed(sample, linear=sample.values["linear"] + [0.0, 0.0, 20.0 * later])

    samples = altered(messages(hills, BEGIN + 6.0), lambda s: s.topic == "gps/velocity", rises)
    course = follow(Runner(with_height(vehicle), hills.map_origin), samples, hills)
    assert max(course.largest(2.0)[:2]) < 0.2
    assert "WARN" in course.levels("vertical_velocity", BEGIN, BEGIN + 1.0)
    assert course.levels("velocity", BEGIN, BEGIN + 6.0) == {"OK"}
