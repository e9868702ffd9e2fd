"""What is made of recordings before a model is held against them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, prototype, unheard
from vsense_ros.mismatch.evidence import gather
from vsense_ros.recording import Recording


def turned_about(recording: Recording) -> Recording:
    """As a sensor would measure that looks backwards."""
    imu = recording["imu/data"]
    fields = ("angular_velocity", "linear_acceleration")
    columns = {**imu.columns, **{field: imu.columns[field] * [-1.0, -1.0, 1.0] for field in fields}}
    return replace(recording, channels={**recording.channels, "imu/data": replace(imu, columns=columns)})


@pytest.mark.parametrize("silent", [("vehicle/wheel_speeds",), ("gps/velocity", "gps/fix")])
def test_speed_and_heading_do_not_depend_on_how_the_inertial_sensor_is_mounted(silent):
    recording = unheard(driven(prototype(), "brake"), *silent)
    sensors = prototype().sensors
    backwards = sensors["imu"].model_copy(update={"attitude": (0.0, 0.0, np.pi)})
    vehicle = prototype().model_copy(update={"sensors": {**sensors, "imu": backwards}})
    (as_usual,) = gather([recording], prototype()).windows
    (found,) = gather([turned_about(recording)], vehicle).windows
    for name in ("speed", "turned"):
        assert getattr(found, name).value == pytest.approx(getattr(as_usual, name).value, abs=1e-9)


def test_what_two_windows_of_a_recording_have_in_common_is_driven_once():
    (recording,) = (driven(prototype(), "slalom", duration=40.0),)
    evidence = gather([recording, recording], prototype())
    assert len(evidence.windows) == 4
    assert evidence.driven == pytest.approx(2 * 40.0, abs=1.0)
