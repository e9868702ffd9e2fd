"""Drives to the limit: intervals of errors that are paired, and a filter that knows its car."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies import limit as job
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

BAGS = Path(__file__).parents[2] / "bags"


def compared(*scales: float) -> job.Compared:
    """Errors of both multibody observers and two other ways: independent noise of some sizes on one that all share."""
    rng = np.random.default_rng(3)
    shared = rng.standard_normal(2400)
    names = (*job.MULTIBODY, "integrated", "inertial")
    errors = {name: size * (shared + 0.1 * rng.standard_normal(2400)) for name, size in zip(names, scales, strict=True)}
    return job.Compared(errors, 9.0, {})


def test_the_interval_of_a_ratio_is_that_of_pairs_and_holds_the_true_one() -> None:
    ratio, low, high = job.ratio_interval(compared(1.0, 1.0, 1.3, 1.0).blocks(("error_ekf", "integrated")))
    assert low < 1.3 < high
    assert ratio == pytest.approx(1.3, rel=0.02)
    assert high - low < 0.02  # what both share would alone make it 0.1 wide


def test_a_way_that_is_as_good_is_named_and_one_that_is_worse_is_not() -> None:
    (line,) = job.not_better({"a drive": compared(1.0, 2.0, 1.3, 0.9)})
    assert line.startswith("a drive: inertial has 0.9")
    assert "error_ekf" in line


def test_one_drive_is_refused_as_nothing_else_could_be_identified_on() -> None:
    bag = import_recording(BAGS / "step_steer")
    with pytest.raises(InputError, match="two recordings or more"):
        job.compare_all([bag], load_vehicle(vehicle_path(job.START)))


def test_the_single_track_ukf_comes_closer_once_it_is_identified_on_another_drive() -> None:
    car = load_vehicle(vehicle_path(job.START))
    known, other = (import_recording(BAGS / name) for name in ("double_lane_change", "sine_with_dwell"))
    ukf = job.SingleTrackUkf(car)
    readings, truth = job.Readings.of(other, car), job._truth(other)
    before = np.nanstd(job._error(ukf.estimate(readings), truth))
    ukf.identify([known])
    after = np.nanstd(job._error(ukf.estimate(readings), truth))
    assert after < before
