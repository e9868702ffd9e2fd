"""A vehicle file from catalogue values: cars that are known, what cannot be, and what the numbers' uncertainties do."""

from __future__ import annotations

from math import degrees
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import assume, given
from hypothesis import strategies as st

import vsense_ros as vs
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle, save_vehicle
from vsense_ros.identification.characterise import by_file
from vsense_ros.manoeuvre.driver import understeer_gradient
from vsense_ros.mismatch.candidates import base_parameters
from vsense_ros.model.constants import GRAVITY
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import NewVehicle, new_vehicle, write_new_vehicle
from vsense_ros.prepare.rules import KINDS
from vsense_ros.prepare.tyre_size import tyre_size

GOLF = {"mass": 1395.0, "wheelbase": 2.63, "track": 1.54, "axle_load_front": 820.0, "tyre": "205/55R16 91V"}


def golf(**changes: object) -> NewVehicle:
    return new_vehicle(catalogue_values(**{**GOLF, **changes}))


def command(path: Path, *arguments: str):
    return CliRunner().invoke(main, ["new-vehicle", str(path), *arguments])


def test_the_file_holds_what_was_given_and_loads_again_as_it_was_made(tmp_path):
    new = golf(steering_ratio=14.1)
    write_new_vehicle(tmp_path / "golf.yaml", new)
    loaded = load_vehicle(tmp_path / "golf.yaml")
    assert loaded == new.vehicle
    chassis = loaded.physics.chassis
    assert chassis.mass == 1395.0
    assert chassis.cog_to_front_axle + chassis.cog_to_rear_axle == pytest.approx(2.63, abs=1e-3)
    assert chassis.mass * chassis.cog_to_rear_axle / 2.63 == pytest.approx(820.0, rel=1e-3)
    assert loaded.physics.steering.ratio == 14.1


def test_every_number_of_the_body_and_the_axles_has_a_deviation_in_the_file_and_beside_the_number(tmp_path):
    new = golf()
    write_new_vehicle(tmp_path / "golf.yaml", new)
    text = (tmp_path / "golf.yaml").read_text(encoding="utf-8")
    stated = new.vehicle.deviations()
    exact = {"dynamic_radius_factor"}  # of the model's definition of a rolling radius
    for name in new.vehicle.values():
        leaf = name.rpartition(".")[2]
        if ".tyre." not in name and name.startswith(("chassis", "front", "rear", "steering")) and leaf not in exact:
            assert name in stated
    assert "mass: 1395.0" in text
    assert "± 56 kg (given)" in text
    assert "NHTSA" in new.vehicle.uncertainty["physics.chassis.yaw_inertia"].source


@pytest.mark.parametrize(
    ("name", "car", "known"),
    [
        # Radii of gyration and heights as measured for NHTSA (Allen et al. 1992, as CommonRoad's vehicles 1 and 2).
        ("Ford Escort", {"mass": 1226, "wheelbase": 2.391, "track": 1.389, "axle_load_front": 773, "tyre": "175/70R13"},
         {"yaw_inertia": 1539, "cog_height": 0.557}),
        ("BMW 320i", {"mass": 1093, "wheelbase": 2.578, "track": 1.40, "axle_load_front": 603, "tyre": "195/60R14",
                      "driven": "rear"}, {"yaw_inertia": 1792, "cog_height": 0.575}),
        # Mass, yaw inertia and axle distances as its maker states them (MPC-Berkeley/genesis_path_follower).
        ("Hyundai Genesis", {"mass": 2303, "wheelbase": 3.02, "track": 1.63, "axle_load_front": 1143,
                             "tyre": "245/45R18 100", "driven": "rear"}, {"yaw_inertia": 5520}),
    ],
)  # fmt: skip
def test_what_was_measured_on_a_car_lies_within_two_deviations_of_its_file(name, car, known):
    new = new_vehicle(catalogue_values(name=name, **car))
    for parameter, measured in known.items():
        value, deviation = (
            new.vehicle.values()[f"chassis.{parameter}"],
            new.vehicle.deviations()[f"chassis.{parameter}"],
        )
        assert abs(value - measured) < 2 * deviation, (parameter, value, deviation)


@pytest.mark.parametrize("kind", KINDS)
def test_a_car_of_each_kind_understeers_and_rolls_as_such_cars_do(kind):
    racer = {"mass": 280.0, "wheelbase": 1.55, "track": 1.2, "axle_load_front": 140.0, "tyre": "16x7.5-10"}
    car = golf(**(racer if kind == "formula-student" else {}), like=kind).vehicle
    gradient = degrees(understeer_gradient(car) * GRAVITY)
    low, high = (-1.0, 1.5) if kind == "formula-student" else (0.5, 5.0)
    assert low < gradient < high
    physics, chassis = car.physics, car.physics.chassis
    arm = chassis.cog_height - (physics.front.roll_centre_height + physics.rear.roll_centre_height) / 2
    stiffness = sum(
        (axle.suspension_stiffness + 2 * axle.antiroll_stiffness) * axle.track**2 / 2
        for axle in (physics.front, physics.rear)
    )
    roll = degrees(chassis.mass * GRAVITY * arm / (stiffness - chassis.mass * GRAVITY * arm))
    assert (0.3 if kind == "formula-student" else 2.5) < roll < 8.0


def test_the_tyre_has_the_radius_of_its_designation_and_the_stiffness_of_a_measured_one():
    size = tyre_size("205/60R15 91V")
    assert size.radius == pytest.approx(0.205 * 0.6 + 0.0254 * 15 / 2)
    assert size.stated_load / GRAVITY == pytest.approx(615, rel=0.01)  # ETRTO's table of load indices
    assert size.usual_load == pytest.approx(size.stated_load, rel=0.05)
    front = new_vehicle(catalogue_values(**{**GOLF, "tyre": "205/60R15 91V"})).vehicle.physics.front
    # Pacejka 2012, appendix 3: this size has 46 kN/rad under 4 kN.
    assert float(front.tyre.cornering_stiffness_at(4000.0)) == pytest.approx(46e3, rel=0.05)
    assert 180e3 < front.tyre_stiffness < 270e3


@pytest.mark.parametrize("text", ["", "205", "205/55", "16x7.5", "10x7.5-16", "tyre", "205-55-16"])
def test_what_is_no_size_of_a_tyre_is_refused_with_an_example(text):
    with pytest.raises(InputError, match="205/55R16"):
        tyre_size(text)


@given(
    mass=st.floats(700, 3000), wheelbase=st.floats(2.2, 3.6), share=st.floats(0.45, 0.62), track=st.floats(1.35, 1.75),
    kind=st.sampled_from(["compact", "saloon", "suv", "van"]), width=st.sampled_from([175, 205, 235, 265]),
)  # fmt: skip
def test_any_car_of_a_catalogue_gives_a_valid_file_or_a_sentence(mass, wheelbase, share, track, kind, width):
    car = catalogue_values(
        mass=mass, wheelbase=wheelbase, track=track, axle_load_front=share * mass, tyre=f"{width}/60R16", like=kind
    )
    try:
        new = new_vehicle(car)
    except InputError as error:
        assume("\n" not in str(error))
        return
    load = mass * share * GRAVITY / 2
    assert 5.0 < by_file(new.vehicle, "front")[1] / load < 20.0
    assert min(number.deviation for number in new.numbers.values()) > 0


def test_a_command_without_what_is_needed_names_it_in_one_sentence(tmp_path):
    result = command(tmp_path / "car.yaml", "--mass", "1395", "--track", "1.54")
    assert result.exit_code == 2
    assert result.stderr.strip() == "vsense: a new vehicle needs --wheelbase, --tyre as well; a catalogue has them"
    assert not (tmp_path / "car.yaml").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wheelbase": 2630.0}, "--wheelbase.*lengths in m"),
        ({"axle_load_front": 8040.0}, "--axle-load-front.*kg"),
        ({"mass": 13_685.0, "axle_load_front": 8044.0}, "--tyre.*kg"),
        ({"tyre": "205/55"}, "--tyre.*205/55R16"),
    ],
)
def test_values_in_other_units_are_refused_with_what_was_expected(changes, words):
    with pytest.raises(InputError, match=words):
        golf(**changes)


def test_a_file_that_exists_is_only_replaced_by_force(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("mine", encoding="utf-8")
    arguments = ["--mass", "1395", "--wheelbase", "2.63", "--track", "1.54", "--tyre", "205/55R16"]
    assert command(path, *arguments).exit_code == 2
    assert path.read_text(encoding="utf-8") == "mine"
    assert command(path, *arguments, "--force").exit_code == 0
    assert load_vehicle(path).name == "car"


def test_a_car_whose_recording_has_a_velocity_in_its_axes_has_the_sensor_for_it(tmp_path):
    drive = tmp_path / "drive.csv"
    drive.write_text("t,v,w\n0.0,20.0,0.1\n0.1,20.0,0.2\n0.2,20.1,0.2\n", encoding="utf-8")
    columns = "[{column: v, unit: m/s}, {column: w, unit: m/s}, null]"
    (tmp_path / "mapping.yaml").write_text(
        f"time: {{column: t, unit: s}}\ntopics:\n  vehicle/velocity:\n    linear: {columns}\n", encoding="utf-8"
    )
    recording = vs.read(drive, mapping=tmp_path / "mapping.yaml")
    with_it, without = (
        vs.new_vehicle(1395, 2.63, 1.54, "205/55R16", recordings=recordings).vehicle for recordings in ([recording], ())
    )
    assert set(with_it.sensors) - set(without.sensors) == {"body_velocity"}
    assert with_it.sensors["body_velocity"].kind == "body_velocity"


def test_the_search_for_missing_physics_begins_with_the_deviations_of_the_file():
    car = golf().vehicle
    priors = {parameter.name: parameter.deviation for parameter in base_parameters(car)}
    assert priors["mass"] == pytest.approx(56 / 1395)
    assert priors["cornering stiffness, front"] == pytest.approx(
        car.deviations()["front.cornering_scale"] / car.physics.front.cornering_scale
    )
    without = car.model_copy(update={"uncertainty": {}})
    assert {p.name: p.deviation for p in base_parameters(without)}["mass"] == 0.1


def test_the_observer_estimates_a_parameter_with_the_deviation_of_the_file(tmp_path):
    path = tmp_path / "car.yaml"
    write_new_vehicle(path, golf())
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("observer:\n", "observer:\n  parameters: {chassis.mass: {}}\n"), encoding="utf-8")
    assert load_vehicle(path).observer.parameters["chassis.mass"].deviation == 56.0


def test_an_uncertainty_of_a_number_that_is_not_there_is_refused_with_the_line_of_the_section(tmp_path):
    path = tmp_path / "car.yaml"
    write_new_vehicle(path, golf())
    text = path.read_text(encoding="utf-8").replace("  physics.chassis.mass:", "  physics.chassis.weight:")
    path.write_text(text, encoding="utf-8")
    line = next(i for i, row in enumerate(text.splitlines(), 1) if row == "uncertainty:")
    with pytest.raises(InputError, match=rf"car.yaml:{line}: .*physics.chassis.weight"):
        load_vehicle(path)


def test_uncertainties_stay_in_a_file_that_is_saved_again(tmp_path):
    new = golf().vehicle
    save_vehicle(tmp_path / "car.yaml", new.with_deviations({"chassis.mass": 12.0}, "weighed"))
    again = load_vehicle(tmp_path / "car.yaml")
    assert again.uncertainty["physics.chassis.mass"].source == "weighed"
    assert again.deviations()["chassis.mass"] == 12.0
    assert np.isclose(again.deviations()["chassis.yaw_inertia"], new.deviations()["chassis.yaw_inertia"])
