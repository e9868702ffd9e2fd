"""What the simulation remembers, and how many runs go side by side, changes what it costs and nothing that it says."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import driven, prototype
from vsense_ros.mismatch.prediction_settings import PREDICTION
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor, _at_once
from vsense_ros.mismatch.windows import build_dataset

CHANGES = (
    {},
    {"effects.road_bank.bank": 0.03},
    {"effects.road_bank.bank": 0.03, "effects.road_bank.follows": 0.0},
    {"effects.road_grade.grade": -0.02},
    {"effects.sensor_delay.imu": 0.05},
    {"effects.sensor_delay.steering": 0.05},
    {"chassis.mass": 700.0},
    {"effects.gyro_bias.z": 0.02},
)


def test_what_was_asked_before_changes_no_answer():
    dataset = build_dataset([driven(prototype(), manoeuvre) for manoeuvre in ("slalom", "sweep")], prototype())
    asked_often = Predictor(prototype(), dataset)
    sets = [asked_often.start.changed(changes) for changes in CHANGES]
    alone = [Predictor(prototype(), dataset).simulated(one) for one in sets]
    asked_often.foresee(sets[: asked_often.ahead])
    for i in np.random.default_rng(0).integers(len(sets), size=40):
        again = asked_often.start.changed(CHANGES[i]) if i % 2 else sets[i]  # the same set, or another that is equal
        for found, expected in zip(asked_often.simulated(again), alone[i], strict=True):
            assert found.keys() == expected.keys()
            for signal, value in found.items():
                np.testing.assert_array_equal(value, expected[signal])


def test_motions_near_a_known_one_change_signals_as_simulations_in_full_do_and_serve_no_other_set():
    dataset = build_dataset([driven(prototype(), "slalom")], prototype())
    predictor, in_full = (Predictor(prototype(), dataset) for _ in range(2))
    known = predictor.start
    mass = known.values["chassis.mass"]
    changes = (
        {"chassis.mass": 1.03 * mass}, {"effects.road_bank.bank": 0.01}, {"effects.suspension_friction.front": 50.0},
    )  # fmt: skip
    sets = [known.changed(one) for one in changes]
    predictor.foresee_near(known, sets)
    off, expected_off = Residuals(predictor), Residuals(in_full)
    for near, change in zip(sets, changes, strict=True):
        found, expected, before = (
            np.concatenate(rows) for rows in (off(near), expected_off(near), expected_off(known))
        )
        assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected - before), change
        for again, value in zip(off(known.changed(change)), expected_off(near), strict=True):
            np.testing.assert_array_equal(again, value)


@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_lanes_stay_empty_no_more_than_with_the_fewest_runs(lanes):
    def empty(runs: int) -> float:
        return -runs % lanes / (runs + -runs % lanes)

    for windows in range(1, 60):
        count, fewest = _at_once(windows, lanes), max(1, PREDICTION.side_by_side // windows)
        assert fewest <= count <= 2 * fewest
        assert empty(count * windows) <= empty(fewest * windows)
