"""The plan for many drives in a night: what is simulated keeps to the bounds that any schedule has."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plan() -> ModuleType:
    sys.path.insert(0, str(ROOT / "tools"))
    return importlib.import_module("fleet_plan")


def test_equal_drives_on_cores_that_stay_take_as_many_rounds_as_there_are(plan: ModuleType) -> None:
    night = replace(plan.Night(), taken_away=1e-9, spread=0.0)
    found = plan.simulated(night, plan.Drive(3600.0, 1.0, 1.0), 10, 4)
    assert (found.hours, found.repeated) == (pytest.approx(3.0), 0)
    assert found.useful == pytest.approx(10 / 12)


def test_as_many_drives_are_begun_again_as_a_constant_rate_of_losses_makes(plan: ModuleType) -> None:
    night = replace(plan.Night(), taken_away=0.5, spread=0.0)
    found = plan.simulated(night, plan.Drive(360.0, 1.0, 1.0), 20_000, 100)
    expected = 20_000 * (2.718281828 ** (0.5 * 0.1) - 1)  # losses until one lasts: geometric
    assert found.repeated == pytest.approx(expected, rel=0.1)


def test_a_plan_takes_the_place_of_the_one_before(plan: ModuleType) -> None:
    once = plan.with_section("# Page\n\ntext\n", f"{plan.TITLE}\n\nfirst\n")
    assert plan.with_section(once, f"{plan.TITLE}\n\nsecond\n") == f"# Page\n\ntext\n\n{plan.TITLE}\n\nsecond\n"
