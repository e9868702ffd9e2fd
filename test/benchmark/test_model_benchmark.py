"""What one evaluation of the car costs: compiled, on the virtual machine, and beside general rigid-body libraries.

The libraries compute the forward dynamics of the same tree of bodies from given forces; ours also makes the forces:
contact geometry, tyres, springs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.model import codegen
from vsense_ros.model.car import Car, car_of
from vsense_ros.model.codegen import Kernel
from vsense_ros.model.steps import advance_function, dynamics_function, linearize_function
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.vehicle_file import load_vehicle

FUNCTIONS = {"dynamics": dynamics_function, "linearize": linearize_function, "advance": advance_function}


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(Path(__file__).parents[1] / "data/car.yaml")


def arguments(vehicle: Vehicle, name: str) -> list[np.ndarray]:
    """A car at 20 m/s, and for a step 10 ms, with a matrix that stands for any."""
    q, u = np.zeros(14), np.zeros(14)
    q[2] = vehicle.physics.chassis.cog_height
    u[0], u[10:] = 20.0, 20.0 / 0.34
    state = [q, u, np.zeros(14), np.zeros(4), np.zeros(5), vehicle.parameter_vector()]
    step = [np.array([0.01]), np.eye(14).ravel(), np.zeros(98)]
    return state + step if name == "advance" else state


def bound(car: Car, vehicle: Vehicle, name: str, compiled: bool) -> Kernel:
    function = FUNCTIONS[name](car)
    if compiled:
        (function,) = codegen.compiled(f"benchmark_{name}", [function], expand=True)
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


def bodies(vehicle: Vehicle) -> list[tuple[str, tuple[float, float, float], float, float]]:
    """Name, place, mass of the hub and mass of the wheel of each corner."""
    physics = vehicle.physics
    result = []
    for i, name in enumerate(("fl", "fr", "rl", "rr")):
        axle = physics.front if i < 2 else physics.rear
        along = physics.chassis.cog_to_front_axle if i < 2 else -physics.chassis.cog_to_rear_axle
        result.append((name, (along, (0.5 - i % 2) * axle.track, -0.3), axle.hub_mass, axle.wheel_mass))
    return result


def pinocchio(vehicle: Vehicle) -> Callable[[], object]:
    pin = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (pip install pin)")
    chassis = vehicle.physics.chassis
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "chassis")
    inertia = np.diag([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
    model.appendBodyToJoint(root, pin.Inertia(chassis.mass, np.zeros(3), inertia), pin.SE3.Identity())
    for name, place, hub_mass, wheel_mass in bodies(vehicle):
        hub = model.addJoint(root, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array(place)), f"hub_{name}")
        model.appendBodyToJoint(hub, pin.Inertia(hub_mass, np.zeros(3), np.eye(3) * 0.1), pin.SE3.Identity())
        wheel = model.addJoint(hub, pin.JointModelRY(), pin.SE3.Identity(), f"wheel_{name}")
        model.appendBodyToJoint(wheel, pin.Inertia(wheel_mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    data = model.createData()
    q, v, tau = pin.neutral(model), np.ones(model.nv), np.ones(model.nv)
    return lambda: pin.aba(model, data, q, v, tau)


def mujoco(vehicle: Vehicle) -> Callable[[], object]:
    mj = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install mujoco)")
    chassis = vehicle.physics.chassis

    def inertial(mass: float, x: float, y: float, z: float) -> str:
        return f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{x} {y} {z}"/>'

    corners = "".join(
        f'<body pos="{place[0]} {place[1]} {place[2]}">{inertial(hub, 0.1, 0.1, 0.1)}'
        f'<joint type="slide" axis="0 0 1"/><body>{inertial(wheel, 1, 1, 1)}'
        '<joint type="hinge" axis="0 1 0"/></body></body>'
        for _, place, hub, wheel in bodies(vehicle)
    )
    whole = inertial(chassis.mass, chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia)
    model = mj.MjModel.from_xml_string(
        f"<mujoco><worldbody><body>{whole}<freejoint/>{corners}</body></worldbody></mujoco>"
    )
    data = mj.MjData(model)
    data.qvel[:] = 1.0
    return lambda: mj.mj_forward(model, data)


@pytest.mark.parametrize("library", [pinocchio, mujoco])
def test_library(benchmark, vehicle, library):
    benchmark.group = "dynamics"
    benchmark(library(vehicle))
