"""One file with physical effects through every command: its effects are used, or are told to be left out."""

from __future__ import annotations

import ctypes
import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.linalg import expm

from vsense_ros import codegen
from vsense_ros.bag import read_bag
from vsense_ros.cli import main
from vsense_ros.export import check
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle, save_vehicle
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.effect_parameters import with_all_effects
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import DISTURBANCES, YAW, X
from vsense_ros.model.effects import EVERY, Effects
from vsense_ros.model.effects.aero_drag import AeroDrag
from vsense_ros.model.effects.crosswind import Crosswind
from vsense_ros.model.effects.friction_change import FrictionChange
from vsense_ros.model.effects.gyro_bias import GyroBias
from vsense_ros.model.effects.road_bank import RoadBank
from vsense_ros.model.effects.road_grade import RoadGrade
from vsense_ros.model.effects.sensor_delay import SensorDelay
from vsense_ros.model.effects.unmodelled import TERMS, Unmodelled
from vsense_ros.model.sensors import WheelTorques
from vsense_ros.model.vehicle import Vehicle, left_out_of_observer, left_out_of_simulation
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import DISTURB, Prior, U
from vsense_ros.runner import Runner

DRAG, GRADE, BIAS, DELAY = 0.4, 0.03, 0.03, 0.02  # [m²], [rad], [rad/s], [s]
GRADE_STATE = DISTURB.start + DISTURBANCES.index("grade")
PLACE = (43.5, -8.2, 0.0, 0.05)


def vsense(*arguments: object) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


def having(vehicle: Vehicle, **effects: object) -> Vehicle:
    physics = vehicle.physics.model_copy(update={"effects": Effects(**effects)})
    return vehicle.model_copy(update={"physics": physics})


@pytest.fixture(scope="module")
def bare() -> Vehicle:
    """On straight guides."""
    vehicle = load_vehicle(vehicle_path("prototype_real"))
    return vehicle.model_copy(update={"suspension": None, "linkage": None})


@pytest.fixture(scope="module")
def extended(bare: Vehicle) -> Vehicle:
    return having(
        bare,
        aero_drag=AeroDrag(area=DRAG),
        gyro_bias=GyroBias(z=BIAS),
        sensor_delay=SensorDelay(imu=DELAY),
        road_grade=RoadGrade(grade=GRADE),
        road_bank=RoadBank(profile=(PLACE,)),
        unmodelled=Unmodelled(yaw_moment_lateral=20.0, yaw_moment_driving=10.0),
    )


@pytest.fixture(scope="module")
def files(bare: Vehicle, extended: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("vehicles")
    found = {"bare": folder / "bare.yaml", "extended": folder / "extended.yaml"}
    save_vehicle(found["bare"], bare)
    save_vehicle(found["extended"], extended)
    return found


@pytest.fixture(scope="module")
def driven(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """One manoeuvre with both files and equal noise."""
    folder = tmp_path_factory.mktemp("driven")
    for name, file in files.items():
        vsense("simulate", "coast_down", "--vehicle", file, "--out", folder / name)
    return {name: read_bag(folder / name) for name in files}


@pytest.fixture(scope="module")
def swerve(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("swerve") / "double_lane_change"
    told = vsense("simulate", "double_lane_change", "--vehicle", files["extended"], "--out", bag).output
    assert "the simulation leaves out of road_bank its profile along the road" in told
    return bag


# Which effects are used


def test_every_effect_of_the_library_reaches_the_observer_or_is_told_to_be_left_out(bare: Vehicle) -> None:
    """By what the equations depend on: the motion, the sensors, or the slope that the road goes back to."""
    every = with_all_effects(bare)
    car = car_of(every)
    moving = {symbol.name() for symbol in ca.symvar(ca.vertcat(car.dynamics, car.next_internal_state(ca.SX(0.01))))}
    of = dict(zip(car.parameter_names, (symbol.name() for symbol in ca.vertsplit(car.p)), strict=True))
    for id, kind in EVERY.items():
        for name, field in kind.model_fields.items():
            about = field.json_schema_extra or {}
            if about.get("role") != "size":  # type: ignore[union-attr]
                continue
            one = having(bare, **{id: kind(**{name: 0.1 * about["typical"]})})  # type: ignore[index, operator]
            in_sensors = one.sensing() != bare.sensing()
            in_road = Prior.of(one, one.sensing()).reversion_mean.any()
            told = id in left_out_of_observer(one)
            assert of[f"effects.{id}.{name}"] in moving or in_sensors or in_road or told, f"{id}.{name}"


def test_terms_that_need_the_wheel_torques_are_those_whose_equations_have_them(bare: Vehicle) -> None:
    car = car_of(having(bare, unmodelled=Unmodelled()))
    for channel, features in TERMS.items():
        for name, feature in features.items():
            depends = ca.jacobian(ca.SX(feature.value(car)), car.inputs)[1:].nnz() > 0
            assert feature.by_torque == depends, f"{channel}_{name}"


def test_what_an_observer_leaves_out_is_named_with_the_reason(bare: Vehicle) -> None:
    placed = bare
    unplaced = {name: sensor for name, sensor in bare.sensors.items() if sensor.kind != "gnss_position"}
    bare = bare.model_copy(update={"sensors": unplaced})

    def said(**effects: object) -> str:
        return left_out_of_observer(having(bare, **effects))

    assert said(aero_drag=AeroDrag(area=0.3), road_bank=RoadBank(bank=0.02)) == ""
    bank = "road_bank its profile along the road, as no sensor measures where the car is; the slope is estimated"
    assert bank in said(road_bank=RoadBank(profile=(PLACE,)))
    assert left_out_of_observer(having(placed, road_bank=RoadBank(profile=(PLACE,)))) == ""
    assert "road_grade its plane" in said(road_grade=RoadGrade(grade=0.02, follows=0.0))
    tilted = having(placed, road_grade=RoadGrade(profile=(PLACE,), follows=0.0))
    assert "road_grade its profile along the road; the slope" in left_out_of_observer(tilted)
    assert "friction_change its profile along the road" in said(friction_change=FrictionChange(profile=(PLACE,)))
    assert "slope" not in said(friction_change=FrictionChange(relative=0.1, profile=(PLACE,)))
    assert "yaw_moment_driving, as no sensor measures the wheel torques" in said(
        unmodelled=Unmodelled(yaw_moment_driving=9.0, yaw_moment_lateral=9.0)
    )
    assert said(crosswind=Crosswind(north=5.0)) == ""
    of_car = {name: sensor for name, sensor in bare.sensors.items() if not sensor.kind.startswith("gnss")}
    blind = having(bare, crosswind=Crosswind(north=5.0)).model_copy(update={"sensors": of_car})
    assert "crosswind its direction on the map, as no sensor knows north" in left_out_of_observer(blind)


def test_with_wheel_torques_no_unmodelled_term_is_left_out(bare: Vehicle) -> None:
    torques = bare.model_copy(update={"sensors": {**bare.sensors, "torques": WheelTorques()}})
    assert left_out_of_observer(having(torques, unmodelled=Unmodelled(yaw_moment_driving=9.0))) == ""


def test_a_simulation_leaves_out_nothing_but_profiles(bare: Vehicle) -> None:
    plane = RoadGrade(grade=0.02, follows=0.0)
    assert left_out_of_simulation(having(bare, road_grade=plane, crosswind=Crosswind(north=5.0))) == ""
    assert "friction_change its profile" in left_out_of_simulation(
        having(bare, friction_change=FrictionChange(profile=(PLACE,)))
    )


@pytest.mark.slow
def test_the_observer_warns_in_its_diagnostics_of_what_it_leaves_out(extended: Vehicle) -> None:
    observer = Runner(extended)
    (line,) = (line for line in observer.diagnostics() if line.name == "effects")
    assert (line.level, line.message) == (Level.WARN, observer.left_out)
    assert "yaw_moment_driving" in line.message


# A slope of the road in the filters


@pytest.mark.exam
@pytest.mark.parametrize("way", ["in C", "in Python", "whole state"])
def test_a_known_slope_is_what_the_filter_starts_with_and_goes_back_to(extended: Vehicle, way: str) -> None:
    ekf = FILTERS["dekf" if way == "whole state" else "error_ekf"].make(extended, sensors_of(extended))
    if way == "in Python":
        ekf._operations = None
    ekf.start_rolling(20.0)
    ekf.linearize()
    uphill = ekf.car.udot[X, 0]
    assert ekf.car.mean[GRADE_STATE] == pytest.approx(GRADE)
    ekf.car.mean[GRADE_STATE] = driven = 0.0
    ekf.linearize()
    assert uphill - ekf.car.udot[X, 0] == pytest.approx(-9.80665 * np.sin(GRADE), rel=1e-6)
    for _ in range(200):
        way = ekf.car.mean[U.start] * 0.01
        ekf.predict(0.01)
        ekf.linearize()
        driven += way
    # By the way driven s: x'' + x'/L + (c/σ)² x = 0 for the distance x from the mean.
    around = extended.observer.surroundings
    bent_back = np.array([[0.0, 1.0], [-((around.grade_change / around.grade) ** 2), -1 / around.change_length]])
    left = expm(driven * bent_back)[0, 0]
    assert ekf.car.mean[GRADE_STATE] == pytest.approx(GRADE * (1 - left), rel=0.02)


# The commands


@pytest.mark.exam
def test_the_simulated_car_slows_down_by_the_drag_and_the_slope_of_its_file(
    bare: Vehicle, driven: dict[str, Recording]
) -> None:
    """By Newton's second law, the wheels' inertia included."""
    speed = {name: recording["reference/odometry"].columns["linear"][:, 0] for name, recording in driven.items()}
    p, second = bare.physics, slice(50, 151)  # once the tyres have their slip
    square = {name: np.mean(one[second] ** 2) for name, one in speed.items()}
    lost = {name: one[second][0] - one[second][-1] for name, one in speed.items()}
    inertia = sum(2 * axle.wheel_spin_inertia / axle.unloaded_radius**2 for axle in (p.front, p.rear))
    area = p.aerodynamics.drag_area
    air = 0.5 * 1.204 * ((area + DRAG) * square["extended"] - area * square["bare"])
    force = air + p.chassis.mass * 9.80665 * np.sin(GRADE)
    assert lost["extended"] - lost["bare"] == pytest.approx(force / (p.chassis.mass + inertia), rel=0.02)


@pytest.mark.exam
def test_the_simulated_gyro_has_the_bias_and_the_age_of_its_file(driven: dict[str, Recording]) -> None:
    imu = {name: recording["imu/data"] for name, recording in driven.items()}
    apart = imu["extended"].columns["angular_velocity"] - imu["bare"].columns["angular_velocity"]
    assert apart[:, 2].mean() == pytest.approx(BIAS, abs=1e-3)
    assert set((imu["extended"].stamp - imu["bare"].stamp).tolist()) == {round(DELAY * 1e9)}


@pytest.mark.slow
def test_run_takes_the_gyro_bias_and_the_slope_from_the_file(
    files: dict[str, Path], swerve: Path, tmp_path: Path
) -> None:
    """On a recording that has both, against the truth of the simulation; the gyro's other bias is in both runs."""
    outputs, errors = {}, {}
    for name, file in files.items():
        said = vsense("run", swerve, "--vehicle", file, "--out", tmp_path / name).output
        assert ("yaw_moment_driving" in said) == (name == "extended")
        assert "profile" not in said
        (summary,) = json.loads((tmp_path / name / "summary.json").read_text(encoding="utf-8")).values()
        errors[name] = summary["signals"]["yaw_rate"]["rmse"]
        slow = read_bag(tmp_path / name / "output")["vsense/parameters"]
        outputs[name] = dict(zip(slow.names, slow.columns["position"][-1], strict=True))
    assert outputs["bare"]["imu.gyro_bias_z"] - outputs["extended"]["imu.gyro_bias_z"] == pytest.approx(BIAS, abs=5e-3)
    assert errors["extended"] < 0.5 * errors["bare"]
    assert outputs["extended"]["grade"] == pytest.approx(GRADE, abs=0.01)


@pytest.mark.exam
@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
def test_the_exported_observer_is_the_one_in_python_with_all_effects_of_the_file(
    extended: Vehicle, files: dict[str, Path], swerve: Path, tmp_path: Path
) -> None:
    said = vsense("export", "c", files["extended"], "--output", tmp_path).output
    assert "profile" not in said
    assert "yaw_moment_driving, as no sensor measures the wheel torques" in said
    library = check.build(tmp_path, ("-O1", *check.FLAGS[1:], "-Werror"))
    difference = check.compare(extended, library, read_bag(swerve))
    assert difference.largest < 1e-10
    assert difference.corrections > 1000
    header = (tmp_path / "vsense.h").read_text(encoding="ascii")
    assert f"#define VSENSE_IMU_LATENCY {DELAY}" in header
    offset = np.ctypeslib.as_array((ctypes.c_double * 6).in_dll(library, "vsense_imu_offset"))
    assert offset[2] == BIAS
    rolling = check.Exported(extended, library)
    rolling.start(30.0)
    rolling.linearize()
    with_effects = rolling.parts["udot"].copy()
    rolling.parts["parameters"][list(extended.values()).index("effects.aero_drag.area")] = 0.0
    rolling.parts["state"][GRADE_STATE] = 0.0
    rolling.linearize()
    force = 0.5 * 1.2 * DRAG * 30.0**2 / extended.physics.chassis.mass + 9.80665 * np.sin(GRADE)
    assert (rolling.parts["udot"] - with_effects)[X] == pytest.approx(force, rel=0.02)
    assert with_effects[YAW] == pytest.approx(0.0, abs=1e-9)
