"""Mutants of a package: turned operators, comparisons and conditions, and what becomes of them under its tests."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = '''"""Doc."""


def halved(x: int | None, least: float = -1.0) -> float | None:
    """A number or none."""
    other: float | None = None
    if x is None or x < least:
        return other
    return x / 2
'''


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    pytest.importorskip("cosmic_ray", reason="needs requirements/mutants.txt")
    sys.path.insert(0, str(ROOT / "tools"))
    return importlib.import_module("mutants")


@pytest.fixture
def package(tmp_path: Path, tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one package, two of its mutants noticed by a test."""
    (tmp_path / "vsense_ros").mkdir()
    (tmp_path / "vsense_ros/__init__.py").touch()
    (tmp_path / "vsense_ros/halving.py").write_text(SOURCE)
    (tmp_path / "test").mkdir()
    test = "from vsense_ros.halving import halved\n\n\ndef test_it():\n    assert halved(3) == 1.5\n"
    (tmp_path / "test/test_halving.py").write_text(test)
    for name in tool.SINGLE:
        (tmp_path / name).write_text("")
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\nmarkers = ["slow", "exam"]\n')
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    return tmp_path


def test_operators_comparisons_and_conditions_are_turned_and_annotations_are_not(
    package: Path, tool: ModuleType
) -> None:
    found = tool.mutants(package / "vsense_ros")
    assert sorted((one.start_pos[0], one.operator_name.removeprefix("core/")) for one in found) == [
        (4, "ReplaceUnaryOperator_Delete_USub"),
        (7, "AddNot"),
        (7, "ReplaceComparisonOperator_Is_IsNot"),
        (7, "ReplaceComparisonOperator_Lt_GtE"),
        (7, "ReplaceOrWithAnd"),
        (9, "ReplaceBinaryOperator_Div_Mul"),
    ]
    assert [one.start_pos[0] for one in tool.mutants(package / "vsense_ros", ["halving.py:9"])] == [9]


def test_the_fast_tests_kill_what_they_notice_and_the_sources_stay(package: Path, tool: ModuleType) -> None:
    rows = tool.examine("vsense_ros", "test", 100, 1, ["halving.py:4", "halving.py:9"], 1)
    assert {row["line"]: row["killed"] for row in rows} == {4: False, 9: True}
    assert tool.killed_percent(rows) == 50.0
    assert (package / "vsense_ros/halving.py").read_text() == SOURCE
