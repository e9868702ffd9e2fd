"""The measures of the code base are those that their descriptions promise."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def house() -> ModuleType:
    pytest.importorskip("radon", reason="needs requirements/dev.txt")
    sys.path.insert(0, str(ROOT / "tools"))
    return importlib.import_module("house")


SOURCE = '''"""The same as before."""
LIMIT, _OTHER = 3.0, "word"
Array = list[float]

class Settings:
    """Whether it works."""
    RATE = 7.0

def step(x: float) -> float:
    """Of a step."""
    return 3.5 * x + 2 if x > 0 and x < 9 else 1
'''


def test_constants_are_names_in_capitals_at_the_top_of_a_module(house: ModuleType) -> None:
    assert house.constants(ast.parse(SOURCE)) == ["LIMIT", "_OTHER"]


def test_numbers_in_functions_are_counted_but_for_those_that_decide_nothing(house: ModuleType) -> None:
    assert house.literals(ast.parse(SOURCE)) == 2  # 3.5 and 9


def test_docstrings_that_are_no_sentences_are_counted(house: ModuleType) -> None:
    assert house.fragments(ast.parse(SOURCE)) == 3


def test_complexity_counts_conditions_and_their_parts(house: ModuleType) -> None:
    module = house.Module(Path("step.py"), SOURCE)
    assert list(house.complexities(module)) == [(3, "step.py:step")]


def test_hard_dependencies_are_those_of_the_installed_package(house: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "setup.py").write_text(
        "from setuptools import setup\nsetup(name='x', install_requires=['a', 'b>=1'])\n"
    )
    assert house.hard_dependencies(tmp_path) == 2


def test_what_has_not_been_measured_is_neither_reached_nor_missed(house: ModuleType) -> None:
    lines = house.TABLE["lines"]
    assert [lines.reached(value) for value in (None, 58_000, 58_001)] == [None, True, False]
    assert house.TABLE["mutants_killed_percent"].reached(85.0)
