"""The most informative part of long drives is selected."""

from __future__ import annotations

import pytest

from hidden import driven, prototype, unheard
from vsense_ros.mismatch.selection import most_telling
from vsense_ros.mismatch.windows import WINDOWS, build_dataset


@pytest.fixture(scope="module")
def dull_drive_with_two_manoeuvres():
    """Dataset of 100 s: straight ahead, but for a sweep and a brake test."""
    names = ("straight", "straight", "sweep", "straight", "brake", "straight", "straight", "straight")
    return build_dataset([driven(prototype(), name, seed=i) for i, name in enumerate(names)], prototype())


@pytest.mark.parametrize("duration", [21.0, 25.0, 42.0])
def test_of_a_long_dull_drive_the_manoeuvres_are_looked_at(dull_drive_with_two_manoeuvres, duration):
    dataset = dull_drive_with_two_manoeuvres
    chosen = most_telling(dataset, duration)
    assert {"sweep", "brake"} <= {window.name for window in chosen.windows}
    assert sum(w.end - w.begin - WINDOWS.run_in for w in chosen.windows) <= duration
    assert len(chosen.windows) == duration // 10.4
    assert [w for w in dataset.windows if w in chosen.windows] == list(chosen.windows)
    assert "of 1 min" in chosen.remarks[-1]
    assert most_telling(chosen, duration) is chosen


def test_each_recording_and_each_sensor_is_looked_at_as_far_as_that_goes():
    """Though the straight drives, of which one alone has GNSS, tell nothing of steering."""
    silent = unheard(driven(prototype(), "sweep", duration=60.0), "gps/velocity", "gps/fix")
    dataset = build_dataset(
        [silent, driven(prototype(), "straight"), driven(prototype(), "straight", seed=1)], prototype()
    )
    chosen = most_telling(dataset, 45.0)
    assert {w.recording for w in chosen.windows} == {0, 1, 2}
    assert "velocity" in {name for w in chosen.windows for name in w.readings}
    assert "nothing of" not in chosen.remarks[-1]
    assert "nothing of" in most_telling(dataset, 12.0).remarks[-1]


def test_a_drive_that_is_short_enough_is_looked_at_all(dull_drive_with_two_manoeuvres):
    assert most_telling(dull_drive_with_two_manoeuvres, 200.0) is dull_drive_with_two_manoeuvres


@pytest.mark.exam
def test_of_hours_that_are_all_alike_early_and_late_ones_are_looked_at():
    """What grows with time, as heat does, would otherwise stay unseen."""
    recording = driven(prototype(), "slalom", duration=60.0)
    windows = most_telling(build_dataset([recording], prototype()), 41.0).windows
    assert [round(w.begin / 20.0) for w in windows] == [0, 2]
