"""The simulated drives of the study of an own car are simulated once, and again when what decides them has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from studies import own_car_plants as plants

KIND = "newton_euler"


@pytest.fixture
def simulations(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Kinds of plants that were simulated, with an empty cache of the user, and lanes of a few rows."""
    begun: list[str] = []

    def simulate(kind: str, cars: Sequence[plants.Hidden]) -> list[plants.Lane]:
        begun.append(kind)
        lanes = range(sum(len(one.courses) for one in cars))
        return [{"spin": np.full((3, 4), i / 4), "position": np.zeros((3, 3))} for i in lanes]

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(plants, "_simulate", simulate)
    return begun


def drives_of_all() -> list[list[float]]:
    group = [one for one in plants.PLANTS if one.kind == KIND]
    return [[lane["spin"][0, 0] for lane in plants.simulated(one, group)[1]] for one in group]


def test_cars_are_simulated_side_by_side_and_read_by_a_second_run(simulations: list[str]) -> None:
    first = drives_of_all()
    assert sorted(value for one in first for value in one) == [i / 4 for i in range(9)]
    assert drives_of_all() == first
    assert simulations == [KIND]


def test_a_car_that_hides_something_else_is_simulated_again(simulations: list[str]) -> None:
    one = plants.PLANTS[0]
    for other in (one, replace(one, name="another name"), replace(one, seed=one.seed + 1)):
        plants.simulated(other, ())
    assert simulations == [KIND, KIND]
