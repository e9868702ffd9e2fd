"""What one evaluation of the car costs: compiled, and on the virtual machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.mismatch.effect_parameters import with_all_effects
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.car.steps import advance_function, dynamics_function, linearize_function
from vsense_ros.model.coordinates import DISTURBANCES
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop, Run
from vsense_ros.model.vehicle import Vehicle

FUNCTIONS = {"dynamics": dynamics_function, "linearize": linearize_function, "advance": advance_function}


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(Path(__file__).parents[1] / "data/car.yaml")


def arguments(vehicle: Vehicle, name: str) -> list[np.ndarray]:
    """A car at 20 m/s, and for a step 10 ms, with a matrix that stands for any."""
    q, u = np.zeros(14), np.zeros(14)
    q[2] = vehicle.physics.chassis.cog_height
    u[0], u[10:] = 20.0, 20.0 / 0.34
    state = [q, u, np.zeros(14), np.zeros(len(DISTURBANCES)), np.zeros(6), vehicle.parameter_vector(), np.zeros(0)]
    step = [np.array([0.01]), np.eye(14).ravel(), np.zeros(98)]
    return state + step if name == "advance" else state


def bound(car: Car, vehicle: Vehicle, name: str, compiled: bool) -> Kernel:
    function = FUNCTIONS[name](car)
    if compiled:
        (function,) = codegen.compiled(f"benchmark_{name}", [function])
        if not function.is_a("External", False):
            pytest.skip("needs a C compiler and VSENSE_COMPILE other than 0")
    return Kernel(function, arguments(vehicle, name))


@pytest.mark.parametrize("way", ["compiled", "virtual machine"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_model(benchmark, vehicle, name, way):
    kernel = bound(car_of(vehicle), vehicle, name, way == "compiled")
    benchmark.group = name
    benchmark(kernel.call)
    assert all(np.all(np.isfinite(result)) for result in kernel.results)


@pytest.mark.parametrize("count", [1, 8])
def test_runs_of_the_mismatch_search(benchmark, vehicle, count):
    """Ten seconds in a bend, in steps as the search takes them, with every effect."""
    vehicle = with_all_effects(vehicle)
    loop, (q, u, *_) = OpenLoop(car_of(vehicle)), arguments(vehicle, "dynamics")
    steering = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    driving = Inputs(0.005, np.tile(steering, (2000, 1)), np.zeros((2000, 7)))
    benchmark.group = "runs of the mismatch search, 10 s each, side by side"
    motions = benchmark(loop.runs, [Run(q, u, driving, vehicle.parameter_vector())] * count)
    assert all(np.all(np.isfinite(motion.u)) for motion in motions)
