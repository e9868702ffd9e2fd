"""Sensors with other conventions of axes and signs are mended as wholes, and nobody else is."""

from __future__ import annotations

import numpy as np
import pytest

from recordings import conventions, planted
from recordings.conventions import EVERY, NORTH_EAST_DOWN, SINGLE, same, turned, without_gnss
from recordings.planted import FIX, IMU, STEERING, VELOCITY, WHEELS, changed, scaled
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.inspect import inspect
from vsense_ros.checks.mending import mends
from vsense_ros.messages.recording import Recording


def drive() -> Recording:
    return planted.drive("double_lane_change", "prototype_real", 0)


def wrong(*names: str, gnss: bool = True) -> Recording:
    found = drive() if gnss else without_gnss(drive())
    for name in names:
        for topic, change in SINGLE[name]:
            found = changed(found, topic, change)
    return found


@pytest.mark.parametrize("name", SINGLE)
def test_a_sensor_with_another_convention_is_mended_and_no_other_is(name: str) -> None:
    todo = mends(wrong(name))
    assert {finding.topic for finding in todo} == {topic for topic, _ in SINGLE[name]}
    assert same(mended(wrong(name), todo), drive())


def test_a_velocity_in_north_east_down_costs_neither_gyro_nor_steering_nor_wheels() -> None:
    recording = changed(drive(), VELOCITY, turned(NORTH_EAST_DOWN, "linear"))
    (finding,) = mends(recording)
    assert finding.topic == VELOCITY
    assert {f.topic for f in inspect(recording).findings} == {VELOCITY}


def test_a_vendor_wholly_in_sae_j670_is_named_and_neither_the_fix_nor_the_wheels_are() -> None:
    names = ("IMU in SAE J670, aerospace axes", "velocity in north, east, down", "steering positive to the right")
    recording = wrong(*names)
    assert same(mended(recording, mends(recording)), drive())
    blamed = {finding.topic for finding in inspect(recording).findings}
    assert blamed == {IMU, VELOCITY, STEERING}


def test_steering_that_is_positive_to_the_right_is_one_mend_without_gnss_which_nothing_contradicts() -> None:
    recording = wrong("steering positive to the right", gnss=False)
    todo = mends(recording)
    assert [finding.topic for finding in todo] == [STEERING]
    assert inspect(mended(recording, todo)).problems == ()


def test_at_a_tie_nothing_is_mended_and_both_are_reported() -> None:
    both = {topic: channel for topic, channel in drive().channels.items() if topic in (STEERING, WHEELS)}
    recording = changed(Recording(both), STEERING, scaled("position", -1.0))
    assert mends(recording) == []
    problems = inspect(recording).problems
    assert {problem.partition(":")[0] for problem in problems} == {STEERING, WHEELS}
    assert all("would explain it" in problem for problem in problems)


def test_covariances_are_turned_with_their_vector() -> None:
    velocity = drive()[VELOCITY]
    covariance = np.zeros((len(velocity), 36))
    covariance[:, 0], covariance[:, 7], covariance[:, 1], covariance[:, 6] = 4.0, 9.0, 1.0, 1.0
    recording = changed(drive(), VELOCITY, planted.values("covariance", lambda _: covariance))
    north_first = changed(recording, VELOCITY, turned(NORTH_EAST_DOWN, "linear"))
    (finding,) = mends(north_first)
    after = mended(north_first, [finding])[VELOCITY].columns["covariance"]
    assert np.allclose(after[:, [0, 7, 1, 6]], [9.0, 4.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("manoeuvre", "vehicle", "gnss", "begin", "end"),
    [
        ("steering_sweep", "prototype_real", False, 0.52, 1.0),  # accelerometers of the other sign, half a period later
        ("steering_sweep", "rav4", True, 0.67, 1.0),  # the body rolls as the course turns
        ("brake_in_turn", "rav4", False, 0.0, 1.0),  # a locked wheel turns the car at 10 rad/s
        ("brake_in_turn", "genesis", True, 0.25, 0.75),  # the yaw rate rises where the angle by the speed falls
    ],
)
def test_a_part_of_a_drive_with_nothing_wrong_gets_no_mend(
    manoeuvre: str, vehicle: str, gnss: bool, begin: float, end: float
) -> None:
    recording = planted.drive(manoeuvre, vehicle, 0)
    part = recording.between(begin * recording.duration, end * recording.duration)
    assert mends(part if gnss else without_gnss(part)) == []


@pytest.mark.exam
def test_forty_recordings_with_other_conventions_are_mended() -> None:
    assert len(EVERY) == 20
    right = [same(mended(one.wrong, mends(one.wrong)), one.right) for one in conventions.drives()]
    assert sum(right) >= 38
    assert FIX in drive()
