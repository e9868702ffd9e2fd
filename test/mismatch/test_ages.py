"""Sensors that are late by more than a fit would find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, having, prototype, unheard
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.ages import Age, ages
from vsense_ros.mismatch.beforehand import delays, with_sizes
from vsense_ros.mismatch.explain import explain_recordings
from vsense_ros.mismatch.windows import build_dataset


def later(recording: Recording, seconds: float, *topics: str) -> Recording:
    """With messages of some topics whose stamps are later."""
    channels = dict(recording.channels)
    for topic in topics:
        channels[topic] = replace(channels[topic], stamp=channels[topic].stamp + round(seconds * 1e9))
    return replace(recording, channels=channels)


def seconds_late(*recordings: Recording) -> dict[str, float]:
    return {field: age.value for field, age in ages(build_dataset(recordings, prototype()), prototype()).items()}


def drive() -> Recording:
    return driven(prototype(), "sweep", duration=30.0)


@pytest.mark.parametrize(
    ("topics", "field"),
    [
        (("imu/data",), "imu"),
        (("vehicle/steering",), "steering"),
        (("gps/fix", "gps/velocity"), "gnss"),
    ],
)
@pytest.mark.parametrize("seconds", [0.7, 2.2])
def test_whoever_is_late_against_all_others_is_told_with_its_age(topics, field, seconds):
    """As well as is known how long a car takes to respond to its steering."""
    late = later(drive(), seconds, *topics)
    assert seconds_late(late) == {field: pytest.approx(seconds, abs=0.15)}


def test_gyros_and_accelerometers_may_be_late_apart():
    imu = having(prototype(), sensor_delay={"accelerometer": 1.0})
    late = driven(imu, "sweep", duration=30.0)
    assert seconds_late(late) == {"accelerometer": pytest.approx(1.0, abs=0.1)}


def test_a_car_whose_sensors_are_in_time_has_none_that_is_late():
    for manoeuvre in ("sweep", "slalom", "brake", "brake again"):
        dataset = build_dataset([driven(prototype(), manoeuvre, duration=20.0)], prototype())
        assert ages(dataset, prototype()) == {}


def test_of_two_that_contradict_each_other_nobody_is_called_late():
    late = later(unheard(drive(), "gps/fix", "gps/velocity", "vehicle/wheel_torques"), 1.0, "vehicle/steering")
    columns = {**late["imu/data"].columns}
    columns["linear_acceleration"] = np.full_like(columns["linear_acceleration"], np.nan)
    imu = replace(late["imu/data"], columns=columns)
    alone = replace(late, channels={**late.channels, "imu/data": imu})
    assert seconds_late(alone) == {}


def test_with_the_ages_in_the_file_nobody_is_late_any_more():
    late = later(drive(), 1.1, "imu/data")
    older = ages(build_dataset([late], prototype()), prototype())
    car = with_sizes(prototype(), delays(older))
    assert ages(build_dataset([late], car), car) == {}


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_an_inertial_sensor_that_is_late_by_a_second_is_named_with_its_age():
    """Late data used to be refused as a wrong unit."""
    recordings = [later(driven(prototype(), m, duration=20.0), 1.1, "imu/data") for m in ("sweep", "brake again")]
    found = explain_recordings(recordings, prototype())
    (named,) = found.answer.accepted
    assert (found.answer.verdict, named.id, named.sensor) == ("named", "sensor_delay", "imu")
    assert named.parameters[0].value == pytest.approx(1.1, abs=0.1)
    assert found.extended is not None
    assert found.extended.physics.effects.sensor_delay.imu == pytest.approx(1.1, abs=0.1)


def test_a_gyro_is_late_where_it_is_behind_the_course_by_more_than_a_front_can_lead():
    late = driven(having(prototype(), sensor_delay={"gyro": 0.25}), "sweep", duration=30.0)
    assert seconds_late(late) == {"gyro": pytest.approx(0.25, abs=0.1)}


def test_an_accelerometer_that_a_slow_filter_smooths_is_late_by_the_time_of_its_filter():
    """As on a racing car that records no other acceleration than a longitudinal one, 1.5 s late: gains of speed are all
    but as alike at the lags beside the best one."""
    brakes = driven(prototype(), "brake", duration=40.0)
    columns = {**brakes["imu/data"].columns}
    acceleration = columns["linear_acceleration"].copy()
    period = float(np.median(np.diff(brakes["imu/data"].stamp))) * 1e-9
    weights = np.concatenate([np.zeros(round(0.8 / period)), np.ones(round(1.4 / period))])
    acceleration[:, 0] = np.convolve(acceleration[:, 0], weights / weights.sum())[: len(acceleration)]
    acceleration[:, 1:] = np.nan
    smoothed = replace(brakes["imu/data"], columns=columns | {"linear_acceleration": acceleration})
    late = seconds_late(replace(brakes, channels={**brakes.channels, "imu/data": smoothed}))
    assert late == {"accelerometer": pytest.approx(1.5, abs=0.2)}


@pytest.mark.parametrize("ahead", [-1.0, 0.0, 1.5])
def test_how_late_a_gyro_is_is_as_uncertain_as_the_place_of_the_antenna(ahead):
    """An antenna further ahead turns its course earlier, by which the gyro seems later."""
    car = having(prototype(), sensor_delay={"gyro": 0.5}, gnss_lever_arm={"x": ahead})
    late = driven(car, "sweep", duration=30.0)
    (age,) = ages(build_dataset([late], prototype()), prototype()).values()
    assert isinstance(age, Age)
    assert abs(age.value - 0.5) < 2 * age.deviation
