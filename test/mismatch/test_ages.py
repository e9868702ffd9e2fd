"""Sensors that are late by more than a fit would find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, having, prototype, unheard
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.ages import ages
from vsense_ros.mismatch.beforehand import delays, with_sizes
from vsense_ros.mismatch.explain import explain_recordings
from vsense_ros.mismatch.windows import build_dataset


def later(recording: Recording, seconds: float, *topics: str) -> Recording:
    """With messages of some topics whose stamps are later."""
    channels = dict(recording.channels)
    for topic in topics:
        channels[topic] = replace(channels[topic], stamp=channels[topic].stamp + round(seconds * 1e9))
    return replace(recording, channels=channels)


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
    assert ages(build_dataset([late], prototype()), prototype()) == {field: pytest.approx(seconds, abs=0.15)}


def test_gyros_and_accelerometers_may_be_late_apart():
    imu = having(prototype(), sensor_delay={"accelerometer": 1.0})
    late = driven(imu, "sweep", duration=30.0)
    assert ages(build_dataset([late], prototype()), prototype()) == {"accelerometer": pytest.approx(1.0, abs=0.1)}


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
    assert ages(build_dataset([alone], prototype()), prototype()) == {}


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
    assert ages(build_dataset([late], prototype()), prototype()) == {"gyro": pytest.approx(0.25, abs=0.1)}
