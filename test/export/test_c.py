"""The exported observer: what compilers say to it, and what it computes beside the one in Python."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt
import pymap3d
import pytest
from click.testing import CliRunner

from marks import exam_except
from vsense_ros import codegen
from vsense_ros.bag.importers import import_recording
from vsense_ros.cli import main
from vsense_ros.codegen.c99 import c_function
from vsense_ros.codegen.forms import number
from vsense_ros.errors import InputError
from vsense_ros.export import c, check
from vsense_ros.export.same_calls import relative
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.friction_change import FrictionChange
from vsense_ros.model.effects.road_bank import RoadBank
from vsense_ros.model.effects.road_grade import RoadGrade
from vsense_ros.model.effects.tyre_relaxation import TyreRelaxation
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import error_ekf
from vsense_ros.observer.sensors import sensors_of

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("VSENSE_DATA", ROOT / "../shared/recordings"))
STRICT = ("-O1", *check.FLAGS[1:], *check.WARNINGS, "-Werror")
pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")


def vehicle_called(name: str) -> Vehicle:
    return load_vehicle(ROOT / f"config/vehicles/{name}.yaml")


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return vehicle_called("prototype_model")


@pytest.fixture(scope="module")
def sources(vehicle: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sources")
    c.write(vehicle, folder)
    return folder


@pytest.fixture(scope="module")
def library(sources: Path) -> ctypes.CDLL:
    return check.build(sources, STRICT)


def estimating(vehicle: Vehicle, parameters: dict[str, EstimatedParameter], kind: str = "ekf") -> Vehicle:
    settings = {"parameters": parameters, "parameter_filter": kind}
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update=settings)})


def under_way(vehicle: Vehicle, library: ctypes.CDLL) -> check.Exported:
    made = check.Exported(vehicle, library)
    made.start(15.0)
    made.linearize()
    return made


# Expressions

x, y = ca.SX.sym("x"), ca.SX.sym("y")
OPERATIONS = {
    "arithmetic": x * y - x / y + (-x) + 1 / y + x**2 + 2 * x,
    "powers": ca.fabs(x) ** 1.7 + ca.fabs(x) ** y + ca.sqrt(ca.fabs(y)),
    "exponentials": ca.exp(x) + ca.log(ca.fabs(x)) + ca.log1p(ca.fabs(y)) + ca.expm1(x),
    "angles": ca.sin(x)
    + ca.cos(y)
    + ca.tan(x)
    + ca.atan2(x, y)
    + ca.atan(y)
    + ca.asin(ca.tanh(x))
    + ca.acos(ca.tanh(y)),
    "hyperbolic": ca.sinh(x) + ca.cosh(y) + ca.tanh(x) + ca.asinh(y) + ca.acosh(1 + x**2) + ca.atanh(0.5 * ca.tanh(x)),
    "choices": ca.if_else(x < y, x, 2 * y) + ca.fmin(x, y) + 3 * ca.fmax(x, y) + ca.sign(x) + ca.logic_not(x <= y),
    "logic": ca.logic_and(x > 0, y > 0) + 2 * ca.logic_or(x > 0, y > 0) + 4 * (x == y) + 8 * (x != y),
    "rounding": ca.floor(x) + ca.ceil(y) + ca.fmod(x, y) + ca.copysign(x, y) + ca.hypot(x, y) + ca.erf(x),
    "constants": x * np.pi + 1e-300 * y + 0.1 + ca.if_else(x > y, np.inf, -1e22),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_expression_in_c_is_what_casadi_computes(name: str, tmp_path: Path) -> None:
    function = ca.Function("f", [ca.vertcat(x, y)], [OPERATIONS[name]], ["z"], ["r"])
    source = "#include <math.h>\n" + c_function(function, ["r"]).replace("static ", "")
    (tmp_path / "vsense.c").write_text(source, encoding="utf-8")
    made = check.build(tmp_path, STRICT)
    for values in np.random.default_rng(0).normal(scale=2, size=(50, 2)):
        values, found = np.ascontiguousarray(values), np.zeros(1)
        made.f(ctypes.c_void_p(values.ctypes.data), ctypes.c_void_p(found.ctypes.data))
        assert found[0] == pytest.approx(float(function(values)), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("value", [0.1, -0.0, 1e-320, 1.7976931348623157e308, np.pi])
def test_a_constant_survives_to_the_last_bit(value: float) -> None:
    assert np.float64(float(number(value))).tobytes() == np.float64(value).tobytes()


def test_functions_that_call_others_are_written_out_in_full() -> None:
    half = ca.Function("half", [x], [x / 2])
    z = ca.MX.sym("z")
    text = c_function(ca.Function("outer", [z], [half(half(z))], ["z"], ["r"]), ["r"])
    assert "static void outer(const double *z, double *r)" in text
    assert "half" not in text


def test_what_was_compiled_is_kept_as_long_as_its_sources_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VSENSE_CACHE", str(tmp_path / "cache"))
    source = tmp_path / "vsense.c"
    source.write_text("int answer(void);\nint answer(void) { return 1; }\n")
    assert check.build(tmp_path).answer() == 1
    assert check.build(tmp_path).answer() == 1
    assert len(list((tmp_path / "cache").glob("*.so"))) == 1
    source.write_text(source.read_text().replace("1", "2"))
    assert check.build(tmp_path).answer() == 2


# Sources


def test_the_sources_allocate_nothing_and_include_nothing_but_the_mathematics(sources: Path) -> None:
    text = "".join(
        (sources / name).read_text(encoding="ascii")
        for name in ("vsense.h", "vsense.c", "algebra.c", "car_blocks.c", "model.c")
    )
    assert set(re.findall(r"#include (.+)", text)) == {
        '"vsense.h"',
        '"algebra.c"',
        '"car_blocks.c"',
        '"model.c"',
        "<math.h>",
        "<string.h>",
    }
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|printf|longjmp)\b", text)
    assert not re.search(r"^static (?!const|void|int|double|struct|inline)", text, re.M), "no variable is shared"


@pytest.mark.slow
@pytest.mark.parametrize("compiler", exam_except(["gcc", "clang"], "gcc"))
@pytest.mark.parametrize("level", exam_except(["-O0", "-O2"], "-O0"))
def test_the_strictest_c99_compilers_have_nothing_to_say(
    sources: Path, tmp_path: Path, compiler: str, level: str
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed here")
    strict = [compiler, level, *check.FLAGS[1:], *check.WARNINGS]
    command = [*strict, "-c", str(sources / "vsense.c"), "-o", str(tmp_path / "vsense.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_single_precision_computes_nothing_in_double_unasked(vehicle: Vehicle, tmp_path: Path, compiler: str) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed here")
    c.write(vehicle, tmp_path, single=True)
    for source in ("vsense.c", "example.c"):
        command = [compiler, *check.FLAGS[1:], *check.WARNINGS, "-fsyntax-only", str(tmp_path / source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


def test_the_header_is_for_c_plus_plus_as_well(sources: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed here")
    command = ["g++", "-Wall", "-Wextra", "-pedantic", "-fsyntax-only", "-x", "c++", str(sources / "vsense.h")]
    assert subprocess.run(command, capture_output=True, text=True, check=False).stderr == ""


@pytest.mark.parametrize("estimates", exam_except([False, True]))
def test_whatever_the_sensors_are_called_compilers_take_it(vehicle: Vehicle, tmp_path: Path, estimates: bool) -> None:
    names = {
        "2nd imu": "imu",
        "(roof */ - /* front)": "imu",
        "step": "wheel_speeds",
        "parameters_learn": "wheel_speeds",
    }
    names |= {"double": "velocity", "v": "position", "main": "steering"}
    called = vehicle.model_copy(update={"sensors": {name: vehicle.sensors[of] for name, of in names.items()}})
    if estimates:
        called = estimating(called, {"chassis.mass": EstimatedParameter(deviation=100.0)})
    c.write(called, tmp_path)
    for source in ("vsense.c", "example.c"):
        command = ["cc", *STRICT[1:], "-fsyntax-only", source]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.exam
def test_the_example_rolls_on_at_its_speed_and_carries_the_cars_weight(
    sources: Path, vehicle: Vehicle, tmp_path: Path
) -> None:
    if shutil.which("make") is None:
        pytest.skip("make is not installed here")
    shutil.copytree(sources, tmp_path, dirs_exist_ok=True)
    subprocess.run(["make", "CFLAGS=-O1"], cwd=tmp_path, check=True, capture_output=True)
    told = subprocess.run([str(tmp_path / "example")], check=True, capture_output=True, text=True).stdout
    assert float(re.search(r"speed +([\d.]+) m/s", told)[1]) == pytest.approx(20.0, abs=0.01)  # type: ignore[index]
    loads = [float(load) for load in re.findall(r"wheel load \d +([\d.]+) N", told)]
    assert sum(loads) == pytest.approx(vehicle.physics.chassis.mass * 9.80665, rel=0.01)


# The observer in C


_TWO_CARS = """
#include <stdio.h>
#include "small.h"
#include "large.h"
static double acceleration[14], wheels[SMALL_OUTPUTS * 4];
static void weigh(const double *forces) {
    printf("%.3f ", forces[0] + forces[1] + forces[2] + forces[3]);
}
int main(void) {
    static small s;
    static large l;
    small_init(&s, 15); large_init(&l, 15);
    small_linearize(&s); large_linearize(&l);
    small_present(&s, acceleration, wheels); weigh(&wheels[4 * SMALL_FORCE_Z]);
    large_present(&l, acceleration, wheels); weigh(&wheels[4 * LARGE_FORCE_Z]);
    return 0;
}
"""


@pytest.mark.exam
def test_two_cars_in_one_program_each_carry_their_own_weight(vehicle: Vehicle, tmp_path: Path) -> None:
    cars = {"small": vehicle, "large": vehicle.with_parameters({"chassis.mass": 1.5 * vehicle.physics.chassis.mass})}
    (tmp_path / "two.c").write_text(_TWO_CARS)
    parts = [tmp_path / "two.c"]
    for name, car in cars.items():
        c.write(car, tmp_path / name, prefix=name)
        parts.append(tmp_path / name / f"{name}.c")
    command = [codegen.compiler() or "", "-O0", *(f"-I{tmp_path / name}" for name in cars), *map(str, parts)]
    subprocess.run([*command, "-o", str(tmp_path / "two"), "-lm"], check=True)
    printed = subprocess.run([str(tmp_path / "two")], capture_output=True, check=True).stdout.split()
    weights = [9.80665 * car.physics.chassis.mass for car in cars.values()]
    assert [float(weight) for weight in printed] == pytest.approx(weights, rel=0.01)


@pytest.mark.parametrize("prefix", ["", "Car", "9a", "a__b", "car-a", "../car", "a_"])
def test_a_prefix_that_c_does_not_take_is_refused(vehicle: Vehicle, tmp_path: Path, prefix: str) -> None:
    with pytest.raises(InputError, match="--prefix"):
        c.write(vehicle, tmp_path / "out", prefix=prefix)
    assert not (tmp_path / "out").exists()


def test_it_starts_as_the_one_in_python_does(vehicle: Vehicle, library: ctypes.CDLL) -> None:
    ours, theirs = error_ekf(vehicle, sensors_of(vehicle)), check.Exported(vehicle, library)
    ours.start_rolling(17.0)
    ours.set_element(5, 1.2, 0.1)
    theirs.start(17.0)
    theirs.place(5, 1.2, 0.1)
    np.testing.assert_allclose(theirs.parts["state"], ours.car.mean, rtol=1e-15)
    np.testing.assert_array_equal(theirs.covariance, ours.car.covariance)


@pytest.mark.parametrize("h", [-0.004, -1e-300, 5.0, np.inf, -np.inf, np.nan])
def test_a_step_that_the_header_excludes_is_refused_and_changes_nothing(
    vehicle: Vehicle, library: ctypes.CDLL, h: float
) -> None:
    exported = check.Exported(vehicle, library)
    exported.start(17.0)
    before = exported.parts["state"].copy(), exported.covariance.copy()
    assert not exported.predict(h)
    np.testing.assert_array_equal(exported.parts["state"], before[0])
    np.testing.assert_array_equal(exported.covariance, before[1])
    assert exported.predict(vehicle.observer.longest_step)


def test_a_copy_of_the_struct_is_the_whole_filter(vehicle: Vehicle, library: ctypes.CDLL) -> None:
    """Two observers in turn do what each does alone, and one that is put back does the same again."""
    alone, first, second = (under_way(vehicle, library) for _ in range(3))
    begun = first.memory.copy()

    def drive(observer: check.Exported, steps: int) -> None:
        for _ in range(steps):
            observer.predict(0.004)
            observer.linearize()
            observer.correct("imu", np.array([0.0, 0.0, 0.1, 0.2, 0.3, 9.8]), np.full(6, 0.01), 1e9)

    drive(alone, 40)
    for _ in range(40):
        drive(first, 1)
        second.predict(0.01)
        second.linearize()
    assert np.array_equal(first.memory, alone.memory)
    first.memory[:] = begun
    drive(first, 40)
    assert np.array_equal(first.memory, alone.memory)


def test_a_measurement_beyond_its_limit_or_of_nothing_changes_nothing(vehicle: Vehicle, library: ctypes.CDLL) -> None:
    observer = under_way(vehicle, library)
    before = observer.memory.copy()
    assert observer.correct("imu", np.full(6, 1e3), np.full(6, 0.01), 36.0) > 36.0
    assert observer.correct("imu", np.full(6, np.nan), np.full(6, 0.01), 36.0) < 0
    assert np.array_equal(observer.memory, before)


def test_of_an_inertial_sensor_the_larger_variance_counts(vehicle: Vehicle, library: ctypes.CDLL) -> None:
    def after(variance: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        observer = under_way(vehicle, library)
        observer.correct("imu", np.array([0.0, 0.0, 0.1, 0.2, 0.3, 9.8]), variance, 1e9)
        return observer.memory

    of_file = vehicle.sensors["imu"].deviations() ** 2
    assert np.array_equal(after(of_file), after(0.1 * of_file))
    assert not np.array_equal(after(of_file), after(2 * of_file))


def test_a_state_that_no_car_can_have_is_told(vehicle: Vehicle, library: ctypes.CDLL) -> None:
    observer = under_way(vehicle, library)

    def is_valid() -> bool:
        return bool(library.vsense_is_valid(ctypes.c_void_p(observer.memory.ctypes.data)))

    assert is_valid()
    for index, value in ((0, np.nan), (3, 1.6), (14, -200.0)):
        kept, observer.parts["state"][index] = observer.parts["state"][index], value
        assert not is_valid()
        observer.parts["state"][index] = kept
    assert is_valid()


@pytest.mark.exam
@pytest.mark.parametrize("drive", ["double lane change", "double lane change, tyres that lag", "RAV4"])
def test_on_a_recording_it_computes_what_the_one_in_python_does(drive: str, vehicle: Vehicle, tmp_path: Path) -> None:
    bag = DATA / "comma2k19_rav4" if drive == "RAV4" else ROOT / "bags/double_lane_change"
    if not bag.exists():
        pytest.skip(f"no recording at {bag}; VSENSE_DATA names the folder that has it")
    driven = vehicle_called("rav4") if drive == "RAV4" else vehicle
    if drive.endswith("lag"):
        effects = Effects(tyre_relaxation=TyreRelaxation(front=0.4, rear=0.4))
        driven = driven.model_copy(update={"physics": driven.physics.model_copy(update={"effects": effects})})
    c.write(driven, tmp_path)
    recording = import_recording(bag)
    difference = check.compare(driven, check.build(tmp_path, STRICT), recording)
    assert difference.largest < 1e-10
    assert difference.predictions > 100 * recording.duration
    assert difference.corrections > difference.predictions
    assert difference.placed <= 3, "the state is taken over at the start alone"


@pytest.mark.exam
@pytest.mark.parametrize("estimates", [False, True])
def test_on_a_road_that_the_file_knows_from_place_to_place_it_looks_up_what_the_one_in_python_does(
    estimates: bool, vehicle: Vehicle, tmp_path: Path
) -> None:
    """On a drive whose fixes come late, so that the observer goes back; its road ends on the way, and grip is of one
    place alone."""
    recording = import_recording(ROOT / "bags/double_lane_change")
    fix = recording["gps/fix"].columns
    rows = np.column_stack([fix["latitude"], fix["longitude"]])
    east, north = (np.array(one) for one in pymap3d.geodetic2enu(*rows.T, 0.0, *rows[0], 0.0)[:2])
    way = np.append(0.0, np.cumsum(np.hypot(np.diff(east), np.diff(north))))
    chosen = np.searchsorted(way, np.arange(0.0, 0.7 * way[-1], 20.0))
    heading = np.arctan2(north[-1] - north[0], east[-1] - east[0])
    bank, grade = (tuple((*rows[i], heading, a * np.sin(way[i] / 30)) for i in chosen) for a in (0.05, -0.03))
    effects = Effects(
        road_bank=RoadBank(bank=0.01, profile=bank),
        road_grade=RoadGrade(profile=grade),
        friction_change=FrictionChange(relative=0.1, profile=((*rows[chosen[-1]], heading, -0.2),)),
    )
    driven = vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": effects})})
    if estimates:
        driven = estimating(driven, {"effects.friction_change.relative": EstimatedParameter(deviation=0.1)})
    c.write(driven, tmp_path)
    library = check.build(tmp_path, STRICT)
    difference = check.compare(driven, library, recording)
    assert difference.largest < 1e-10
    assert difference.surveyed > 20
    assert difference.placed <= 4, "the state is taken over at the start alone, and where the heading is first known"
    alone = under_way(driven, library)
    assert not alone.survey(), "it does not know where it is"
    for index in (0, 1):
        alone.place(index, 0.0, 0.1)
    assert [alone.survey(), alone.survey()] == [True, False]
    alone.place(0, 6.0, 0.1)
    assert alone.survey()


@pytest.mark.exam
@pytest.mark.timeout(1200)  # much C for a compiler
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_parameters_are_estimated_as_in_python(kind: str, vehicle: Vehicle, tmp_path: Path) -> None:
    """The second one drifts, and a step then changes both covariances."""
    parameters = {
        "chassis.mass": EstimatedParameter(deviation=100.0),
        "road.friction": EstimatedParameter(deviation=0.3, lower=0.1, upper=1.5, drift=0.02),
    }
    spi = estimating(vehicle, parameters, kind)
    c.write(spi, tmp_path)
    library = check.build(tmp_path, STRICT)
    difference = check.compare(spi, library, import_recording(ROOT / "bags/double_lane_change"))
    assert difference.largest < 1e-10
    assert difference.corrections > 1000
    assert difference.placed <= 3, "the state is taken over at the start alone"
    begun = check.Exported(spi, library)
    values, covariance = begun.belief()
    assert values[-2:] == pytest.approx([vehicle.values()[name] for name in parameters])
    assert np.sqrt(np.diag(covariance)[-2:]) == pytest.approx([100.0, 0.3])
    header = (tmp_path / "vsense.h").read_text(encoding="ascii")
    assert re.findall(r"VSENSE_E_(\w+) = (\d)", header) == [("CHASSIS_MASS", "0"), ("ROAD_FRICTION", "1")]


def test_a_difference_that_is_no_number_is_infinite() -> None:
    nan, one = np.array([np.nan]), np.array([1.0])
    assert relative(nan, one) == relative(one, nan) == np.inf
    assert relative(nan, nan) == 0


# Bad input


def test_sensors_that_c_cannot_tell_apart_are_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    imu = vehicle.sensors["imu"]
    twice = vehicle.model_copy(update={"sensors": {**vehicle.sensors, "roof imu": imu, "roof-imu": imu}})
    with pytest.raises(InputError, match="roof_imu have the same name in C; rename one"):
        c.write(twice, tmp_path)


def test_a_filter_that_is_not_written_as_c_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    for name, words in (("ukf", "exists in Python alone"), ("magic", "no filter 'magic'")):
        arguments = ["export", "c", "prototype_model", "--output", str(tmp_path), "--filter", name]
        result = CliRunner().invoke(main, arguments)
        assert result.exit_code == 2
        assert words in result.output
    estimating_mass = estimating(vehicle, {"chassis.mass": EstimatedParameter(deviation=100.0)})
    assert not c.with_filter(estimating_mass, "error_ekf").observer.parameters


def test_a_vehicle_that_no_observer_could_follow_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    blind = vehicle.model_copy(update={"sensors": {"imu": vehicle.sensors["imu"]}})
    with pytest.raises(InputError, match="no sensor measures the car's speed"):
        c.write(blind, tmp_path)


@pytest.mark.slow
def test_a_parameter_that_the_sensors_cannot_tell_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    hopeless = estimating(vehicle, {"steering.ratio": EstimatedParameter(deviation=1.0)})
    with pytest.raises(InputError, match=r"steering\.ratio cannot be estimated: it changes nothing that the sensors"):
        c.write(hopeless, tmp_path)


@pytest.mark.exam
def test_of_a_sensor_set_only_its_functions_and_biases_are_written(tmp_path: Path) -> None:
    chosen = ["--sensor", "wheel_speeds", "--sensor", "steering"]
    arguments = ["export", "c", "prototype_model", "--output", str(tmp_path)]
    assert CliRunner().invoke(main, [*arguments, *chosen]).exit_code == 0
    header = (tmp_path / "vsense.h").read_text(encoding="ascii")
    assert re.findall(r"double vsense_correct_(\w+)\(", header) == ["wheel_speeds"]
    assert "VSENSE_STATES = 53" in header  # coordinates, velocities, forces, slow quantities, a radius of each wheel
    result = CliRunner().invoke(main, [*arguments, "--sensor", "lidar"])
    assert result.exit_code == 2
    assert "has no sensor lidar; it has imu, wheel_speeds" in result.output


@pytest.mark.exam
def test_without_a_compiler_the_sources_are_written_and_the_check_says_what_it_needs(tmp_path: Path) -> None:
    arguments = ["export", "c", "prototype_model", "--output", str(tmp_path), "--check", str(ROOT / "bags/step_steer")]
    result = CliRunner(env={"VSENSE_COMPILE": "0"}).invoke(main, arguments)
    assert result.exit_code == 2
    assert "no C compiler here" in result.output
    assert (tmp_path / "vsense.c").exists()


def test_a_file_in_the_way_of_the_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    result = CliRunner().invoke(main, ["export", "c", "prototype_model", "--output", str(tmp_path / "taken")])
    assert result.exit_code == 2
    assert "taken" in result.output
    assert "Traceback" not in result.output
