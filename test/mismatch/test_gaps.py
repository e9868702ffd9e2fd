"""Recordings of which parts are missing: what is there is used, and a gap is no physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from hidden import driven, prototype, seconds, silent, without
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.data_quality import hindrance
from vsense_ros.mismatch.road import Road
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import build_dataset

LONG = 60.0  # [s] more than one window


@pytest.fixture(scope="module")
def long_drive() -> Recording:
    return driven(prototype(), "slalom", LONG)


@pytest.mark.parametrize(("begin", "end"), [(0.0, 40.0), (15.0, 50.0), (25.0, LONG)], ids=["late", "tunnel", "early"])
def test_windows_without_gnss_are_simulated_like_others_and_their_car_drives_on(long_drive, begin, end):
    dataset = build_dataset([silent(long_drive, begin, end, "gps/fix", "gps/velocity")], prototype())
    assert len(dataset.windows) > 1
    predictor = Predictor(prototype(), dataset)
    assert all(predictor.simulated(predictor.start))
    for window, (_, place) in zip(dataset.windows, predictor.roads.way, strict=True):
        t = np.linspace(window.begin, window.end, 500)
        driven_on = trapezoid(np.interp(t, window.speed.t, window.speed.value[:, 0]), t)
        assert place[-1] - place[0] == pytest.approx(driven_on, rel=0.05)


def test_a_window_without_gnss_heads_where_the_rest_of_its_recording_says(long_drive):
    """Within what a slalom turns to either side."""
    velocity = long_drive["gps/velocity"]
    east, north, up = velocity.columns["linear"].T
    columns = {**velocity.columns, "linear": np.column_stack([-north, east, up])}  # the same drive to the north
    northwards = replace(
        long_drive, channels={**long_drive.channels, velocity.topic: replace(velocity, columns=columns)}
    )
    dataset = build_dataset([silent(northwards, 15.0, 50.0, "gps/fix", "gps/velocity")], prototype())
    assert [w.heading for w in dataset.windows] == pytest.approx([np.pi / 2] * len(dataset.windows), abs=0.2)


def test_a_torque_that_one_message_lacks_is_what_its_neighbours_say():
    recording = driven(prototype(), "sweep")
    torques = recording["vehicle/wheel_torques"]
    columns = {name: value.copy() for name, value in torques.columns.items()}
    columns["effort"][len(torques) // 2, -1] = np.nan
    spoilt = replace(recording, channels={**recording.channels, torques.topic: replace(torques, columns=columns)})
    whole, lacking = (Predictor(prototype(), build_dataset([r], prototype())) for r in (recording, spoilt))
    (expected,), (found,) = whole.simulated(whole.start), lacking.simulated(lacking.start)
    assert found["yaw_rate"] == pytest.approx(expected["yaw_rate"], abs=1e-4)


def test_a_car_that_turns_after_its_gyro_has_fallen_silent_does_not_spin():
    quiet = silent(driven(prototype(), "bend", 20.0), 12.0, 20.0, "imu/data")
    dataset = build_dataset([quiet], prototype())
    found = hindrance([quiet], dataset, build_dataset([], prototype()), prototype())
    assert found is None or "spins" not in found.reason


def test_a_gnss_so_slow_that_all_between_is_a_gap_leaves_the_recording_out_with_the_reason():
    car = without(prototype(), "wheel_speeds", "wheel_torques")
    recording = driven(prototype(), "sweep", 20.0)
    velocity = recording["gps/velocity"]
    rows = np.arange(0, len(velocity), round(1.0 / np.median(np.diff(seconds(recording, "gps/velocity")))))
    columns = {name: value[rows] for name, value in velocity.columns.items()}
    slow = replace(velocity, stamp=velocity.stamp[rows] + 5_000_000, received=velocity.received[rows], columns=columns)
    seldom = replace(recording, channels={**recording.channels, velocity.topic: slow})
    dataset = build_dataset([silent(seldom, 0.0, 0.53, "imu/data")], car)
    assert not dataset.windows
    assert "without a gap of 0.5 s: gps/velocity comes every 1 s" in dataset.remarks[-1]


@pytest.mark.parametrize("length", [0.0, 3.0, 5.0])
def test_a_car_that_creeps_has_not_been_anywhere(length):
    road = Road()
    travelled = np.linspace(0.0, length, 20)
    distance, abscissa = road.follow(travelled, travelled, 0.0 * travelled)
    assert len(distance) == len(abscissa) == 0
