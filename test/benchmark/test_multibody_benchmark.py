"""What a step of a mechanism costs: the car with all its bodies, and mechanisms with more and more bodies.

Functions are compiled where a compiler is found; without one the figures are those of CasADi's virtual machine.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from vsense_ros import codegen
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model import spatial
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.car.kinematic_tables import kinematic_tables
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.multibody.assembly import assemble
from vsense_ros.model.multibody.integrator import Integrator
from vsense_ros.model.multibody.joints import Revolute, Universal
from vsense_ros.model.multibody.mechanism import BASE, Base, Body, Distance, Linkage, Mechanism, Point
from vsense_ros.model.multibody.tree import Body as TreeBody
from vsense_ros.model.multibody.tree import Tree
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.model.vehicle import Vehicle

VEHICLES = Path(__file__).parents[2] / "config/vehicles"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(VEHICLES / "prototype_real.yaml")


@pytest.mark.benchmark(group="full car, 29 bodies")
@pytest.mark.parametrize("h", [0.004, 0.008])
def test_step_of_the_full_car_in_a_bend(benchmark: Any, vehicle: Vehicle, h: float) -> None:
    car = FullCar(vehicle)
    integrator = car.integrator(vehicle, h)
    integrator.state.dz[0] = 15.0
    for wheel in WHEELS:
        integrator.state.dz[car.spin_index(wheel)] = 15.0 / 0.269
    integrator.settle()
    time = 0.0

    def step() -> None:
        nonlocal time
        time += h
        integrator.guides[0, :] = 0.008 * np.sin(time), 0.008 * np.cos(time), -0.008 * np.sin(time)
        integrator.step()

    benchmark.pedantic(step, rounds=500, iterations=1, warmup_rounds=50)
    steps = max(1, round(time / h))
    benchmark.extra_info["calls_per_step"] = integrator.calls / steps


@pytest.mark.benchmark(group="kinematic tables")
def test_tables_of_both_axles(benchmark: Any, vehicle: Vehicle) -> None:
    benchmark.pedantic(lambda: kinematic_tables(vehicle), rounds=3)


def loop(name: str, mass: float) -> Linkage:
    """Two arms whose ends a rod holds together."""
    inertia = ca.SX.eye(3) * 0.05
    return Linkage(
        name,
        (
            Body("a", BASE, Revolute((0, 0, 0), (0, 1, 0)), mass, (0.2, 0, 0), inertia),
            Body("b", BASE, Universal((0, 0, 0.5), (0, 1, 0), (0, 0, 1)), mass, (0.2, 0, 0.5), inertia),
        ),
        (Distance("rod", Point("a", (0.4, 0, 0)), Point("b", (0.4, 0, 0.5)), 0.5),),
    )


@pytest.mark.benchmark(group="steps of loops on a floating base")
@pytest.mark.parametrize("branches", [2, 4, 8, 16])
def test_step_of_mechanisms_with_more_and_more_bodies(benchmark: Any, branches: int) -> None:
    linkage = loop("loop", 1.0)
    base = Base(100.0, (0, 0, 0), ca.SX.eye(3) * 30)
    mechanism = Mechanism(base, (linkage,) * branches)
    integrator = Integrator(mechanism, np.zeros(0), 0.002, name=f"loops_{branches}")
    start = assemble(linkage, np.zeros(0))
    for first in mechanism.offsets[:-1]:
        integrator.state.z[first : first + len(start)] = start
    integrator.gravity[:] = 0
    integrator.settle()
    benchmark.extra_info["bodies"] = mechanism.bodies
    benchmark.pedantic(integrator.step, rounds=200, iterations=5, warmup_rounds=10)


def spread_tree(branches: int, random: np.random.Generator) -> Tree:
    """Branches of four bodies on a floating root, one joint each."""
    bodies = []
    for _ in range(branches):
        for i in range(4):
            axis = random.normal(size=6)
            rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
            inertia = spatial.rigid_inertia(ca.SX(1.0), ca.SX(random.normal(size=3) * 0.1), ca.SX.eye(3) * 0.05)
            place = ca.SX(random.normal(size=3))
            bodies.append(TreeBody("b", len(bodies) - 1 if i else -1, ca.SX(axis), ca.SX(rotation), place, inertia))
    return Tree(spatial.rigid_inertia(ca.SX(10.0), ca.SX(3, 1), ca.SX.eye(3)), tuple(bodies))


@pytest.mark.benchmark(group="forward dynamics of open trees")
@pytest.mark.parametrize("branches", [2, 4, 8, 16])
def test_forward_dynamics_of_trees_with_more_and_more_bodies(benchmark: Any, branches: int) -> None:
    tree = spread_tree(branches, np.random.default_rng(1))
    n = len(tree.bodies)
    velocity, rates, efforts = ca.SX.sym("v", 6), ca.SX.sym("rates", n), ca.SX.sym("efforts", n)
    root, joints = tree.forward_dynamics(velocity, rates, efforts, ca.SX(6, 1), [ca.SX(6, 1)] * n)
    function = codegen.function("tree", [velocity, rates, efforts], [root, joints], ("v", "rates", "efforts"))
    (function,) = codegen.compiled(f"tree_{n}", [function])
    kernel = codegen.Kernel(function, [np.ones(6), np.ones(n), np.ones(n)])
    benchmark.extra_info["bodies"] = n + 1
    benchmark.pedantic(kernel.call, rounds=300, iterations=100, warmup_rounds=10)
    assert np.all(np.isfinite(kernel.results[1]))


@pytest.mark.benchmark(group="full car, 29 bodies")
def test_correction_of_the_full_car_by_an_observer(benchmark: Any, vehicle: Vehicle) -> None:
    plant = FullCarPlant(vehicle, 0.004)
    q, u = rolling_straight(vehicle, 12.0)
    plant.place(q, u, np.zeros(6))
    q, u = plant.q + 1e-4, plant.u + 1e-3
    benchmark.pedantic(plant.correct, args=(q, u), rounds=300, warmup_rounds=10)
