"""The design of the next test: that it ranks manoeuvres as physics does, and says where none would help."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console

from hidden import prototype, without
from synthetic_findings import effect, finding, traces
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.mismatch import design
from vsense_ros.mismatch.answer_schema import Answer, BaseParameter, read_answer
from vsense_ros.mismatch.candidates import base_parameters, out_of_reach
from vsense_ros.mismatch.design import Option, Rival, Separation, left_open, separations
from vsense_ros.mismatch.page import NEXT_TEST, write_report
from vsense_ros.model.vehicle import Vehicle


def choice(*names: str) -> list[Option]:
    return [Option(MANOEUVRES[name]) for name in names]


def rival(effect: str, known: float = 0.05, **sizes: float) -> Rival:
    """With sizes that are known to a share of their own."""
    named = {f"effects.{effect}.{name}": size for name, size in sizes.items()}
    return Rival(effect, named, {name: known * abs(size) for name, size in named.items()})


def untold_torques() -> Vehicle:
    return without(prototype(), "wheel_torques")


@pytest.mark.exam
def test_a_delay_and_a_relaxing_tyre_are_told_apart_by_a_sweep_and_not_by_rolling_out():
    rivals = [rival("tyre_relaxation", front=0.5, rear=0.5), rival("sensor_delay", imu=0.02)]
    best, *_, worst = separations(prototype(), rivals, {}, choice("coast_down", "step_steer", "steering_sweep"))
    assert best.test.manoeuvre.name == "steering_sweep"
    assert worst.test.manoeuvre.name == "coast_down"
    assert worst.distance < 1.0
    assert set(best.pair) == {"tyre_relaxation", "sensor_delay"}


@pytest.mark.slow
def test_an_effect_is_not_told_from_itself():
    same = rival("aero_drag", area=0.3), rival("aero_drag", area=0.3)
    (found,) = separations(prototype(), same, {}, choice("accelerate_and_brake"))
    assert found.distance == pytest.approx(0.0, abs=1e-6)


@pytest.mark.exam
def test_a_size_makes_up_for_a_difference_as_far_as_it_is_uncertain():
    def distance(known: float) -> float:
        sizes = [rival("rolling_resistance", known, coefficient=c) for c in (0.010, 0.012)]
        return separations(prototype(), sizes, {}, choice("accelerate_and_brake"))[0].distance

    assert distance(1.0) < 0.5
    assert distance(1.0) < 0.1 * distance(0.001)


@pytest.mark.exam
def test_a_slope_is_told_from_a_bias_by_driving_the_other_way():
    """Forward, with unknown torques, gravity along the car and a bias of its accelerometer are one and the same."""
    rivals = [rival("road_grade", grade=0.02), rival("accelerometer_bias", x=0.196)]
    straight = MANOEUVRES["accelerate_and_brake"]
    found = separations(untold_torques(), rivals, {}, [Option(straight), Option(straight, opposite=True)])
    again, back = sorted(found, key=lambda one: one.test.opposite)
    assert back.distance > 5 * again.distance
    assert back.signal == "longitudinal_acceleration"


def size(name: str, unit: str, value: float) -> dict:
    return {"name": name, "unit": unit, "value": value, "interval_90": [0.9 * value, 1.1 * value]}


def ambiguous(vehicle: Vehicle, **changes: Any) -> Answer:
    effects = [
        effect("tyre_relaxation", 0.5, axle="front", parameters=[size("front", "m", 0.4)]),
        effect("sensor_delay", 0.5, sensor="imu", parameters=[size("imu", "s", 0.01)]),
        effect("aero_drag", 0.1, parameters=[size("area", "m²", 0.1)]),
    ]
    told = {
        "vehicle": vehicle.name,
        "answer_set": ["tyre_relaxation", "sensor_delay"],
        "rivals": [["tyre_relaxation"], ["sensor_delay"]],
        "effects": effects,
        "base": {"mass": offset(-0.05)},
    }
    return finding("ambiguous", **(told | changes))


def offset(value: float, explained: float | None = None) -> BaseParameter:
    return BaseParameter(unit="-", value=value, explained=explained)


def test_the_rivals_are_those_of_the_answer_set_with_their_fitted_sizes():
    rivals, base = left_open(ambiguous(prototype()), prototype())
    assert [r.name for r in rivals] == ["tyre_relaxation front", "sensor_delay imu"]
    assert rivals[1].sizes == {"effects.sensor_delay.imu": 0.01}
    assert rivals[1].deviations["effects.sensor_delay.imu"] == pytest.approx(0.001 / 1.645)
    assert base == {"mass": -0.05}


def test_of_several_effects_each_the_rivals_are_those_that_stand_together():
    *others, drag = ambiguous(prototype()).effects
    found = ambiguous(
        prototype(),
        rivals=[["aero_drag", "tyre_relaxation"], ["aero_drag", "sensor_delay"]],
        effects=[*others, drag.with_(form="on a plane")],
    )
    rivals, _ = left_open(found, prototype())
    assert [r.name for r in rivals] == [
        "aero_drag on a plane + tyre_relaxation front",
        "aero_drag on a plane + sensor_delay imu",
    ]
    assert rivals[0].sizes == {"effects.aero_drag.area": 0.1, "effects.tyre_relaxation.front": 0.4}
    assert rivals[0].forms == {"effects.aero_drag.area": "on a plane", "effects.tyre_relaxation.front": ""}


def test_only_an_ambiguous_answer_about_this_vehicle_asks_for_another_test():
    with pytest.raises(InputError, match="the verdict is named"):
        left_open(finding("named"), prototype())
    with pytest.raises(InputError, match="the answer is about the vehicle 'another'"):
        left_open(ambiguous(prototype()).with_(vehicle="another"), prototype())
    with pytest.raises(InputError, match="leaves 1 explanations"):
        left_open(ambiguous(prototype(), rivals=[["sensor_delay"]]), prototype())
    with pytest.raises(InputError, match=r"no effect of the library has effects\.ghost\.size"):
        separations(prototype(), [rival("ghost", size=1.0)], {})


def test_the_best_test_is_said_and_stands_in_the_answer(tmp_path):
    ambiguous(prototype()).write(tmp_path)
    sweep, step = choice("steering_sweep", "step_steer")
    found = [Separation(sweep, 12.0, "yaw_rate", ("a", "b")), Separation(step, 1.0, "speed", ("a", "b"))]
    design.written(found, [Rival("a", {}, {}), Rival("b", {}, {})], tmp_path)
    answer = read_answer(tmp_path)
    assert answer.would_separate.manoeuvre == "Steering sweep"
    assert answer.would_separate.information == pytest.approx(72.0)
    assert [one["id"] for one in json.loads((tmp_path / "next.json").read_text(encoding="utf-8"))["tests"]] == [
        "steering_sweep",
        "step_steer",
    ]
    assert "Drive: Steering sweep (ISO 7401" in said(found)
    assert "None of these tests would tell them apart" in said(found[1:])
    design.written(found[1:], [], tmp_path)
    assert read_answer(tmp_path).would_separate is None


def test_the_car_of_the_next_test_is_as_it_was_fitted_with_what_was_found():
    base = {"mass": offset(-0.05, 0.01), "yaw inertia": offset(0.3, None)}
    _, offsets = left_open(ambiguous(prototype(), base=base), prototype())
    assert offsets == {"mass": 0.01, "yaw inertia": 0.3}


@pytest.mark.parametrize(
    "lacking", [(), ("wheel_torques",), ("wheel_torques", "wheel_speeds")], ids=["all", "no torques", "GNSS alone"]
)
def test_the_next_test_has_the_sensors_and_the_base_parameters_of_the_recordings(lacking):
    had = without(prototype(), *lacking)
    kinds = {sensor.kind for sensor in had.sensors.values()}
    fitted = [parameter.name for parameter in base_parameters(had, out_of_reach(kinds), kinds)]
    vehicle, free_parameters = design._as_recorded(prototype(), dict.fromkeys(fitted, 0.0))
    assert vehicle.sensors == had.sensors
    assert [parameter.name for parameter in free_parameters] == fitted


def test_the_page_says_the_test_that_was_designed_and_nothing_else_on_it_changes(tmp_path):
    found, page = finding("ambiguous"), tmp_path / "report.html"
    told = {"answer_set": ["a", "b"], "would_separate": found.would_separate}
    found = found.with_(effects=[one.with_(**told) for one in found.effects])
    found.write(tmp_path)
    write_report(found, traces("ambiguous"), page)
    before = page.read_text(encoding="utf-8")
    assert "steady turn on a banked road; watch the lateral acceleration" in before
    (sweep,) = choice("steering_sweep")
    design.written([Separation(sweep, 12.0, "yaw_rate", ("a", "b"))], [], tmp_path)
    after = page.read_text(encoding="utf-8")
    assert "Steering sweep; watch the yaw rate (d′ 12.0 predicted)" in after
    assert "steady turn on a banked road" not in after
    assert {one.would_separate.manoeuvre for one in read_answer(tmp_path).effects} == {"Steering sweep"}
    assert NEXT_TEST.split(before) == NEXT_TEST.split(after)
    design.written([], [], tmp_path)
    assert "No test is known that would tell them apart." in page.read_text(encoding="utf-8")


def said(found: list[Separation]) -> str:
    console = Console(record=True, width=110, file=open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    design.printed(found, console)
    return console.export_text()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no answer there yet"),
        ("{", "not what vsense explain writes"),
        ("[]", "it has no verdict"),
        ('{"verdict": "ambiguous"}', "of an earlier version, without a number; expected version 1"),
        ('{"verdict": "ambiguous", "version": 7}', "of version 7; expected version 1"),
        ('{"verdict": "ambiguous", "version": 1}', "sentence: Field required"),
    ],
)
def test_without_an_answer_the_user_is_told_what_to_run(tmp_path: Path, content, message):
    if content is not None:
        (tmp_path / "explain.json").write_text(content, encoding="utf-8")
    save_vehicle(tmp_path / "car.yaml", prototype())
    arguments = ["explain", "--next", "--vehicle", str(tmp_path / "car.yaml"), "--report", str(tmp_path)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert message in re.sub(r"\s+", " ", result.output)
