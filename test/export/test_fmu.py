"""Functional mock-up units: valid, the same as the C export to the bit, and robust against what masters do wrong."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

fmpy = pytest.importorskip("fmpy")
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from marks import exam_except
from studies import fmu_tools
from vsense_ros import codegen
from vsense_ros.bag import read_bag
from vsense_ros.errors import InputError
from vsense_ros.export import fmu, fmu_check
from vsense_ros.export.same_calls import moments as moments_of
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.road_bank import RoadBank
from vsense_ros.model.effects.tyre_relaxation import TyreRelaxation
from vsense_ros.model.simulation.closed_loop import simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.road_map import RoadMap

pytestmark = [pytest.mark.slow, pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")]
ROOT = Path(__file__).parents[2]
SECONDS = 1.0
QUICK = "-O0"  # to compile


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")


@pytest.fixture(scope="module")
def drive() -> Recording:
    """A second of a double lane change."""
    whole = read_bag(ROOT / "bags/double_lane_change")
    begin = whole.first_stamp + 3_000_000_000
    end = begin + round(SECONDS * 1e9)
    channels = {t: c.select((begin <= c.stamp) & (c.stamp < end)) for t, c in whole.channels.items()}
    return dataclasses.replace(whole, channels=channels)


@pytest.fixture(scope="module")
def units(vehicle: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The unit of each version of FMI, which is written and compiled when a test first asks for it."""
    folder = tmp_path_factory.mktemp("units")

    class Units(dict[int, Path]):
        def __missing__(self, version: int) -> Path:
            self[version] = folder / f"observer{version}.fmu"
            fmu.write(vehicle, self[version], version, optimised=QUICK)
            return self[version]

    return Units()


def running(units: dict[int, Path], vehicle: Vehicle, version: int) -> fmu_check.Running:
    return fmu_check.Running(units[version], fmu.Unit(vehicle), version, 15.0)


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_a_unit_is_valid_and_has_the_bits_of_the_c_export_and_the_estimates_of_python(
    units: dict[int, Path], vehicle: Vehicle, drive: Recording, version: int
) -> None:
    found = fmu_check.compare(vehicle, units[version], version, drive, optimised=QUICK)
    assert found.remarks == []
    assert found.steps > 300
    assert found.bitwise
    assert found.python < 1e-9


@pytest.mark.exam
def test_a_unit_of_an_extended_file_with_a_known_road_has_the_bits_of_c_and_the_estimates_of_python(
    vehicle: Vehicle, drive: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fix = drive["gps/fix"].columns
    rows = np.column_stack([fix["latitude"], fix["longitude"]])
    rows = rows[0] + np.linspace(-1.0, 2.0, 12)[:, None] * (rows[-1] - rows[0])  # on the way of the second, and beyond
    heading = float(np.arctan2(*(rows[-1] - rows[0]) * (1.0, np.cos(np.radians(rows[0, 0])))))
    effects = Effects(
        tyre_relaxation=TyreRelaxation(front=0.4, rear=0.4),
        road_bank=RoadBank(profile=tuple((*row, heading, 0.05) for row in rows)),
    )
    extended = vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": effects})})
    looks, at = [], RoadMap.at
    monkeypatch.setattr(RoadMap, "at", lambda *given: looks.append(at(*given)) or looks[-1])
    path = tmp_path / "unit.fmu"
    fmu.write(extended, path, 3, optimised=QUICK)
    found = fmu_check.compare(extended, path, 3, drive, optimised=QUICK)
    assert (found.remarks, found.bitwise) == ([], True)
    assert found.python < 1e-9
    assert looks
    assert all(road.slopes[1] == pytest.approx(0.05) for road in looks[1:])


def test_what_is_set_before_a_step_changes_no_output_until_then(units: dict[int, Path], vehicle: Vehicle) -> None:
    """So that dependencies of outputs are empty, and their directional derivatives by inputs would be zero."""
    unit = running(units, vehicle, 3)
    outputs = [variable.name for variable in unit.unit.variables if variable.kind == "OUTPUT"]
    unit.step(0.0, 0.004)
    before = {name: unit.get(name) for name in outputs}
    unit.set("input", [0.1, 0.0, 0.0, 200.0, 200.0, 0.0])
    unit.measured(0, np.array([0.0, 0.0, 0.5, 0.1, 2.0, 9.8]))
    assert all(np.array_equal(unit.get(name), value) for name, value in before.items())
    unit.step(0.004, 0.004)
    assert not np.array_equal(unit.get("state"), before["state"])
    unit.close()


@pytest.mark.exam
def test_a_unit_of_scalars_has_the_same_bits(vehicle: Vehicle, drive: Recording, tmp_path: Path) -> None:
    path = tmp_path / "scalars.fmu"
    fmu.write(vehicle, path, 3, scalars=True, optimised=QUICK)
    found = fmu_check.compare(vehicle, path, 3, drive, optimised=QUICK, scalars=True)
    assert (found.remarks, found.bitwise) == ([], True)


@pytest.mark.parametrize(
    ("name", "file", "begins"),
    exam_except(
        [("aarch64-linux", "aarch64-linux/{}.so", b"\x7fELF"), ("x86_64-windows", "x86_64-windows/{}.dll", b"MZ")],
        ("x86_64-windows", "x86_64-windows/{}.dll", b"MZ"),
    ),
)
def test_a_unit_has_a_binary_for_each_machine_that_was_named(
    vehicle: Vehicle, tmp_path: Path, name: str, file: str, begins: bytes
) -> None:
    if shutil.which(fmu.TARGETS[name].compiler) is None:
        pytest.skip(f"{fmu.TARGETS[name].compiler} is not installed here")
    path = tmp_path / "unit.fmu"
    fmu.write(vehicle, path, 3, targets=[name], optimised=QUICK)
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        (binary,) = (n for n in archive.namelist() if n.startswith("binaries/"))
        assert binary == f"binaries/{file.format(fmu.Unit(vehicle).identifier)}"
        assert archive.read(binary).startswith(begins)


_CALLS_IN_ANY_ORDER = """
import ctypes, random, sys
library, token, sizes, seed = ctypes.CDLL(sys.argv[1]), sys.argv[2].encode(), int(sys.argv[3]), int(sys.argv[4])
choose = random.Random(seed)
library.fmi2Instantiate.restype = ctypes.c_void_p
@ctypes.CFUNCTYPE(None)
def nothing(): pass
class Callbacks(ctypes.Structure):
    _fields_ = [(n, ctypes.c_void_p) for n in ("logger", "allocate", "free", "finished", "environment")]
callbacks = Callbacks()
made = library.fmi2Instantiate(b"one", 1, token, None, ctypes.byref(callbacks), 0, 0)
assert made
reals, references = (ctypes.c_double * 4)(), (ctypes.c_uint * 4)()
count, state, other = ctypes.c_size_t(), ctypes.c_void_p(), (ctypes.c_char * sizes)()
def one():
    real = choose.choice([0.0, 0.01, -1.0, float("nan"), float("inf"), 1e300, 4.0])
    for k in range(4):
        references[k] = choose.choice([0, 1000, 5000, 6001, 7027, 900000, 2**32 - 1, choose.randrange(20000)])
        reals[k] = real
    n = choose.choice([0, 1, 4])
    c = ctypes.c_void_p(choose.choice([made, made, made, None]))
    d = ctypes.c_double
    name, *rest = choose.choice([
        ("SetupExperiment", 0, d(0), d(real), 0, d(1)), ("EnterInitializationMode",), ("ExitInitializationMode",),
        ("Terminate",), ("Reset",), ("GetReal", references, ctypes.c_size_t(n), reals),
        ("SetReal", references, ctypes.c_size_t(n), reals), ("GetReal", None, ctypes.c_size_t(n), None),
        ("SetInteger", references, ctypes.c_size_t(n), (ctypes.c_int * 4)()),
        ("GetInteger", references, ctypes.c_size_t(n), (ctypes.c_int * 4)()),
        ("GetFMUstate", ctypes.byref(state)), ("SetFMUstate", state), ("FreeFMUstate", ctypes.byref(state)),
        ("SerializedFMUstateSize", state, ctypes.byref(count)),
        ("SerializeFMUstate", state, other, ctypes.c_size_t(sizes)),
        ("DeSerializeFMUstate", other, ctypes.c_size_t(choose.choice([sizes, 0, sizes - 1])), ctypes.byref(state)),
        ("DoStep", d(choose.choice([0.0, real])), d(choose.choice([0.01, real])), 1), ("CancelStep",),
        ("GetRealStatus", 2, reals), ("GetDirectionalDerivative", references, ctypes.c_size_t(n), references,
         ctypes.c_size_t(n), reals, reals),
    ])
    return name, getattr(library, "fmi2" + name)(c, *rest), c.value
answers = [one() for _ in range(1500)]
assert all(status != 0 for name, status, c in answers if c is None and name != "FreeFMUstate"), answers
assert {status for _, status, _ in answers} <= {0, 2, 3}
print(len({name for name, status, _ in answers if status == 0}))
"""


def kinds_of_calls_done(
    program: str, units: dict[int, Path], vehicle: Vehicle, version: int, folder: Path, seed: int
) -> int:
    """How many kinds of calls a unit has done that a program in another process made, which ended well."""
    with zipfile.ZipFile(units[version]) as archive:
        (binary,) = (name for name in archive.namelist() if name.endswith(".so"))
        archive.extract(binary, folder)
    unit = running(units, vehicle, version)
    size = len(unit.save()) - 4 * len(unit.unit.sensors)
    unit.close()
    command = [sys.executable, "-c", program, str(folder / binary), fmu.Unit(vehicle).token(version)]
    done = subprocess.run([*command, str(size), str(seed)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-800:]
    return int(done.stdout)


@pytest.mark.exam
@pytest.mark.parametrize("seed", range(8))
def test_calls_in_any_order_are_refused_or_done_and_never_end_the_process(
    units: dict[int, Path], vehicle: Vehicle, tmp_path: Path, seed: int
) -> None:
    assert kinds_of_calls_done(_CALLS_IN_ANY_ORDER, units, vehicle, 2, tmp_path, seed) > 5


_CALLS_OF_A_HOST_THAT_LIES = """
import ctypes, random, re, sys
from pathlib import Path
import fmpy
library, token, size = ctypes.CDLL(sys.argv[1]), sys.argv[2].encode(), int(sys.argv[3])
choose = random.Random(int(sys.argv[4]))
d, u, n = ctypes.c_double, ctypes.c_uint, ctypes.c_size_t
make = library.fmi3InstantiateCoSimulation
make.restype = ctypes.c_void_p
references, reals = (u * 8)(), (d * 64)()
# It says to use events and an early return, which the unit has not declared, and wants values amid steps.
made = make(b"one", token, None, False, False, True, True, references, n(8), None, None, None)
assert made and not make(b"one", token[:-1], None, False, False, False, False, None, n(0), None, None, None)
count, state, blob, flags = n(), ctypes.c_void_p(), (ctypes.c_char * size)(), (ctypes.c_bool * 8)()
header = (Path(fmpy.__file__).parent / "c-code/fmi3FunctionTypes.h").read_text()
known = re.findall(r"typedef fmi3Status (fmi3\\w+)TYPE", header)
def one():
    real, k = choose.choice([0.0, 0.01, -1.0, float("nan"), float("inf"), 1e300, 4.0, 5e-324]), choose.choice([0, 1, 8])
    for i in range(8):
        references[i], reals[i] = choose.choice([0, 1, 5, 9, 900000, 2**32 - 1, choose.randrange(40)]), real
    c, values = ctypes.c_void_p(choose.choice([made, made, made, None])), n(choose.choice([k, 0, 1, 64]))
    name, *rest = choose.choice([
        ("EnterInitializationMode", False, d(0), d(real), False, d(1)), ("ExitInitializationMode",), ("Reset",),
        ("Terminate",),
        ("GetFloat64", references, n(k), reals, values), ("SetFloat64", references, n(k), reals, values),
        ("GetFloat64", None, n(k), None, values), ("SetInt32", references, n(k), (ctypes.c_int * 64)(), values),
        ("GetInt32", references, n(k), (ctypes.c_int * 64)(), values), ("GetFMUState", ctypes.byref(state)),
        ("SetFMUState", state), ("FreeFMUState", ctypes.byref(state)),
        ("SerializedFMUStateSize", state, ctypes.byref(count)),
        ("SerializeFMUState", state, blob, n(choose.choice([size, 0]))),
        ("DeserializeFMUState", blob, n(choose.choice([size, 0, size - 1, 2**63])), ctypes.byref(state)),
        ("DoStep", d(choose.choice([0.0, real])), d(choose.choice([0.01, real])), True, flags, flags, flags, reals),
        ("DoStep", d(0.0), d(0.01), True, None, None, None, None),
        (choose.choice([f[4:] for f in known if f not in used]), *[None] * 12),
    ])
    return name, getattr(library, "fmi3" + name)(c, *rest), c.value
used = set(re.findall(r"fmi3\\w+", '''
    fmi3EnterInitializationMode fmi3ExitInitializationMode fmi3Reset fmi3Terminate fmi3GetFloat64 fmi3SetFloat64
    fmi3SetInt32 fmi3GetInt32 fmi3GetFMUState fmi3SetFMUState fmi3FreeFMUState fmi3SerializedFMUStateSize
    fmi3SerializeFMUState fmi3DeserializeFMUState fmi3DoStep'''))
answers = [one() for _ in range(1500)]
assert all(status != 0 for name, status, c in answers if c is None and name not in ("FreeFMUState", "SetDebugLogging"))
assert {status for _, status, _ in answers} <= {0, 3}
print(len({name for name, status, _ in answers if status == 0}))
"""


@pytest.mark.exam
@pytest.mark.parametrize("seed", range(4))
def test_a_host_that_lies_about_itself_and_calls_what_is_not_offered_ends_no_process(
    units: dict[int, Path], vehicle: Vehicle, tmp_path: Path, seed: int
) -> None:
    assert kinds_of_calls_done(_CALLS_OF_A_HOST_THAT_LIES, units, vehicle, 3, tmp_path, seed) > 5


def test_a_damaged_state_is_refused(units: dict[int, Path], vehicle: Vehicle) -> None:
    unit = running(units, vehicle, 3)
    data = bytearray(unit.save())
    data[2000] ^= 64
    with pytest.raises(FMICallException):
        unit.restore(bytes(data))
    unit.close()


_REST_OF_THE_DRIVE = """
import sys, numpy as np, pickle
from pathlib import Path
from vsense_ros.export import fmu, fmu_check
path, kept, version = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
vehicle, drive, begin, state = pickle.load(open(kept, "rb"))
unit = fmu_check.Running(path, fmu.Unit(vehicle), version)
unit.restore(state)
*_, last = fmu_check.drive_unit(unit, vehicle, drive, begin)
sys.stdout.buffer.write(last.tobytes())
"""


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_a_saved_state_goes_on_to_the_same_bits_in_another_process(
    units: dict[int, Path], vehicle: Vehicle, drive: Recording, version: int, tmp_path: Path
) -> None:
    import pickle

    moments = moments_of(vehicle, drive)[:200]
    unit = running(units, vehicle, version)
    whole = list(fmu_check.drive_unit(unit, vehicle, moments))
    unit.close()
    unit = running(units, vehicle, version)
    list(fmu_check.drive_unit(unit, vehicle, moments[:101]))
    kept = tmp_path / "kept"
    kept.write_bytes(pickle.dumps((vehicle, moments, 100, unit.save())))
    unit.close()
    command = [sys.executable, "-c", _REST_OF_THE_DRIVE, str(units[version]), str(kept), str(version)]
    done = subprocess.run(command, capture_output=True, check=True)
    assert np.array_equal(np.frombuffer(done.stdout), whole[-1])


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_two_instances_do_not_know_each_other(
    units: dict[int, Path], vehicle: Vehicle, drive: Recording, version: int
) -> None:
    moments = moments_of(vehicle, drive)[:60]
    alone, one, other = (running(units, vehicle, version) for _ in range(3))
    expected = list(fmu_check.drive_unit(alone, vehicle, moments))
    both = zip(
        fmu_check.drive_unit(one, vehicle, moments), fmu_check.drive_unit(other, vehicle, moments[::2]), strict=False
    )
    for (found, _), truth in zip(both, expected, strict=False):
        assert np.array_equal(found, truth)
    for unit in (alone, one, other):
        unit.close()


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_of_a_binary_only_the_functions_of_fmi_are_visible(
    units: dict[int, Path], version: int, tmp_path: Path
) -> None:
    if shutil.which("nm") is None:
        pytest.skip("nm is not installed here")
    with zipfile.ZipFile(units[version]) as archive:
        (binary,) = (name for name in archive.namelist() if name.endswith(".so"))
        archive.extract(binary, tmp_path)
    printed = subprocess.run(["nm", "-D", "--defined-only", str(tmp_path / binary)], capture_output=True, text=True)
    names = {line.split()[-1] for line in printed.stdout.splitlines()}
    assert f"fmi{version}DoStep" in names
    assert all(name.startswith(f"fmi{version}") for name in names)


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
@pytest.mark.parametrize("h", [0.0, -0.01, np.nan, np.inf, 1e9])
def test_an_impossible_step_is_refused_and_changes_nothing(
    units: dict[int, Path], vehicle: Vehicle, version: int, h: float
) -> None:
    unit = running(units, vehicle, version)
    before = unit.get("state")
    with pytest.raises(FMICallException):
        unit.step(0.0, h)
    assert np.array_equal(unit.get("state"), before)
    unit.step(0.0, 0.01)
    with pytest.raises(FMICallException):
        unit.step(5.0, 0.01)  # time does not go on from where it was
    unit.close()


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_steering_that_is_no_number_is_refused_and_a_measurement_that_is_none_is_absent(
    units: dict[int, Path], vehicle: Vehicle, version: int
) -> None:
    unit = running(units, vehicle, version)
    with pytest.raises(FMICallException):
        unit.set("input", [np.nan, 0, 0, 0, 0, 0])
    index = [s.name for s in unit.unit.sensors].index("imu")
    unit.measured(index, np.full(6, np.nan))
    unit.step(0.0, 0.01)
    assert np.all(np.isfinite(unit.get("state")))
    unit.close()


@pytest.mark.parametrize("version", exam_except(fmu.VERSIONS, 3))
def test_the_state_of_another_vehicle_is_refused(units: dict[int, Path], vehicle: Vehicle, version: int) -> None:
    unit = running(units, vehicle, version)
    data = bytearray(unit.save())
    data[3] ^= 1  # of the token
    with pytest.raises(FMICallException):
        unit.restore(bytes(data))
    with pytest.raises(FMICallException):
        unit.restore(bytes(data[:200]))
    unit.close()


@pytest.mark.exam
def test_a_unit_of_another_vehicle_has_another_token(vehicle: Vehicle) -> None:
    heavier = vehicle.with_parameters({"chassis.mass": vehicle.physics.chassis.mass + 1})
    assert fmu.Unit(vehicle).token(2) != fmu.Unit(heavier).token(2)
    assert fmu.Unit(vehicle).token(2) != fmu.Unit(vehicle, plant=True).token(2)


def test_a_version_that_there_is_not_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="FMI 1"):
        fmu.write(vehicle, tmp_path / "unit.fmu", 1)


@pytest.mark.exam
def test_the_plant_moves_as_the_simulation_does(vehicle: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "plant.fmu"
    fmu.write(vehicle, path, 3, plant=True, optimised=QUICK)
    assert validate_fmu(str(path)) == []
    unit = fmu_check.Running(path, fmu.Unit(vehicle, plant=True), 3, 15.0)
    inputs = np.array([0.02, 0.0, 0.0, 40.0, 40.0, 0.0])
    truth = simulate(vehicle, lambda *_: inputs, 1.0, step=fmu.PLANT_STEP, **_start(vehicle, unit))
    unit.set("steering", inputs[:1])
    unit.set("torque", inputs[1:5])
    for k in range(100):
        unit.step(0.01 * k, 0.01)
    found = unit.get("state")
    assert found[:14] == pytest.approx(truth.q[-1], rel=1e-6, abs=1e-6)
    assert found[14:28] == pytest.approx(truth.u[-1], rel=1e-6, abs=1e-6)
    unit.close()
    assert car_of(vehicle)


def _start(vehicle: Vehicle, unit: fmu_check.Running) -> dict[str, np.ndarray]:
    state = unit.get("state")
    return {"q": state[:14], "u": state[14:28]}


@pytest.mark.exam
def test_libcosim_drives_the_plant_as_fmpy_does(vehicle: Vehicle, tmp_path: Path) -> None:
    """The co-simulation engine of the Open Simulation Platform, which reads FMI 2."""
    pytest.importorskip("libcosimpy", reason="libcosimpy is not installed here (requirements/hw.txt)")
    path = tmp_path / "plant.fmu"
    fmu.write(vehicle, path, 2, plant=True, optimised=QUICK)
    theirs, ours = fmu_tools.by_libcosim(path), fmu_tools.by_fmpy(path)
    assert theirs == pytest.approx(ours, rel=1e-9)
    assert abs(ours[fmu_tools.ASKED.index("state.rate_z")]) > 0.1


@pytest.mark.exam
def test_the_importer_of_the_reference_fmus_drives_the_plant_as_fmpy_does(vehicle: Vehicle, tmp_path: Path) -> None:
    """In C, by Modelica; of FMI 3, which libcosim does not read."""
    checkout = fmu_tools.reference_importer()
    if checkout is None:
        pytest.skip("REFERENCE_FMUS names no checkout of github.com/modelica/Reference-FMUs")
    path = tmp_path / "plant.fmu"
    fmu.write(vehicle, path, 3, plant=True, scalars=True, optimised=QUICK)
    theirs, ours = fmu_tools.by_reference_importer(path, checkout), fmu_tools.by_fmpy(path)
    assert theirs == pytest.approx(ours, rel=1e-9)


@pytest.mark.exam
def test_two_cars_in_one_process_each_carry_their_own_weight(vehicle: Vehicle) -> None:
    assert fmu_tools.two_cars_in_one_process(vehicle, QUICK)


_TWO_CARS_LINKED = """
#include <stdio.h>
#include "fmi3FunctionTypes.h"
#define CAR(x) extern fmi3InstantiateCoSimulationTYPE x##_fmi3InstantiateCoSimulation; \\
    extern fmi3EnterInitializationModeTYPE x##_fmi3EnterInitializationMode; \\
    extern fmi3ExitInitializationModeTYPE x##_fmi3ExitInitializationMode; \\
    extern fmi3GetFloat64TYPE x##_fmi3GetFloat64; \\
    static void x(const char *token) { \\
        const fmi3ValueReference force = FORCE; \\
        double z[4] = {0}; \\
        fmi3Instance car = x##_fmi3InstantiateCoSimulation("car", token, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0); \\
        x##_fmi3EnterInitializationMode(car, 0, 0, 0, 0, 0); \\
        x##_fmi3ExitInitializationMode(car); \\
        x##_fmi3GetFloat64(car, &force, 1, z, 4); \\
        printf("%.9g ", z[0] + z[1] + z[2] + z[3]); \\
    }
CAR(light)
CAR(heavy)
int main(int n, char **v) { (void)n; light(v[1]); heavy(v[2]); return 0; }
"""


@pytest.mark.exam
def test_the_sources_of_two_cars_are_linked_into_one_program(vehicle: Vehicle, tmp_path: Path) -> None:
    """By FMI3_FUNCTION_PREFIX, as the standard has it for units that are linked statically."""
    mass, compiler, objects, tokens = vehicle.physics.chassis.mass, codegen.compiler() or "", [], []
    for name, factor in (("light", 1.0), ("heavy", 1.5)):
        car = vehicle.with_parameters({"chassis.mass": factor * mass}).model_copy(update={"name": name})
        unit, folder = fmu.Unit(car, plant=True), tmp_path / name
        folder.mkdir()
        unit.sources(3, folder)
        tokens.append(unit.token(3))
        for source in unit.compiled(3):
            objects.append(str(folder / f"{source}.o"))
            command = [compiler, "-std=c99", QUICK, f"-DFMI3_FUNCTION_PREFIX={name}_", "-c", str(folder / source)]
            subprocess.run([*command, "-o", objects[-1]], check=True)
    (tmp_path / "two.c").write_text(_TWO_CARS_LINKED)
    force = [variable.name for variable in unit.variables].index("wheel_force_z")
    command = [compiler, f"-DFORCE={force}", f"-I{tmp_path / 'light'}", str(tmp_path / "two.c"), *objects]
    subprocess.run([*command, "-o", str(tmp_path / "two"), "-lm"], check=True)
    printed = subprocess.run([str(tmp_path / "two"), *tokens], check=True, capture_output=True, text=True).stdout
    assert [float(weight) for weight in printed.split()] == pytest.approx(
        [9.80665 * f * mass for f in (1.0, 1.5)], rel=0.01
    )
