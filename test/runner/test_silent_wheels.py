"""A vehicle file that lists wheel speeds, and a car of which none are heard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drives import WHEELS
from vsense_ros.messages.diagnostic import Level
from vsense_ros.runner import run


def first(recording, seconds):
    """The first seconds of a recording without its wheel speeds."""
    kept = {topic: one.select(one.seconds < seconds) for topic, one in recording.channels.items() if topic != WHEELS}
    return replace(recording, channels=kept)


def test_a_recording_without_wheel_speeds_is_estimated_as_with_a_file_that_does_not_list_them(vehicle, lane_change):
    drive = first(lane_change, 3.0)
    fewer = {name: one for name, one in vehicle.sensors.items() if one.topic != WHEELS}
    listed, unlisted = (run(drive, car) for car in (vehicle, vehicle.model_copy(update={"sensors": fewer})))
    for topic in ("vsense/odometry", "vsense/wheel_force/fl"):
        for field, values in listed.output[topic].columns.items():
            np.testing.assert_array_equal(values, unlisted.output[topic].columns[field])
    (line,) = (line for line in listed.diagnostics if line.name == "wheel_speeds")
    assert (line.level, line.message) == (Level.STALE, f"no message on {WHEELS}")
