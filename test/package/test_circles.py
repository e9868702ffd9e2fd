"""tools/circles.py: which modules import each other in a circle."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from circles import circles, groups_in_circles, import_graph


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "vsense_ros"
    (folder / "inner").mkdir(parents=True)
    for name in ("__init__", "inner/__init__"):
        (folder / f"{name}.py").write_text("")
    return folder


def test_imports_for_type_checkers_and_within_functions_close_a_circle(package: Path):
    (package / "a.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from vsense_ros.b import B\n"
    )
    (package / "b.py").write_text("def f():\n    from vsense_ros.inner import c\n")
    (package / "inner/c.py").write_text("from ..a import A\n")
    (package / "d.py").write_text("import vsense_ros.a\nimport numpy\n")
    assert circles(package.parent) == [["vsense_ros.a", "vsense_ros.b", "vsense_ros.inner.c"]]


def test_a_name_that_is_no_module_is_an_import_of_the_package_that_has_it(package: Path):
    (package / "inner/__init__.py").write_text("from vsense_ros.inner.c import value\n")
    (package / "inner/c.py").write_text("value = 1\n")
    (package / "a.py").write_text("from vsense_ros.inner import c, value\n")
    graph = import_graph(package)
    assert graph["vsense_ros.a"] == {"vsense_ros.inner", "vsense_ros.inner.c"}
    assert groups_in_circles(graph) == []


def test_two_circles_with_a_common_node_are_one_group():
    graph = {"a": {"b"}, "b": {"a", "c"}, "c": {"b"}, "d": {"a"}, "e": {"f"}, "f": {"e"}}
    assert groups_in_circles(graph) == [["a", "b", "c"], ["e", "f"]]
