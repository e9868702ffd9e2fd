"""Filters beside the observer, without ROS: what each listens to and says."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import vsense_ros as vs
from vsense_ros.files.installed import vehicle_path
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.diagnostic import Level

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")

from vsense_ros.node.observer_mass import Mass
from vsense_ros.node.observer_trailer import TrailerBehind
from vsense_ros.node.observer_tyres import Tyres


@pytest.fixture
def towing(tmp_path: Path) -> Path:
    """A vehicle file with a trailer, and a sensor of its articulation."""
    content = yaml.safe_load(vehicle_path("rav4").read_text(encoding="utf-8"))
    content["physics"]["trailer"] = {"mass": 1400}
    content["sensors"]["hitch"] = {"kind": "articulation"}
    path = tmp_path / "towing.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.mark.slow
def test_each_is_wanted_by_its_parameter_and_the_trailer_s_says_what_its_sensors_tell(towing: Path) -> None:
    none: dict[str, Any] = {"vehicle": str(towing), "mass": False, "tyres": "", "trailer": False}
    some = SimpleNamespace(**{**none, "trailer": True})
    assert not any(kind.is_wanted(SimpleNamespace(**none)) for kind in (Mass, Tyres, TrailerBehind))
    assert [kind.is_wanted(some) for kind in (Mass, Tyres, TrailerBehind)] == [False, False, True]
    car = vs.load_vehicle(towing)
    beside = TrailerBehind(SimpleNamespace(), some, car)  # type: ignore[arg-type]
    assert "vehicle/articulation" in beside.inputs
    recording = generate("trailer_sway", car)
    said = [made for sample in recording.samples() for made in beside.add(sample)]
    assert {sample.topic for sample in said} == set(beside.outputs)
    assert "articulation" in said[-1].names
    (line,) = beside.diagnostics()
    assert line.level == Level.OK
    assert "damping ratio" in line.message
