"""`make check` runs the tests that a change is likeliest to break."""

from __future__ import annotations

import runpy
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
FILES = {
    "vsense_ros/__init__.py": "",
    "vsense_ros/wheel.py": "",
    "vsense_ros/car.py": "from vsense_ros.wheel import radius",
    "vsense_ros/page.py": "TEMPLATE = 'page.html'",
    "vsense_ros/page.html": "<p/>",
    "test/test_page.py": "from vsense_ros import page",
    "test/test_car.py": "import vsense_ros.car",
    "test/parts/test_wheel.py": "from helper import round\nfrom vsense_ros import wheel",
    "test/parts/helper.py": "",
    "test/parts/conftest.py": "",
}


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    return runpy.run_path(str(TOOLS / "changed_tests.py"))


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small repository in which everything is committed to main."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for command in (["init", "-q", "-b", "main"], ["add", "-A"], ["commit", "-q", "-m", "everything"]):
        git(tmp_path, *command)
    return tmp_path


def git(tree: Path, *arguments: str) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@example.com"]
    subprocess.run(["git", "-C", str(tree), *who, *arguments], check=True)


@pytest.mark.parametrize(
    ("change", "tests"),
    [
        ("vsense_ros/wheel.py", ["test/parts/test_wheel.py", "test/test_car.py"]),
        ("vsense_ros/car.py", ["test/test_car.py"]),
        ("vsense_ros/page.html", ["test/test_page.py"]),
        ("test/parts/helper.py", ["test/parts/test_wheel.py"]),
        ("test/parts/conftest.py", ["test/parts/test_wheel.py"]),
        ("test/test_page.py", ["test/test_page.py"]),
        ("README.md", []),
    ],
)
def test_tests_come_in_the_order_of_their_distance_from_a_change(
    tool: dict[str, Any], tree: Path, change: str, tests: list[str]
) -> None:
    assert tool["nearest"]([change], tool["imports"](tree), tree) == tests


def test_committed_uncommitted_and_new_files_count_from_where_main_was_left(tool: dict[str, Any], tree: Path) -> None:
    git(tree, "checkout", "-q", "-b", "work")
    (tree / "vsense_ros/wheel.py").write_text("radius = 0.3")
    git(tree, "commit", "-q", "-a", "-m", "a radius")
    (tree / "vsense_ros/car.py").write_text("")
    (tree / "test/test_new.py").write_text("")
    assert tool["changed"](tree) == {"vsense_ros/wheel.py", "vsense_ros/car.py", "test/test_new.py"}


def test_on_a_main_without_changes_the_last_commit_counts(tool: dict[str, Any], tree: Path) -> None:
    (tree / "vsense_ros/car.py").write_text("")
    git(tree, "commit", "-q", "-a", "-m", "no wheels")
    assert tool["changed"](tree) == {"vsense_ros/car.py"}


@pytest.mark.parametrize(("left", "word"), [(-1.0, "1 skipped"), (600.0, "1 passed")])
def test_a_test_begins_only_before_the_time_is_over(tmp_path: Path, left: float, word: str) -> None:
    (tmp_path / "test_one.py").write_text("def test_one(): pass")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "deadline", f"--until={time.time() + left}", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(TOOLS)}, capture_output=True, text=True)
    assert word in done.stdout, done.stdout + done.stderr
