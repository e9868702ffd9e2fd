"""GNSS/INS filters as C99: the same calls to the sources and to the filter in Python."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.export.state_space import write
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS

compiler = codegen.compiler()


@pytest.mark.skipif(compiler is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")
@pytest.mark.parametrize("name", ["yaw_kkf", "integrated", "strapdown"])
def test_the_sources_do_what_the_filter_in_python_does(name: str, tmp_path: Path) -> None:
    car = load_vehicle(vehicle_path("prototype_model"))
    files = write(car, name, tmp_path)
    library = tmp_path / "filter.so"
    options = ["-std=c99", "-O2", "-Wall", "-Werror", "-Wno-unused-function", "-shared", "-fPIC"]
    subprocess.run(["cc", *options, str(tmp_path / f"{name}.c"), "-o", str(library), "-lm"], check=True)
    assert {file.suffix for file in files} == {".c", ".h"}
    definition, numbers = DEFINITIONS[name][1], car_numbers(car, car.sensing().values())
    ours: Any = definition.make(numbers)
    ours.start(definition.start(numbers))
    ((system, measurements),) = definition.parts.values()
    n, e, k, p = len(system.names), len(system.error_names), len(system.inputs), len(system.parameters)
    found = ctypes.CDLL(str(library))
    found.vsense_correct.restype = ctypes.c_double
    memory = np.zeros(n + e * e + max(k, 1) + max(p, 1))
    at = memory.ctypes.data
    found.vsense_start(ctypes.c_void_p(at))
    random = np.random.default_rng(0)
    if "forward_velocity" in system.names:
        memory[system.names.index("forward_velocity")] = ours.mean[system.names.index("forward_velocity")] = 12.0
    for i in range(300):
        u = 0.05 * random.normal(size=k)
        memory[n + e * e : n + e * e + k] = ours.inputs[:] = u
        assert found.vsense_predict(ctypes.c_void_p(at), ctypes.c_double(0.01))
        ours.predict(0.01)
        which = i % len(measurements)
        one = measurements[which]
        value, variance = 0.1 * random.normal(size=len(one.deviations)), np.maximum(one.variances, 1e-4)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (value, variance)]
        nis = found.vsense_correct(ctypes.c_void_p(at), which, *pointers, ctypes.c_double(1e9))
        assert nis == pytest.approx(ours.correct(one.name, value, variance, 1e9).nis, rel=1e-6, abs=1e-9)
    assert memory[:n] == pytest.approx(ours.mean, rel=1e-8, abs=1e-9)
    assert memory[n : n + e * e].reshape(e, e) == pytest.approx(ours.covariance, rel=1e-6, abs=1e-12)


def test_a_cascade_is_not_written(tmp_path: Path) -> None:
    car = load_vehicle(vehicle_path("prototype_model"))
    with pytest.raises(InputError, match="dual_kkf: only an extended Kalman filter of one state space"):
        write(car, "dual_kkf", tmp_path)
