"""A new node is one file: the package makes an executable of it, and the page of the nodes has its parameters."""

from __future__ import annotations

import runpy
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NODE = '''
"""Odometer: how far the car has gone, from `vsense/odometry`."""
from pydantic import Field
from vsense_ros.node.parameters import NodeParameters

class OdometerParameters(NodeParameters):
    start: float = Field(0.0, description="kilometres at the beginning")

def main() -> int:
    return 0
'''


@pytest.fixture
def odometer(tmp_path: Path) -> Path:
    """The file of a node that has just been written."""
    path = tmp_path / "odometer.py"
    path.write_text(NODE)
    return path


def test_the_package_makes_an_executable_of_it(odometer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(ROOT / "vsense_ros" / "node", tmp_path / "vsense_ros" / "node")
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    shutil.copy(odometer, tmp_path / "vsense_ros" / "node")
    for file in ("setup.py", "README.md"):
        shutil.copy(ROOT / file, tmp_path)
    for folder in ("config", "launch", "bags"):
        (tmp_path / folder).mkdir()
    described: dict[str, dict[str, list[str]]] = {}
    monkeypatch.setattr("setuptools.setup", described.update)
    runpy.run_path(str(tmp_path / "setup.py"))
    assert "odometer = vsense_ros.node.odometer:main" in described["entry_points"]["console_scripts"]


@pytest.fixture
def in_its_folder(odometer: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    from vsense_ros import node

    monkeypatch.setattr(node, "__path__", [*node.__path__, str(odometer.parent)])
    yield
    sys.modules.pop("vsense_ros.node.odometer", None)


@pytest.mark.usefixtures("in_its_folder")
def test_the_page_of_the_nodes_has_its_parameters() -> None:
    from vsense_ros.node.document import page

    part = page().partition("## odometer")[2].partition("\n## ")[0]
    assert "how far the car has gone" in part
    assert "kilometres at the beginning" in part
