"""What a step costs beside general libraries: of the 14-DOF car, of its observer, of the car with all its bodies.

Pinocchio and MuJoCo move the same tree of bodies by given forces; ours also makes the forces: contact geometry, tyres,
springs. filterpy's filters get a linear model of 42 states and 10 measurements for nothing; ours has 52 states and
makes its model and Jacobians anew in each step. `STEPS` in tools/benchmarks.py puts these results and those of the SPI
observer into one table.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.export import c, check
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.car.steps import model_functions
from vsense_ros.model.coordinates import DISTURBANCES, WHEELS
from vsense_ros.model.simulation.closed_loop import rolling_radii, rolling_straight
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.sensors import sensors_of

VEHICLES = Path(__file__).parents[2] / "config/vehicles"
STEP = 0.004  # [s]
SPEED = 15.0  # [m/s]
STATES, MEASUREMENTS = 42, 10  # of the general filters
pytestmark = [
    pytest.mark.benchmark(group="step"),
    pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0"),
]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    """The observer's car, whose wheels move by tables of the prototype's linkages."""
    found = load_vehicle(VEHICLES / "prototype_model.yaml")
    assert found.suspension is not None
    return found


def test_forward_dynamics(benchmark: Any, vehicle: Vehicle) -> None:
    car = car_of(vehicle)
    q, u = rolling_straight(vehicle, SPEED)
    arguments = [q, u, np.zeros(14), np.zeros(len(DISTURBANCES)), np.zeros(6), vehicle.parameter_vector(), np.zeros(0)]
    kernel = Kernel(model_functions(car)["dynamics"], arguments)
    benchmark(kernel.call)
    assert np.isfinite(kernel.results[0]).all()


def bodies(vehicle: Vehicle) -> list[tuple[str, tuple[float, float, float], float, float]]:
    """Name, place, mass of the hub and mass of the wheel of each corner."""
    physics = vehicle.physics
    result = []
    for i, name in enumerate(WHEELS):
        axle = physics.front if i < 2 else physics.rear
        along = physics.chassis.cog_to_front_axle if i < 2 else -physics.chassis.cog_to_rear_axle
        result.append((name, (along, (0.5 - i % 2) * axle.track, -0.3), axle.hub_mass, axle.wheel_mass))
    return result


def pinocchio_aba(vehicle: Vehicle) -> Callable[[], object]:
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


def mujoco_step(vehicle: Vehicle) -> Callable[[], object]:
    mj = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install mujoco)")
    chassis = vehicle.physics.chassis

    def inertial(mass: float, x: float, y: float, z: float) -> str:
        return f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{x} {y} {z}"/>'

    corners = "".join(
        f'<body pos="{place[0]} {place[1]} {place[2]}">{inertial(hub, 0.1, 0.1, 0.1)}'
        f'<joint type="slide" axis="0 0 1" stiffness="20000" damping="1500"/><body>{inertial(wheel, 1, 1, 1)}'
        '<joint type="hinge" axis="0 1 0"/></body></body>'
        for _, place, hub, wheel in bodies(vehicle)
    )
    whole = inertial(chassis.mass, chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia)
    model = mj.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" gravity="0 0 0"/>'
        f"<worldbody><body>{whole}<freejoint/>{corners}</body></worldbody></mujoco>"
    )
    assert model.nv == 14
    data = mj.MjData(model)
    data.qvel[0] = SPEED
    return lambda: mj.mj_step(model, data)


@pytest.mark.parametrize("function", [pinocchio_aba, mujoco_step])
def test_rigid_bodies(benchmark: Any, vehicle: Vehicle, function: Callable[[Vehicle], Callable[[], object]]) -> None:
    benchmark(function(vehicle))


def observer_step(observer: CarFilter | check.Exported, vehicle: Vehicle) -> Callable[[], None]:
    """Predict, linearize, correct by IMU and wheel speeds, of a car that keeps its speed."""
    sensors = sensors_of(vehicle)
    measured = {"imu": np.array([0, 0, 0, 0, 0, 9.80665]), "wheel_speeds": SPEED / rolling_radii(vehicle)}
    known = [(name, value, sensors[name].deviations() ** 2, 1e9) for name, value in measured.items()]
    if isinstance(observer, CarFilter):
        observer.start_rolling(SPEED)
    else:
        observer.start(SPEED)
        observer.linearize()
    alone = isinstance(observer, check.Exported)  # whose predictions do not linearise

    def step() -> None:
        observer.predict(STEP)
        if alone:
            observer.linearize()
        for what in known:
            observer.correct(*what)

    return step


def test_error_ekf(benchmark: Any, vehicle: Vehicle) -> None:
    ekf = FILTERS["error_ekf"].make(vehicle, sensors_of(vehicle))
    benchmark(observer_step(ekf, vehicle))
    assert ekf.car.mean[14] == pytest.approx(SPEED, abs=0.5)


def test_spi(benchmark: Any, vehicle: Vehicle) -> None:
    """Two parameters, by exact derivatives."""
    estimated = {"chassis.mass": {"deviation": 100.0}, "road.friction": {"deviation": 0.2, "lower": 0.1}}
    raw = vehicle.model_dump()
    raw["observer"] |= {"parameters": estimated, "parameter_filter": "ekf"}
    known = Vehicle.model_validate(raw)
    spi = FILTERS["spi"].make(known, sensors_of(known))
    benchmark(observer_step(spi, known))
    assert spi.car.mean[14] == pytest.approx(SPEED, abs=0.5)


@pytest.mark.parametrize("flags", ["-std=c99 -O3", "-std=gnu99 -O3 -march=native"])
def test_exported(benchmark: Any, vehicle: Vehicle, tmp_path: Path, flags: str) -> None:
    c.write(vehicle, tmp_path)
    exported = check.Exported(vehicle, check.build(tmp_path, tuple(flags.split())))
    benchmark(observer_step(exported, vehicle))
    assert exported.parts["state"][14] == pytest.approx(SPEED, abs=0.5)


@pytest.mark.parametrize("kind", ["none", "ekf", "ukf"])
def test_full_car_observer(benchmark: Any, vehicle: Vehicle, kind: str) -> None:
    raw = vehicle.model_dump()
    raw["observer"]["surroundings"] |= {"radius_error": 0.0, "radius_error_drift": 0.0}
    if kind != "none":
        estimated = {"chassis.mass": {"deviation": 100.0}, "road.friction": {"deviation": 0.2, "lower": 0.1}}
        raw["observer"] |= {"parameters": estimated, "parameter_filter": kind}
    known = Vehicle.model_validate(raw)
    observer = FILTERS["full_error_ekf" if kind == "none" else "full_spi"].make(known, sensors_of(known))
    benchmark(observer_step(observer, known))
    assert observer.car.mean[14] == pytest.approx(SPEED, abs=0.5)


def linear_model() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition, observation and a measurement of a stable system."""
    random = np.random.default_rng(0)
    transition = 0.99 * np.linalg.qr(random.normal(size=(STATES, STATES)))[0]
    return transition, random.normal(size=(MEASUREMENTS, STATES)), random.normal(size=MEASUREMENTS)


def filterpy_ekf() -> Callable[[], None]:
    from filterpy.kalman import ExtendedKalmanFilter

    made = ExtendedKalmanFilter(STATES, MEASUREMENTS)
    made.F, observation, measured = linear_model()
    made.Q *= 1e-3
    column = measured[:, None]

    def step() -> None:
        made.predict()
        made.update(column, lambda _: observation, lambda x: observation @ x)

    return step


def filterpy_ukf() -> Callable[[], None]:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    transition, observation, measured = linear_model()
    points = MerweScaledSigmaPoints(STATES, alpha=1.0, beta=2.0, kappa=0.0)
    made = UnscentedKalmanFilter(
        STATES, MEASUREMENTS, STEP, lambda x: observation @ x, lambda x, _: transition @ x, points
    )
    made.Q *= 1e-3

    def step() -> None:
        made.predict()
        made.update(measured)

    return step


@pytest.mark.parametrize("make", [filterpy_ekf, filterpy_ukf])
def test_general_filter(benchmark: Any, make: Callable[[], Callable[[], None]]) -> None:
    pytest.importorskip("filterpy", reason="filterpy is not installed")
    benchmark(make())


def test_full_car(benchmark: Any) -> None:
    """In a bend, steered all the time."""
    vehicle = load_vehicle(VEHICLES / "prototype_real.yaml")
    car = FullCar(vehicle)
    integrator = car.integrator(vehicle, STEP)
    integrator.state.dz[0] = SPEED
    for wheel in WHEELS:
        integrator.state.dz[car.spin_index(wheel)] = SPEED / vehicle.physics.front.unloaded_radius
    integrator.settle()
    time = 0.0

    def step() -> None:
        nonlocal time
        time += STEP
        integrator.guides[0, :] = 0.008 * np.sin(time), 0.008 * np.cos(time), -0.008 * np.sin(time)
        integrator.step()

    benchmark.pedantic(step, rounds=500, iterations=1, warmup_rounds=50)
