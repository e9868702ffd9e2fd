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


def test_a_second_run_reads_the_drives_of_each_car_in_their_order(simulations: list[str]) -> None:
    for _ in range(2):
        plants.simulated.cache_clear()
        drives = plants.simulated(KIND)
    assert simulations == [KIND]
    read = [[lane["spin"][0, 0] for lane in lanes] for _, lanes in drives.values()]
    np.testing.assert_allclose(read, np.arange(9).reshape(3, 3) / 4)


def test_a_car_that_hides_something_else_is_simulated_again(
    simulations: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plants.simulated.cache_clear()
    plants.simulated(KIND)
    monkeypatch.setattr(plants, "PLANTS", tuple(replace(one, seed=one.seed + 1) for one in plants.PLANTS))
    plants.simulated.cache_clear()
    plants.simulated(KIND)
    plants.simulated.cache_clear()
    assert simulations == [KIND, KIND]
