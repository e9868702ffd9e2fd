"""Units in FMPy, libcosim and the C importer of Modelica's Reference FMUs; two cars in one process.

That importer (github.com/modelica/Reference-FMUs) is not packaged: `REFERENCE_FMUS` names a checkout of it."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np

from vsense_ros.export import fmu, fmu_check
from vsense_ros.model.vehicle import Vehicle

GIVEN = {"steering.steering": 0.05, "torque.torque_rl": 100.0, "torque.torque_rr": 100.0}
ASKED = ("state.velocity_x", "state.velocity_y", "state.rate_z", "wheel_force_y.fl")
# In a process of its own: the library ends the one that it is in where it finds no unit.
_BY_LIBCOSIM = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

path, given, *asked = sys.argv[1:]
execution = CosimExecution.from_step_size(step_size=4e6)  # [ns]
car = execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="car"))
of = {variable.name.decode(): variable.reference for variable in execution.slave_variables(car)}
given = json.loads(given)
setting, reading = CosimManipulator.create_override(), CosimObserver.create_last_value()
execution.add_manipulator(setting)
execution.add_observer(reading)
assert setting.slave_real_values(car, [of[name] for name in given], list(given.values()))
assert execution.simulate_until(target_time=1e9)
print("found", *reading.last_real_values(car, [of[name] for name in asked]))
"""
# It loads every function of FMI 3, and refuses a library that lacks one.
_BY_REFERENCE = """
#include <stdio.h>
#include <stdlib.h>
#include "FMI3.h"
static void say(FMIInstance *car, FMIStatus status, const char *category, const char *message) {
    (void)car; (void)category;
    fprintf(stderr, "%d %s\\n", status, message);
}
#define DONE(call) do { if ((call) > FMIWarning) { fprintf(stderr, "%s\\n", #call); return 1; } } while (0)
int main(int n, char **v) { /* library, token, given as REFERENCE VALUE, "--", asked */
    FMIInstance *car = FMICreateInstance("car", say, NULL);
    fmi3Boolean event, ends, early;
    fmi3Float64 reached, value;
    fmi3ValueReference r;
    int k = 3;
    if (!car) return 1;
    DONE(FMILoadPlatformBinary(car, v[1]));
    DONE(FMI3InstantiateCoSimulation(car, v[2], NULL, fmi3False, fmi3False, fmi3False, fmi3False, NULL, 0, NULL));
    for (; v[k][0] != '-'; k += 2) {
        r = (fmi3ValueReference)atol(v[k]); value = atof(v[k + 1]);
        DONE(FMI3SetFloat64(car, &r, 1, &value, 1));
    }
    DONE(FMI3EnterInitializationMode(car, fmi3False, 0.0, 0.0, fmi3True, 1.0));
    DONE(FMI3ExitInitializationMode(car));
    for (int i = 0; i < 250; i++) DONE(FMI3DoStep(car, 0.004 * i, 0.004, fmi3True, &event, &ends, &early, &reached));
    for (k++; k < n; k++) {
        r = (fmi3ValueReference)atol(v[k]);
        DONE(FMI3GetFloat64(car, &r, 1, &value, 1));
        printf("%.17g ", value);
    }
    DONE(FMI3Terminate(car));
    FMI3FreeInstance(car);
    FMIFreeInstance(car);
    return 0;
}
"""


def reference_importer() -> Path | None:
    """The checkout of the Reference FMUs, if there is one."""
    place = os.environ.get("REFERENCE_FMUS")
    return Path(place) if place else None


def by_reference_importer(path: Path, checkout: Path) -> list[float]:
    """What a plant of FMI 3 with scalars has of `ASKED` after a second, by the C importer of the Reference FMUs."""
    references = {one.name: one.valueReference for one in fmpy.read_model_description(str(path)).modelVariables}
    token = fmpy.read_model_description(str(path)).instantiationToken
    with TemporaryDirectory() as place:
        folder = Path(place)
        (binary,) = Path(fmpy.extract(str(path), str(folder / "unit"))).rglob("*.so")
        (folder / "drive.c").write_text(_BY_REFERENCE, encoding="utf-8")
        sources = [folder / "drive.c", checkout / "src/FMI.c", checkout / "src/FMI3.c"]
        command = [
            "cc",
            "-DFMI_VERSION=3",
            f"-I{checkout / 'include'}",
            *map(str, sources),
            "-o",
            str(folder / "drive"),
        ]
        subprocess.run([*command, "-ldl", "-lm"], check=True, capture_output=True)
        given = [str(word) for name, value in GIVEN.items() for word in (references[name], value)]
        asked = [str(references[name]) for name in ASKED]
        program = [str(folder / "drive"), str(binary), token, *given, "--", *asked]
        done = subprocess.run(program, capture_output=True, text=True, timeout=120, check=True)
    return [float(word) for word in done.stdout.split()]


def by_fmpy(path: Path) -> list[float]:
    """What a plant has of `ASKED` after a second, by FMPy."""
    last = fmpy.simulate_fmu(
        str(path), stop_time=1.0, step_size=0.004, output_interval=0.004, start_values=GIVEN, output=list(ASKED)
    )[-1]
    return [float(last[name]) for name in ASKED]


def by_libcosim(path: Path) -> list[float]:
    """What it has by libcosim, the co-simulation engine of the Open Simulation Platform, which reads FMI 2."""
    program = [sys.executable, "-c", _BY_LIBCOSIM, str(path), json.dumps(GIVEN), *ASKED]
    done = subprocess.run(program, capture_output=True, text=True, timeout=120, check=True)
    (said,) = (line for line in done.stdout.splitlines() if line.startswith("found "))
    return [float(word) for word in said.split()[1:]]


def tools(vehicle: Vehicle, optimised: str = fmu.OPTIMISED) -> dict[str, bool]:
    """True for each tool that drives the car to where FMPy has it, and for FMPy if it finds the units valid."""
    with TemporaryDirectory() as folder:
        units = {version: Path(folder) / f"plant{version}.fmu" for version in fmu.VERSIONS}
        for version, path in units.items():
            fmu.write(vehicle, path, version, plant=True, scalars=True, optimised=optimised)
        found = {"fmpy": not any(fmpy.validation.validate_fmu(str(path)) for path in units.values())}
        others = {}
        if find_spec("libcosimpy") is not None:
            others["libcosim"] = by_libcosim(units[2]), by_fmpy(units[2])
        if (checkout := reference_importer()) is not None:
            others["reference importer"] = by_reference_importer(units[3], checkout), by_fmpy(units[3])
    return found | {name: bool(np.allclose(*both, rtol=1e-9, atol=0.0)) for name, both in others.items()}


def two_cars_in_one_process(vehicle: Vehicle, optimised: str = fmu.OPTIMISED) -> bool:
    """True if two plants in one process, each loaded for all to see, carry the weight of their own cars."""
    mass = vehicle.physics.chassis.mass
    cars = [vehicle, vehicle.with_parameters({"chassis.mass": 1.5 * mass})]
    weights = []
    with TemporaryDirectory() as folder:
        running = []
        for k, car in enumerate(cars):
            path = Path(folder) / f"{k}.fmu"
            fmu.write(car, path, 3, plant=True, optimised=optimised)
            (binary,) = Path(fmpy.extract(str(path), str(Path(folder) / str(k)))).rglob("*.so")
            ctypes.CDLL(str(binary), mode=ctypes.RTLD_GLOBAL)
            running.append(fmu_check.Running(path, fmu.Unit(car, plant=True), 3))
        for unit in running:
            weights.append(float(unit.get("wheel_force_z").sum()))
            unit.close()
    expected = [9.80665 * factor * mass for factor in (1.0, 1.5)]
    return bool(np.allclose(weights, expected, rtol=0.01))
