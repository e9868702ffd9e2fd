"""A set of effects may never have been fitted because the search grew others: each name is held against its like."""

from __future__ import annotations

import pytest

from hidden import driven, having, prototype
from vsense_ros.identification.least_squares import fit
from vsense_ros.mismatch.candidates import base_parameters, candidates
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.windows import build_dataset


@pytest.mark.exam
def test_an_offset_beside_another_effect_is_exchanged_for_the_turned_sensor_that_it_stands_in_for():
    hidden = {"imu_pitch_misalignment": {"angle": 0.05}, "gyro_scale": {"z": 0.05}}
    recordings = [driven(having(prototype(), **hidden), manoeuvre) for manoeuvre in ("sweep", "slalom")]
    residuals = Residuals(Predictor(prototype(), build_dataset(recordings, prototype())))
    start = residuals.predictor.start
    base = fit(residuals, start, base_parameters(prototype()))
    every = {candidate.name: candidate for candidate in candidates((), start.values)}
    names = ("gyro_scale z", "accelerometer_bias x", "imu_pitch_misalignment", "aero_drag")
    scale, offset, turned, drag = (every[name] for name in names)
    search = Search(residuals, start, base, [scale, offset, turned, drag])
    (wrong,) = search.together([scale, offset])
    found = search.exchanged(wrong, [wrong], THRESHOLDS.rival_share)
    assert all("aero_drag" not in one.effects for one in found)  # of which neither is a likeness
    right = max(found, key=lambda one: one.score)
    assert set(right.effects) == {"gyro_scale", "imu_pitch_misalignment"}
    assert right.score > wrong.score + 0.1
    assert right.sizes["effects.imu_pitch_misalignment.angle"] == pytest.approx(0.05, rel=0.1)
    alone = {one.effects for one in found if len(one.effects) == 1}
    assert alone == {("gyro_scale",), ("accelerometer_bias",)}
    again = search.exchanged(right, [*found, wrong], THRESHOLDS.rival_share)
    assert [one.effects for one in again] == [("imu_pitch_misalignment",)]  # all else is known
