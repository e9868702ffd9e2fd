"""Limits of the monitor, from made-up statistics of recordings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.monitor import Quantity
from vsense_ros.runner.calibration import CHANCE, LEAST, MOST, Watch, calibrate


@cache
def prototype() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_model"))


def seen(name: str, *means: float, rms: float = 1.0) -> Watch:
    """A recording with one quantity that has these means in its windows."""
    statistics = np.array([[[mean], [rms]] for mean in means])
    moment = (Quantity("yaw moment", "N m"),)
    return Watch(name, 10.0 * len(means), moment, np.arange(len(means)), statistics, {}, name.encode())


def test_the_margin_is_the_least_with_which_every_recording_passes_the_limits_of_the_others() -> None:
    found = calibrate([seen("a", -1.0, 1.0), seen("b", -1.0, 1.0), seen("c", -1.9, 1.0)], prototype())
    assert found.needed == {"yaw moment": pytest.approx(1.9)}
    yaw = found.limits.quantities["yaw moment"]
    assert yaw.margin == pytest.approx(1.9)
    assert (yaw.low, yaw.high) == (pytest.approx(-0.45 - 1.9 * 1.45), pytest.approx(-0.45 + 1.9 * 1.45))
    assert (found.limits.recordings, found.limits.seconds, found.unsure) == (["a", "b", "c"], 60.0, [])


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=5), min_size=2, max_size=5))
def test_what_was_calibrated_on_is_within_the_limits(means: list[list[float]]) -> None:
    found = calibrate([seen(str(i), *row) for i, row in enumerate(means)], prototype())
    for name, limit in found.limits.quantities.items():
        assert name in found.needed
        assert all(limit.low <= mean <= limit.high for row in means for mean in row)


def test_a_quantity_that_differs_too_much_between_recordings_is_told_to_be_unsure() -> None:
    found = calibrate([seen("a", -1.0, 1.0), seen("b", 50.0, 51.0)], prototype())
    assert found.unsure == ["yaw moment"]
    assert found.limits.quantities["yaw moment"].margin == MOST


@pytest.mark.parametrize(
    ("recordings", "reason"),
    [
        ([seen("a", 1.0, 1.0), seen("b", 1.0, 1.0)], "never changes in a, b"),
        ([seen("a", 1.0, 1.0), seen("b", 0.0, 2.0), seen("c", 1.0, 1.0)], "never changes in a, c"),
        ([seen("a", 0.0, 2.0), seen("b", np.nan, rms=np.nan), seen("c", 0.0, 1.0)], "not known in b"),
        ([seen(name, np.nan, rms=np.nan) for name in "ab"], "not known in any recording"),
    ],
)
def test_a_quantity_without_limits_is_told_with_the_recordings_that_are_the_reason(recordings, reason) -> None:
    found = calibrate(recordings, prototype())
    assert found.limits.quantities == {}
    assert found.without == {"yaw moment": reason}


def test_one_recording_is_not_enough_for_limits() -> None:
    with pytest.raises(InputError, match="at least two recordings"):
        calibrate([seen("a", 0.0)], prototype())


def copy_of(one: Watch, name: str) -> Watch:
    return replace(one, name=name)


def test_a_drive_that_is_given_twice_counts_once() -> None:
    a, b = seen("a", -1.0, 1.0), seen("b", -1.9, 1.0)
    once = calibrate([a, b], prototype())
    twice = calibrate([a, b, copy_of(b, "copy")], prototype())
    assert twice.limits == once.limits
    assert twice.needed == once.needed
    assert (once.repeated, twice.repeated) == ([], [["b", "copy"]])


def test_one_drive_given_twice_is_not_enough_for_limits() -> None:
    a = seen("a", -1.0, 1.0)
    with pytest.raises(InputError, match=r"at least two recordings.*the same drive was given more than once: a, copy$"):
        calibrate([a, copy_of(a, "copy")], prototype())


def of_many(name: str, rms: float, independent: float, *means: float) -> Watch:
    """A recording whose windows are each of so many independent values."""
    return replace(seen(name, *means, rms=rms), independent=np.array([independent]))


def test_limits_are_no_closer_than_what_chance_makes_of_a_window() -> None:
    found = calibrate([of_many("a", 2.0, 100.0, 0.1, -0.1), of_many("b", 2.0, 25.0, -0.1, 0.1)], prototype())
    yaw = found.limits.quantities["yaw moment"]
    assert (yaw.low, yaw.high) == pytest.approx((-CHANCE * 2.0 / 5, CHANCE * 2.0 / 5))
    assert yaw.rms == pytest.approx(2.0 + CHANCE * 2.0 / np.sqrt(50))
    assert yaw.margin == LEAST
    unknown = calibrate([of_many("a", 2.0, 100.0, 0.1, -0.1), seen("b", -0.1, 0.1, rms=2.0)], prototype())
    assert unknown.limits.quantities["yaw moment"].high == pytest.approx(0.1 * LEAST)


@given(shift=st.floats(-1e3, 1e3), scale=st.floats(0.1, 10.0))
def test_limits_move_and_grow_with_what_they_are_of(shift: float, scale: float) -> None:
    rows = [(-1.0, 1.2), (-1.1, 0.9), (-0.8, 1.0)]
    plain = calibrate([seen(str(i), *row) for i, row in enumerate(rows)], prototype()).limits.quantities["yaw moment"]
    moved = calibrate(
        [seen(str(i), *(shift + scale * mean for mean in row)) for i, row in enumerate(rows)], prototype()
    ).limits.quantities["yaw moment"]
    assert moved.margin == pytest.approx(plain.margin, rel=1e-6)
    assert (moved.low, moved.high) == pytest.approx((shift + scale * plain.low, shift + scale * plain.high), abs=1e-6)
