"""An accelerometer that has an offset and is turned as well may read right on the whole: only both together show."""

from __future__ import annotations

import pytest

from hidden import driven, having, prototype
from vsense_ros.identify.least_squares import fit
from vsense_ros.mismatch.candidates import base_parameters, candidates
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.constants import GRAVITY

TURNED = 0.05  # [rad] about y: the x axis reads that share of gravity less, which the offset gives back
HIDDEN = {"imu_pitch_misalignment": {"angle": TURNED}, "accelerometer_bias": {"x": TURNED * GRAVITY}}
NAMES = ("gyro_scale z", "accelerometer_bias x", "imu_pitch_misalignment", "aero_drag", "steering_ratio")
LEAST = 0.03


def searching(**hidden: dict[str, float]) -> Search:
    recordings = [driven(having(prototype(), **hidden), manoeuvre) for manoeuvre in ("sweep", "slalom")]
    residuals = Residuals(Predictor(prototype(), build_dataset(recordings, prototype())))
    start = residuals.predictor.start
    base = fit(residuals, start, base_parameters(prototype()))
    every = {candidate.name: candidate for candidate in candidates((), start.values)}
    return Search(residuals, start, base, [every[name] for name in NAMES])


@pytest.mark.slow
@pytest.mark.parametrize("besides", [{}, {"gyro_scale": {"z": 0.05}}], ids=["alone", "besides another effect"])
def test_two_effects_of_which_neither_shows_alone_are_found_together(besides: dict[str, dict[str, float]]):
    search = searching(**HIDDEN, **besides)
    expected = {*HIDDEN, *besides}
    singles = search.single()
    of_sensor = [e for e in singles if e.effects[0] in HIDDEN]
    rounds = [singles]
    while found := search.further(rounds[-1], LEAST, lambda e: e.score, unseen=False):
        rounds.append(found)
    best = max((e for found in rounds for e in found), key=lambda e: e.score)
    assert set(best.effects) == expected
    without = max((e.score for e in singles if e.effects[0] in besides), default=0.0)
    assert best.score - without > 2 * max((e.score for e in of_sensor), default=0.0)  # neither shows alone
    assert best.sizes["effects.imu_pitch_misalignment.angle"] == pytest.approx(TURNED, rel=0.15)
    assert best.sizes["effects.accelerometer_bias.x"] == pytest.approx(TURNED * GRAVITY, rel=0.15)


@pytest.mark.slow
def test_where_one_of_the_two_is_there_alone_no_pair_is_tried():
    search = searching(imu_pitch_misalignment={"angle": TURNED})
    singles = search.single()
    assert singles[0].effects == ("imu_pitch_misalignment",)
    found = search.further(singles, LEAST, lambda e: e.score, unseen=False)
    assert not any(set(HIDDEN) <= set(e.effects) for e in found)
