"""Defects of sensors that are determined before any fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, prototype
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.beforehand import Beforehand, beforehand, not_proven, with_sizes
from vsense_ros.mismatch.windows import build_dataset


def with_antenna(recording: Recording, left: float) -> Recording:
    """The recording with velocities of an antenna that sits further to the left [m]: rigid-body kinematics."""
    velocity, imu = recording["gps/velocity"], recording["imu/data"]
    east, north = velocity.columns["linear"][:, :2].T
    course = np.arctan2(north, east)
    rate = np.interp(velocity.stamp, imu.stamp, imu.columns["angular_velocity"][:, 2])
    further = -left * rate[:, None] * np.column_stack([np.cos(course), np.sin(course), np.zeros(len(course))])
    channel = replace(velocity, columns={**velocity.columns, "linear": velocity.columns["linear"] + further})
    return replace(recording, channels={**recording.channels, channel.topic: channel})


def known(*recordings: Recording, held_out: Sequence[Recording] = ()) -> tuple[Beforehand, ...]:
    return beforehand(build_dataset(recordings, prototype()), build_dataset(held_out, prototype()), prototype())


@pytest.mark.parametrize("left", [-2.5, 2.5])
def test_an_antenna_far_beside_the_middle_is_placed_by_bends_to_both_sides(left):
    (found,) = known(*(with_antenna(driven(prototype(), name), left) for name in ("slalom", "sweep")))
    assert (found.effect, found.field) == ("gnss_lever_arm", "y")
    assert found.value == pytest.approx(left, abs=3 * found.deviation)
    assert found.deviation < 0.25


def test_an_antenna_that_is_where_the_file_says_is_not_moved():
    assert known(driven(prototype(), "slalom"), driven(prototype(), "sweep")) == ()


def test_bends_to_one_side_alone_do_not_tell_an_antenna_from_a_tyre_radius():
    assert known(with_antenna(driven(prototype(), "bend"), 2.5)) == ()


def test_bends_to_the_other_side_in_a_held_out_recording_place_the_antenna_and_no_longer_prove_it():
    bend, slalom = (with_antenna(driven(prototype(), name), 2.5) for name in ("bend", "slalom"))
    (found,) = known(bend, held_out=[slalom])
    assert found.value == pytest.approx(2.5, abs=3 * found.deviation)
    (said,) = not_proven([found])
    assert "do not prove it" in said
    (alone,) = known(slalom, bend)
    assert not_proven([alone]) == []


def test_with_the_antenna_where_it_was_found_nothing_more_is_known():
    recordings = [with_antenna(driven(prototype(), name), 2.5) for name in ("slalom", "sweep")]
    car = with_sizes(prototype(), known(*recordings))
    assert beforehand(build_dataset(recordings, car), build_dataset([], car), car) == ()
