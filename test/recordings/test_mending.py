"""Axes, signs and units that were made wrong on purpose, and what would mend them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.checks.correcting import mended
from vsense_ros.checks.finding import Finding, Kind, Scale
from vsense_ros.checks.mending import mends
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.sentences import mend_in_words
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.closed_loop import rolling_radii, rolling_straight, simulate

RADIUS = float(np.mean(rolling_radii(load_vehicle(vehicle_path("prototype_model")))))
RATES, FORCES = "angular_velocity", "linear_acceleration"


@cache
def drive() -> Recording:
    """Bends to both sides, with brakes and throttle that follow no bend."""
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    q, u = rolling_straight(vehicle, 14.0)

    def driver(t: float, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        push = 80.0 * np.sin(0.5 * t + 1.0) + 3.0 * (14.0 - u[0])
        return np.concatenate([[0.05 * np.sin(0.37 * t + 0.02 * t**2)], np.full(4, push)])

    return record(simulate(vehicle, driver, 40.0, q=q, u=u), vehicle, seed=3, name="bends")


def changed(topic: str, field: str, values: np.ndarray, recording: Recording | None = None) -> Recording:
    recording = recording or drive()
    channel = recording[topic]
    new = replace(channel, columns={**channel.columns, field: values})
    return replace(recording, channels={**recording.channels, topic: new})


def turned_by(turn: np.ndarray, *fields: str) -> Recording:
    """As a sensor would measure whose axes are the rows of a matrix, in those of the car."""
    found = drive()
    for field in fields:
        found = changed("imu/data", field, found["imu/data"].columns[field] @ turn.T, found)
    return found


ROTATIONS = [
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.diag(signs)[list(order)]) > 0
]


def test_nothing_is_mended_where_nothing_is_wrong():
    assert mends(drive()) == []


@settings(deadline=None, max_examples=6)
@given(turn=st.sampled_from(ROTATIONS), late=st.sampled_from([0, 0, 1_300_000_000]))
def test_an_inertial_sensor_may_be_turned_and_its_values_come_back_whatever_its_clock_says(turn, late):
    _values_come_back(turn, late)


@pytest.mark.exam
@pytest.mark.parametrize("late", [0, 1_300_000_000])
def test_however_an_inertial_sensor_is_turned_its_values_come_back_and_its_clock_plays_no_part(late):
    for turn in ROTATIONS:
        _values_come_back(turn, late)


def _values_come_back(turn: np.ndarray, late: int) -> None:
    wrong = turned_by(turn, RATES, FORCES)
    imu = wrong["imu/data"]
    wrong = replace(wrong, channels={**wrong.channels, "imu/data": replace(imu, stamp=imu.stamp + late)})
    right = mended(wrong, mends(wrong))
    for field in (RATES, FORCES):
        assert right["imu/data"].columns[field] == pytest.approx(drive()["imu/data"].columns[field], abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: turned_by(np.diag([1.0, -1.0, 1.0]), FORCES), "left is −y"),
        (lambda: turned_by(np.diag([-1.0, 1.0, 1.0]), FORCES), "forward is −x"),
        (lambda: turned_by(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), FORCES), "forward is +y"),
        (lambda: changed("vehicle/steering", "position", -drive()["vehicle/steering"].columns["position"]), "reversed"),
        (
            lambda: changed(
                "vehicle/wheel_speeds", "velocity", RADIUS * drive()["vehicle/wheel_speeds"].columns["velocity"]
            ),
            "into rad/s",
        ),
        (lambda: changed("imu/data", FORCES, drive()["imu/data"].columns[FORCES] / 9.81), "g into m/s²"),
        (lambda: changed("imu/data", RATES, drive()["imu/data"].columns[RATES] * 180 / np.pi), "deg/s into rad/s"),
    ],
)  # fmt: skip
def test_what_was_made_wrong_is_named_with_what_mends_it(wrong, words):
    (found,) = mends(wrong(), radius=RADIUS)
    assert words in mend_in_words(found)
    assert mends(mended(wrong(), [found]), radius=RADIUS) == []


def test_wheels_of_the_left_that_are_called_those_of_the_right_are_exchanged():
    wheels = drive()["vehicle/wheel_speeds"]
    swap = {"wheel_fl": "wheel_fr", "wheel_fr": "wheel_fl", "wheel_rl": "wheel_rr", "wheel_rr": "wheel_rl"}
    wrong = replace(wheels, names=tuple(swap[name] for name in wheels.names))
    recording = replace(drive(), channels={**drive().channels, wheels.topic: wrong})
    (found,) = mends(recording)
    assert mended(recording, [found])[wheels.topic].names == wheels.names


def test_a_recording_says_in_its_notes_what_was_mended():
    mend = Scale("position", -1.0, "steering_wheel")
    finding = Finding("vehicle/steering", Kind.SIGN, Reason.TURNS_AGAINST, "steering_wheel", "gyro", mend=mend)
    right = mended(drive(), [finding])
    assert right.notes[-1] == "mended: vehicle/steering: steering_wheel: the sign reversed"
    assert np.array_equal(
        right["vehicle/steering"].columns["position"], -drive()["vehicle/steering"].columns["position"]
    )


def test_a_lateral_accelerometer_alone_that_is_reversed_is_named_with_what_mends_it():
    forces = drive()["imu/data"].columns[FORCES] * [np.nan, -1.0, np.nan]
    wrong = changed("imu/data", FORCES, forces)
    found = [finding for finding in mends(wrong, radius=RADIUS) if finding.mend is not None]
    assert [(finding.kind, finding.signal) for finding in found] == [(Kind.SIGN, "linear_acceleration.y")]
    lateral = mended(wrong, found)["imu/data"].columns[FORCES][:, 1]
    assert np.array_equal(lateral, drive()["imu/data"].columns[FORCES][:, 1])
    assert not mends(changed("imu/data", FORCES, forces * [1.0, -1.0, 1.0]), radius=RADIUS)
