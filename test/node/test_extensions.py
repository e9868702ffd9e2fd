"""Extensions that installed packages add to the observer node."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")

from pydantic import BaseModel

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Level
from vsense_ros.node import extensions
from vsense_ros.node.extensions import Extension
from vsense_ros.node.parameters import NodeParameters, declare

ROOT = Path(__file__).parents[2]


class Doubled(Extension):
    """An extension with one parameter."""

    class Parameters(BaseModel):
        """One number."""

        factor: float = 2.0


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> list[EntryPoint]:
    """Entry points of the group, instead of those that are installed."""
    listed: list[EntryPoint] = []
    monkeypatch.setattr(extensions, "entry_points", lambda group: listed)
    extensions.installed.cache_clear()
    yield listed  # type: ignore[misc]
    extensions.installed.cache_clear()


def test_parameters_of_an_extension_become_parameters_of_the_node(entries: list[Any]) -> None:
    entries.append(EntryPoint("doubled", f"{__name__}:Doubled", extensions.GROUP))
    model = extensions.with_extensions(NodeParameters, "Combined")
    assert model(factor=3.0).factor == 3.0  # type: ignore[call-arg, attr-defined]
    assert set(NodeParameters.model_fields) < set(model.model_fields)


def test_an_extension_that_cannot_be_imported_is_a_sentence_and_the_others_work(entries: list[Any]) -> None:
    entries.append(EntryPoint("broken", "no_such_package.module:Broken", extensions.GROUP))
    entries.append(EntryPoint("doubled", f"{__name__}:Doubled", extensions.GROUP))
    found, faults = extensions.installed()
    assert found == (Doubled,)
    assert len(faults) == 1
    assert "no_such_package" in faults[0]
    (line,) = extensions.fault_lines()
    assert line.level == Level.WARN
    assert "broken" in line.message


class Recorder:
    """The part of a ROS node that declares parameters, with values that were given at its start."""

    def __init__(self, **values: Any) -> None:
        self._parameter_overrides = {name: SimpleNamespace(value=value) for name, value in values.items()}
        self.warnings: list[str] = []
        self.declared: list[str] = []

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warnings.append)

    def declare_parameter(self, name: str, *_: Any) -> None:
        self.declared.append(name)


def test_a_parameter_of_an_extension_that_cannot_be_imported_is_a_warning_and_the_node_goes_on(
    entries: list[Any],
) -> None:
    entries.append(EntryPoint("broken", "no_such_package.module:Broken", extensions.GROUP))
    node: Any = Recorder(factor=3.0, autostart=False)
    declare(node, extensions.with_extensions(NodeParameters, "Combined"))
    (warning,) = node.warnings
    assert "'factor'" in warning
    assert "no_such_package" in warning
    assert set(node.declared) == set(NodeParameters.model_fields)


def test_an_unknown_parameter_is_refused_when_every_extension_could_be_imported(entries: list[Any]) -> None:
    entries.append(EntryPoint("doubled", f"{__name__}:Doubled", extensions.GROUP))
    node: Any = Recorder(factr=3.0)
    with pytest.raises(InputError, match="no parameter 'factr'"):
        declare(node, extensions.with_extensions(NodeParameters, "Combined"))


def test_the_observer_node_imports_no_extension_by_itself() -> None:
    code = (
        "from vsense_ros.node import extensions; extensions.entry_points = lambda group: []\n"
        "import sys, vsense_ros.node.observer; print(*sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert ended.returncode == 0, ended.stderr
    modules = ended.stdout.split()
    unwanted = ("vsense_ros.accelerator", "vsense_ros.identification", "foxglove", "vsense_ros.node.observer_")
    assert not [name for name in modules if name.startswith(unwanted)]
