"""The package as others see it: manifest, build description, launch files, dependencies."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import types
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import setuptools

ROOT = Path(__file__).parents[2]
NODES = sorted(path.stem for path in (ROOT / "vsense_ros" / "node").glob("*.py") if "\ndef main(" in path.read_text())


def manifest() -> ElementTree.Element:
    return ElementTree.parse(ROOT / "package.xml").getroot()


def test_the_manifest_is_one_that_colcon_takes_for_a_ros_package() -> None:
    catkin_pkg = pytest.importorskip("catkin_pkg.package", reason="catkin_pkg is not installed here")
    package = catkin_pkg.parse_package(str(ROOT))
    warnings: list[str] = []
    package.validate(warnings=warnings)
    assert not warnings
    assert package.package_format == 3
    assert [e.content for e in package.exports if e.tagname == "build_type"] == ["ament_python"]
    assert package.licenses == ["Apache-2.0"]


def test_manifest_citation_changelog_and_build_description_state_the_same_version() -> None:
    def stated(file: str, pattern: str) -> str:
        match = re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
        assert match is not None, f"{file} states no version"
        return match[1]

    version = manifest().findtext("version")
    assert stated("setup.py", r'version="([^"]+)"') == version
    assert stated("CITATION.cff", r"^version: (\S+)$") == version
    assert stated("CHANGELOG.md", r"^## (\d\S+) – \d{4}-\d{2}-\d{2}$") == version


def test_versions_are_pinned_in_the_requirement_files_alone() -> None:
    names = set()
    for path in sorted((ROOT / "requirements").glob("*.txt")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line and not line.startswith(("#", "-r ")):
                assert re.search(r"==|<", line), f"{path.name}: {line!r} has no version"
                assert "://" not in line
                name = re.split(r"[\[=<>]", line)[0].lower()
                assert name not in names, f"{name} is listed twice"
                names.add(name)
    assert not re.search(r"==\d", (ROOT / "setup.py").read_text(encoding="utf-8"))


def described_by_setup(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    described: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **settings: described.update(settings))
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "setup.py"))
    return described


def test_every_file_of_the_package_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    patterns = described_by_setup(monkeypatch)["package_data"]
    installed: set[Path] = set()
    for folder in (path.parent for path in (ROOT / "vsense_ros").rglob("__init__.py")):
        package = ".".join(folder.relative_to(ROOT).parts)
        for pattern in ("*.py", *patterns[""], *patterns.get(package, ())):
            installed.update(folder.glob(pattern))
    for path in sorted((ROOT / "vsense_ros").rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            assert path in installed, f"setup.py leaves {path.relative_to(ROOT)} out"


def test_studies_and_tests_are_no_part_of_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    described = described_by_setup(monkeypatch)
    assert {name.partition(".")[0] for name in described["packages"]} == {"vsense_ros"}


@pytest.mark.parametrize("name", ["vsense", *NODES])
def test_every_command_of_the_package_leads_to_a_function(name: str) -> None:
    (command,) = [e for e in entry_points(group="console_scripts", name=name) if e.value.startswith("vsense_ros")]
    if command.value.startswith("vsense_ros.node"):
        pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    assert callable(command.load())


def test_the_nodes_of_a_drive_are_among_those_that_become_executables() -> None:
    assert {"can_driver", "imu_driver", "gps_driver", "observer", "replay", "recorder"} <= set(NODES)


def test_the_core_imports_without_ros() -> None:
    """Nothing outside `node/` may name a ROS package, except to find out whether there is one."""
    ros = {"rclpy", "sensor_msgs", "geometry_msgs", "nav_msgs", "std_msgs", "diagnostic_msgs", "builtin_interfaces"}
    for path in sorted((ROOT / "vsense_ros").rglob("*.py")):
        if "node" in path.relative_to(ROOT).parts:
            continue
        for item in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in item.names] if isinstance(item, ast.Import) else []
            names += [item.module or ""] if isinstance(item, ast.ImportFrom) else []
            assert not ros & {name.partition(".")[0] for name in names}, f"{path.relative_to(ROOT)}:{item.lineno}"


class _Anything:
    """Stands for any class or value of launch; remembers what it was made with."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        self.args, self.kwargs = args, kwargs


@pytest.fixture
def launch_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """`launch` comes with apt's ROS alone; here its names are stood in for, also where it is there, as its own classes
    do not tell what they were made with."""
    for name in (
        "launch",
        "launch.actions",
        "launch.event_handlers",
        "launch.events",
        "launch_ros",
        "launch_ros.actions",
        "launch_ros.parameter_descriptions",
    ):
        module = types.ModuleType(name)
        module.__getattr__ = lambda _: _Anything  # type: ignore[method-assign]
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "vsense_ros.node.launching", raising=False)


class _Asked(dict[str, str]):
    """Values of launch arguments; remembers which were looked at."""

    def __init__(self, values: dict[str, str]) -> None:
        super().__init__(values)
        self.seen: set[str] = set()

    def __getitem__(self, name: str) -> str:
        self.seen.add(name)
        return super().__getitem__(name)


@pytest.mark.usefixtures("launch_stand_in")
@pytest.mark.parametrize("name", ["replay", "vehicle", "accelerated"])
def test_launch_files_start_nodes_with_parameters_that_these_have(name: str) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    from vsense_ros.node.document import parameter_models
    from vsense_ros.node.launching import COMMON, Given

    models = parameter_models()
    scope: dict[str, Any] = {}
    exec(compile((ROOT / "launch" / f"{name}.launch.py").read_text(encoding="utf-8"), name, "exec"), scope)
    every = {**scope["ARGUMENTS"], **COMMON}
    given = _Asked({argument: default or "something" for argument, (default, _) in every.items()})
    for argument in ("dbc", "imu_port", "gnss_port", "record", "bag", "params_file"):
        given.update({argument: "something"} if argument in given else {})
    given |= {"namespace": "car1", "rate": "100.0"}
    given.update({"map_origin": "48.1,11.5,500"} if "map_origin" in given else {})
    nodes = [a for a in scope["actions"](Given(given)) if "executable" in getattr(a, "kwargs", {})]
    assert nodes
    for node in nodes:
        file, parameters = node.kwargs["parameters"]
        assert file == "something"
        unknown = set(parameters) - {"use_sim_time"} - set(models[node.kwargs["executable"]].model_fields)
        assert not unknown, f"{node.kwargs['executable']}: {unknown}"
        assert ("diagnostics", "/diagnostics") in node.kwargs["remappings"]
    assert given.seen >= set(every) - {"discovery"}


@pytest.mark.usefixtures("launch_stand_in")
def test_a_launch_argument_that_is_no_number_is_named() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    from vsense_ros.node.launching import Given

    with pytest.raises(RuntimeError, match=r"rate:=fast: expected a number"):
        Given({"rate": "fast"}).number("rate")
