"""What is made of recordings before a model is held against them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, prototype
from vsense_ros.mismatch.evidence import RUN_IN, gather
from vsense_ros.recording import Recording


def turned_about(recording: Recording) -> Recording:
    """As a sensor would measure that looks backwards."""
    imu = recording["imu/data"]
    fields = ("angular_velocity", "linear_acceleration")
    columns = {**imu.columns, **{field: imu.columns[field] * [-1.0, -1.0, 1.0] for field in fields}}
    return replace(recording, channels={**recording.channels, "imu/data": replace(imu, columns=columns)})


def without(recording: Recording, *topics: str) -> Recording:
    return replace(recording, channels={k: c for k, c in recording.channels.items() if k not in topics})


@pytest.mark.parametrize("silent", [("vehicle/wheel_speeds",), ("gps/velocity", "gps/fix")])
def test_speed_and_heading_do_not_depend_on_how_the_inertial_sensor_is_mounted(silent):
    recording = without(driven(prototype(), "brake"), *silent)
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


@pytest.fixture(scope="module")
def dull_drive_with_two_manoeuvres():
    """Evidence of 100 s: straight ahead, but for a sweep and a brake test."""
    names = ("straight", "straight", "sweep", "straight", "brake", "straight", "straight", "straight")
    return gather([driven(prototype(), name, seed=i) for i, name in enumerate(names)], prototype())


@pytest.mark.parametrize("duration", [21.0, 25.0, 42.0])
def test_of_a_long_dull_drive_the_manoeuvres_are_looked_at(dull_drive_with_two_manoeuvres, duration):
    evidence = dull_drive_with_two_manoeuvres
    chosen = evidence.most_telling(duration)
    assert {"sweep", "brake"} <= {window.name for window in chosen.windows}
    assert sum(w.end - w.begin - RUN_IN for w in chosen.windows) <= duration
    assert len(chosen.windows) == duration // 10.4
    assert [w for w in evidence.windows if w in chosen.windows] == list(chosen.windows)
    assert "of 1 min" in chosen.remarks[-1]
    assert chosen.most_telling(duration) is chosen


def test_each_recording_and_each_sensor_is_looked_at_as_far_as_that_goes():
    """Though the straight drives, of which one alone has GNSS, tell nothing of steering."""
    silent = without(driven(prototype(), "sweep", duration=60.0), "gps/velocity", "gps/fix")
    evidence = gather([silent, driven(prototype(), "straight"), driven(prototype(), "straight", seed=1)], prototype())
    chosen = evidence.most_telling(45.0)
    assert {w.recording for w in chosen.windows} == {0, 1, 2}
    assert "velocity" in {name for w in chosen.windows for name in w.readings}
    assert "nothing of" not in chosen.remarks[-1]
    assert "nothing of" in evidence.most_telling(12.0).remarks[-1]


def test_a_drive_that_is_short_enough_is_looked_at_all(dull_drive_with_two_manoeuvres):
    assert dull_drive_with_two_manoeuvres.most_telling(200.0) is dull_drive_with_two_manoeuvres


def test_of_hours_that_are_all_alike_early_and_late_ones_are_looked_at():
    """What grows with time, as heat does, would otherwise stay unseen."""
    recording = driven(prototype(), "slalom", duration=60.0)
    windows = gather([recording], prototype()).most_telling(41.0).windows
    assert [round(w.begin / 20.0) for w in windows] == [0, 2]
