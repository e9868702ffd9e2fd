"""The car's equations of motion against Pinocchio on a tree that is built here from the vehicle file's numbers.

Contact points, tyre kinematics, springs, gravity and drag are computed a second time too, in world coordinates.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pinocchio_car import PIN_ORDER, VERTICAL, G, Twin
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.steps import dynamics_function
from vsense_ros.model.coordinates import BANK_CHANGE, GRADE_CHANGE, INPUTS, RADIUS_ERROR, STEERING_OFFSET
from vsense_ros.model.effects import Effects
from vsense_ros.model.parameter import symbols, vector
from vsense_ros.model.tyres import TMeasy, TyreInput
from vsense_ros.model.vehicle import Vehicle

pin = pytest.importorskip("pinocchio", reason="the oracle Pinocchio is not installed (pip install pin)")

seeds = st.integers(0, 2**32 - 1)
relaxed = settings(deadline=None, max_examples=30)


@cache
def tyre_function(tyre: TMeasy) -> ca.Function:
    p, symbolic = symbols(tyre)
    free = ca.SX.sym("a", 5)
    return ca.Function("tyre", [p, free], [ca.vertcat(*symbolic.forces(TyreInput(*ca.vertsplit(free))))])


def tyre_forces(tyre: TMeasy, *arguments: float) -> np.ndarray:
    return np.asarray(tyre_function(tyre)(vector(tyre), list(arguments)))[:, 0]


def road_under(vehicle: Vehicle, wheel: int, q: np.ndarray, disturbances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal of the surface z = κ x²/2 + τ x y below a wheel, and a point of it, both in world coordinates."""
    chassis, axle = vehicle.physics.chassis, (vehicle.physics.front, vehicle.physics.rear)[wheel // 2]
    x = chassis.cog_to_front_axle if wheel < 2 else -chassis.cog_to_rear_axle
    y = (1 - 2 * (wheel % 2)) * axle.track / 2
    bend, twist = disturbances[[GRADE_CHANGE, BANK_CHANGE]]
    turn, gradient = pin.exp3(VERTICAL * q[5]), np.array([bend * x + twist * y, twist * x])
    normal = np.array([*-gradient, 1.0]) / np.sqrt(1 + gradient @ gradient)
    return turn @ normal, np.array([*q[:2], 0.0]) + turn @ [x, y, bend * x**2 / 2 + twist * x * y]


def expected_acceleration(vehicle: Vehicle, state: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of u (14), and outputs of the wheels (7×4), from world coordinates and Pinocchio."""
    q, u, disturbances, inputs, force = (state[k] for k in ("q", "u", "disturbances", "inputs", "force"))
    twin = Twin.of(vehicle, inputs[0] - disturbances[STEERING_OFFSET])
    model, data = twin.model, twin.data
    coordinates, v = twin.coordinates(q), u[PIN_ORDER]
    pin.forwardKinematics(model, data, coordinates, v)
    tau = np.zeros(14)
    external = pin.StdVec_Force()
    external.extend([pin.Force.Zero() for _ in range(model.njoints)])
    drag = 0.5 * 1.204 * vehicle.physics.aerodynamics.drag_area * abs(u[0]) * u[0]
    external[1] = pin.Force(force[:3] - [drag, 0, 0], force[3:6])
    outputs = np.zeros((7, 4))
    for i, axle in enumerate(twin.axles):
        wheel = data.oMi[3 + 2 * i]
        normal, on_plane = road_under(vehicle, i, q, disturbances)
        hub_velocity = pin.getVelocity(model, data, 2 + 2 * i, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        spindle = wheel.rotation[:, 1]
        ahead = np.cross(spindle, normal)
        ahead /= np.linalg.norm(ahead)
        left = np.cross(normal, ahead)
        down = np.cross(spindle, ahead)
        loaded = normal @ (on_plane - wheel.translation) / (normal @ down)
        contact = wheel.translation + loaded * down
        velocity = hub_velocity.linear + np.cross(hub_velocity.angular, contact - wheel.translation)
        unloaded = axle.unloaded_radius * (1 + disturbances[RADIUS_ERROR])
        load = axle.tyre_stiffness * (unloaded - loaded) - axle.tyre_damping * (velocity @ normal)
        load = max(load, 0.0) if unloaded > loaded else 0.0
        effective = axle.dynamic_radius_factor * unloaded + (1 - axle.dynamic_radius_factor) * loaded
        rolling = effective * u[10 + i]
        force_x, force_y, moment, slip_x, slip_y = tyre_forces(
            axle.tyre, load, ahead @ velocity, left @ velocity, rolling, vehicle.physics.road.friction
        )
        inclination = np.arccos(np.clip(spindle @ normal, -1, 1))
        outputs[:, i] = force_x, force_y, load, moment, slip_x, -np.arctan(slip_y), np.pi / 2 - inclination
        drop = axle.rolling_resistance * load * effective * rolling / np.hypot(rolling, axle.tyre.standstill_speed)
        tyre_force = force_x * ahead + force_y * left + load * normal
        tyre_moment = moment * normal - drop * spindle + np.cross(contact - wheel.translation, tyre_force)
        external[3 + 2 * i] = pin.Force(wheel.rotation.T @ tyre_force, wheel.rotation.T @ tyre_moment)
        unsprung = (axle.hub_mass + axle.wheel_mass) * G
        other = i + 1 if i % 2 == 0 else i - 1
        tau[6 + 2 * i] = (
            -(twin.static_loads[i] - unsprung) * twin.guides[i][2]
            - axle.suspension_stiffness * q[6 + i]
            - axle.suspension_damping * u[6 + i]
            - axle.antiroll_stiffness * (q[6 + i] - q[6 + other])
            + force[6 + i]
        )
        tau[7 + 2 * i] = inputs[1 + i] + force[10 + i]
    along, across = np.sin(disturbances[:2])
    road = -G * np.array([along, across, np.sqrt(1 - along**2 - across**2)])
    model.gravity = pin.Motion(pin.exp3(VERTICAL * q[5]) @ road, np.zeros(3))
    result = np.zeros(14)
    result[PIN_ORDER] = pin.aba(model, data, coordinates, v, tau, external)
    return result, outputs


@pytest.fixture(scope="session")
def dynamics(car: Car) -> ca.Function:
    return dynamics_function(car)


@relaxed
@given(seed=seeds)
def test_accelerations_and_tyre_forces_of_the_driving_car_agree_with_pinocchio(seed, vehicle, driving, dynamics):
    state = driving(seed)
    expected, outputs = expected_acceleration(vehicle, state)

    acceleration, wheels = (np.asarray(r) for r in dynamics(*state.values()))

    scale = np.abs(outputs).max(axis=1, keepdims=True) + 1e-6
    assert_allclose(wheels / scale, outputs / scale, rtol=1e-9, atol=1e-9)
    assert_allclose(acceleration[:, 0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@relaxed
@given(seed=seeds)
def test_the_car_in_the_air_under_any_forces_agrees_with_pinocchio(seed, vehicle, driving, dynamics):
    state = driving(seed)
    random = np.random.default_rng(seed)
    state["q"][2] = 3.0
    state["q"][3:5] = random.uniform(-1.2, 1.2, 2)
    state["u"] *= 3
    state["force"] *= 20
    expected, outputs = expected_acceleration(vehicle, state)
    assert not outputs[:4].any()

    acceleration, wheels = (np.asarray(r) for r in dynamics(*state.values()))

    assert not wheels[:4].any()
    assert_allclose(acceleration[:, 0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@relaxed
@given(seed=seeds)
def test_the_mass_matrix_of_the_car_agrees_with_pinocchio(seed, vehicle, car, driving):
    state = driving(seed)
    demand = np.random.default_rng(seed).normal(size=14)
    symbol = ca.SX.sym("a", 14)
    arguments = [car.q, car.inputs, car.disturbances, car.p, symbol]
    force = ca.Function("force", arguments, [car.inertia_times(symbol)])

    found = np.asarray(force(*(state[k] for k in ("q", "inputs", "disturbances", "p")), demand))[:, 0]

    twin = Twin.of(vehicle, state["inputs"][0] - state["disturbances"][STEERING_OFFSET])
    mass = pin.crba(twin.model, twin.data, twin.coordinates(state["q"]))
    mass = np.triu(mass) + np.triu(mass, 1).T
    expected = np.zeros(14)
    expected[PIN_ORDER] = mass @ demand[PIN_ORDER]
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("share", [-0.99, 0.05, 0.99], ids="of what tips it over {}".format)
def test_a_load_to_one_side_takes_its_inertia_with_it_as_in_pinocchio(share, vehicle):
    """Where the chassis of the twin is put to one side as it is; at every offset the mass matrix is one."""
    physics = vehicle.physics
    moment = share * physics.chassis.mass * physics.front.track / 2
    laden = vehicle.model_copy(
        update={"physics": physics.model_copy(update={"effects": Effects(payload_offset={"moment": moment})})}
    )
    car, demand = Car(laden), ca.SX.sym("a", 14)
    force = ca.Function("force", [car.q, car.inputs, car.disturbances, car.p, demand], [car.inertia_times(demand)])
    resting = np.zeros(14), np.zeros(len(INPUTS)), np.zeros(7), laden.parameter_vector()
    found = np.column_stack([np.asarray(force(*resting, unit))[:, 0] for unit in np.eye(14)])

    twin = Twin.of(vehicle, 0.0)
    chassis = twin.model.inertias[1]
    beside = np.add(chassis.lever, [0.0, moment / chassis.mass, 0.0])
    twin.model.inertias[1] = pin.Inertia(chassis.mass, beside, chassis.inertia)
    mass = pin.crba(twin.model, twin.data, twin.coordinates(np.zeros(14)))
    expected = np.zeros((14, 14))
    expected[np.ix_(PIN_ORDER, PIN_ORDER)] = np.triu(mass) + np.triu(mass, 1).T
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.linalg.eigvalsh(found).min() > 0


def test_the_parts_of_the_car_add_up_to_what_the_vehicle_file_says_of_the_whole(vehicle):
    twin = Twin.of(vehicle, 0.0)
    whole = pin.computeTotalMass(twin.model)
    centre = pin.centerOfMass(twin.model, twin.data, pin.neutral(twin.model))
    assert whole == pytest.approx(vehicle.physics.chassis.mass)
    assert_allclose(centre, 0, atol=1e-12)
