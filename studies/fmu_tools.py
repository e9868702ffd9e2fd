"""Units in tools that are not ours: FMPy and libcosim, and two cars in one process."""

from __future__ import annotations

import ctypes
import json
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


def by_fmpy(path: Path) -> list[float]:
    """What a plant of FMI 2 has of `ASKED` after a second, by FMPy."""
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


def tools(path: Path) -> dict[str, bool]:
    """True for each tool that drives a plant of FMI 2 to the same place, and for FMPy if it finds the unit valid."""
    own = by_fmpy(path)
    found = {"fmpy": not fmpy.validation.validate_fmu(str(path))}
    if find_spec("libcosimpy") is not None:
        found["libcosim"] = bool(np.allclose(by_libcosim(path), own, rtol=1e-9, atol=0.0))
    return found


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
