"""Rodríguez's table."""

from __future__ import annotations

import json

import pytest

from vsense_ros.thesis import ROWS, repeat, write


@pytest.fixture(scope="module")
def results(plant, model):
    return repeat(plant, model, seeds=(0,))


def test_lateral_dynamics_and_forces_are_better_known_than_in_the_thesis(results):
    for number, found in enumerate(results.values()):
        for row in ROWS:
            if row.name in ("longitudinal_acceleration", "lateral_acceleration", "vertical_acceleration"):
                assert found[row.name].rmse < 1.3 * row.rmse[number]
        assert found["lateral_acceleration"].rmse < 0.2
        assert found["wheel_force_rr_y"].percent < 20.0
        assert found["wheel_force_rr_x"].percent < 41.0
        assert found["wheel_force_rr_z"].percent < 18.0


def test_the_position_converges_below_the_scatter_of_a_fix(results):
    for found in results.values():
        assert found["position_after_step"].rmse < found["position"].rmse
        assert found["position_after_step"].rmse < 1.9075 / 3


def test_the_table_is_written_beside_the_figures_of_the_thesis(results, tmp_path):
    write(results, tmp_path / "out" / "thesis_errorekf.json")
    content = json.loads((tmp_path / "out" / "thesis_errorekf.json").read_text(encoding="utf-8"))
    assert content["rodriguez_2"]["wheel_force_rr_y"]["rodriguez_rmse"] == 265.58
    assert content["rodriguez_1"]["position"]["rmse"] > 0
