"""What is installed with the package, and what a user reads where an optional package is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from vsense_ros.extras import MODULES

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "step_steer"

_BLOCKED = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None
from vsense_ros.cli import main
sys.argv = ["vsense", *{arguments!r}]
main()
"""


def run_without(blocked: tuple[str, ...], *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command `vsense` in a process in which some packages cannot be imported."""
    code = _BLOCKED.format(blocked=blocked, arguments=[str(argument) for argument in arguments])
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250, cwd=ROOT)


def names_in(file: str) -> set[str]:
    lines = (ROOT / "requirements" / f"{file}.txt").read_text(encoding="utf-8").splitlines()
    return {match.group() for line in lines if (match := re.match(r"[A-Za-z0-9._-]+", line))}


def test_the_package_depends_on_fourteen_others_at_most() -> None:
    assert len(names_in("core")) <= 14


@pytest.mark.parametrize("extra", MODULES)
def test_every_extra_has_a_requirement_file_that_all_includes(extra: str) -> None:
    assert names_in(extra)
    assert f"-r {extra}.txt" in (ROOT / "requirements" / "all.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("extra", "arguments"),
    [
        ("reports", ("tyres", "--out", "{out}")),
        pytest.param("fmu", ("export", "fmu", "prototype_model", "--output", "{out}/car.fmu"), marks=pytest.mark.exam),
        ("foxglove", ("view", BAG)),
        pytest.param("fleet", ("explain", "--fleet", ROOT / "bags", "--report", "{out}/fleet"), marks=pytest.mark.exam),
    ],
)
def test_a_command_without_its_extra_says_in_one_sentence_what_to_install(
    extra: str, arguments: tuple[object, ...], tmp_path: Path
) -> None:
    ended = run_without(MODULES[extra], *(str(argument).format(out=tmp_path) for argument in arguments))
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("\n") == 1, ended.stderr
    assert f"pip install 'vsense_ros[{extra}]'" in ended.stderr


def test_a_recording_that_only_an_extra_reads_names_that_extra(tmp_path: Path) -> None:
    recording = tmp_path / "drive.csv"
    recording.write_text("time,speed\n0.0,1.0\n0.1,1.1\n", encoding="utf-8")
    ended = run_without(MODULES["formats"], "import", recording, tmp_path / "bag")
    assert ended.returncode == 2, ended.stderr
    assert "pip install 'vsense_ros[formats]'" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_an_estimate_needs_no_extra(tmp_path: Path) -> None:
    """A vehicle has the core alone: estimating a bag works where no optional package can be imported."""
    optional = (*(module for modules in MODULES.values() for module in modules), "pandas")
    ended = run_without(optional, "run", BAG, "--vehicle", "prototype_model", "--out", tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "summary.json").is_file()


def test_the_observer_node_imports_neither_pictures_nor_clusters_nor_tables() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    code = "import sys, vsense_ros.node.observer; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert ended.returncode == 0, ended.stderr
    optional = {module for modules in MODULES.values() for module in modules} | {"pandas", "dask"}
    assert not optional & set(ended.stdout.split())
