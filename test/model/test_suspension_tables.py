"""The car on suspension tables against Lagrange's equations of bodies whose places are written down here.

Places and attitudes of all bodies are functions of the coordinates alone; velocities, mass matrix, and centrifugal and
Coriolis forces come from differentiating them, and no joint, no motion subspace and no recursion are involved.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pydantic import ValidationError

from stepping import Stepper
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.kinematics import kinematics
from vsense_ros.model.car.steps import dynamics_function, force_function, linearize_function
from vsense_ros.model.coordinates import DYNAMIC_COORDINATES, TORQUES
from vsense_ros.model.parameter import symbols, vector
from vsense_ros.model.schema.suspension_tables import AxleTable, SuspensionTables
from vsense_ros.model.tyres import TMeasy, TyreInput
from vsense_ros.model.vehicle import Vehicle

G = 9.80665
LIMIT = 0.33  # [rad] of the steering
LOW, HIGH = -0.05, 0.07  # [m] of the travel
DESIGN = (LOW + HIGH) / (LOW - HIGH)  # position on the scale of the tables

seeds = st.integers(0, 2**32 - 1)
relaxed = settings(deadline=None, max_examples=25)


def spring_slope(c: np.ndarray) -> float:
    """Per travel, in the design position."""
    return float(
        np.polynomial.polynomial.polyval2d(DESIGN, 0.0, np.polynomial.polynomial.polyder(c)) * 2 / (HIGH - LOW)
    )


def axle_table(random: np.random.Generator, steered: bool) -> AxleTable:
    """Any smooth suspension, worse than built ones: several degrees of bump steer, inclination, anti-dive."""
    shape = (4, 4) if steered else (4, 1)
    size = {"x": 0.01, "y": 0.02, "camber": 0.05, "toe": 0.02, "caster": 0.05, "spring": 0.004}
    columns = {}
    for name, largest in size.items():
        c = random.uniform(-largest, largest, shape)
        if name == "spring":  # which moves with the wheel in the design position
            c[1, 0] += (HIGH - LOW) / 2 * (1 - spring_slope(c))
        if name == "toe" and steered:
            c[0, 1] = LIMIT
        if name in ("x", "y", "spring"):
            c[0, 0] -= np.polynomial.polynomial.polyval2d(DESIGN, 0.0, c)
        columns[name] = tuple(map(tuple, c.tolist()))
    return AxleTable(**columns)


@pytest.fixture(scope="module")
def tabled(vehicle: Vehicle) -> Vehicle:
    random = np.random.default_rng(2)
    tables = SuspensionTables(
        travel=(LOW, HIGH), steering=LIMIT, front=axle_table(random, True), rear=axle_table(random, False)
    )
    return vehicle.model_copy(update={"suspension": tables})


@pytest.fixture(scope="module")
def tabled_car(tabled: Vehicle) -> Car:
    return Car(tabled)


def column(tables: SuspensionTables, axle: AxleTable, name: str, travel: ca.SX, steering: ca.SX) -> ca.SX:
    """Sum of the powers within the table; beyond it the tangent."""
    low, high = tables.travel
    xi = (2 * travel - low - high) / (high - low)
    eta = ca.fmin(ca.fmax(steering / tables.steering, -1), 1)

    def value(x: ca.SX) -> ca.SX:
        rows = getattr(axle, name)
        return sum(c * x**i * eta**j for i, row in enumerate(rows) for j, c in enumerate(row))

    at, end = ca.SX.sym("at"), ca.fmin(ca.fmax(xi, -1), 1)
    slope = ca.substitute(ca.jacobian(value(at), at), at, end)
    return ca.if_else(ca.fabs(xi) <= 1, value(xi), value(end) + slope * (xi - end))


def turned(axis: int, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    result = ca.SX.eye(3)
    result[i, i], result[j, j], result[i, j], result[j, i] = c, c, -s, s
    return result


@dataclass
class Bodies:
    """Places of all bodies as functions of the coordinates (position and angles of the chassis, travels, spins)."""

    vehicle: Vehicle

    def __post_init__(self) -> None:
        physics, tables = self.vehicle.physics, self.vehicle.suspension
        assert tables is not None
        chassis = physics.chassis
        self.q, self.steering = ca.SX.sym("q", 14), ca.SX.sym("steering")
        q = self.q
        attitude = turned(2, q[5]) @ turned(1, q[4]) @ turned(0, q[3])
        wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
        self.axles = [physics.front, physics.front, physics.rear, physics.rear]
        self.loads, self.centres, self.wheels, self.springs = [], [], [], []
        parts = [
            (1.0, q[:3], attitude, chassis.mass, [chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        ]
        for i, axle in enumerate(self.axles):
            side = 1 if i % 2 == 0 else -1
            arm = chassis.cog_to_front_axle if i < 2 else -chassis.cog_to_rear_axle
            load = chassis.mass * G * (wheelbase - abs(arm)) / wheelbase / 2
            radius = axle.unloaded_radius - load / axle.tyre_stiffness
            design = ca.vertcat(arm, side * axle.track / 2, radius - chassis.cog_height)
            table = tables.front if i < 2 else tables.rear
            x, y, camber, toe, caster, spring = (
                column(tables, table, name, q[6 + i], side * self.steering)
                for name in ("x", "y", "camber", "toe", "caster", "spring")
            )
            hub = turned(2, side * toe) @ turned(0, -side * camber) @ turned(1, -caster)
            centre = q[:3] + attitude @ (design + ca.vertcat(x, side * y, q[6 + i]))
            wheel = attitude @ hub @ turned(1, q[10 + i])
            inertia = [axle.wheel_diametral_inertia, axle.wheel_spin_inertia, axle.wheel_diametral_inertia]
            # The file describes the whole car: the chassis lacks what hubs and wheels have in the design position.
            parts.append((-1.0, q[:3] + attitude @ design, attitude, axle.hub_mass + axle.wheel_mass, inertia))
            parts.append((1.0, centre, attitude, axle.hub_mass, [0.0, 0.0, 0.0]))
            parts.append((1.0, centre, wheel, axle.wheel_mass, inertia))
            self.loads.append(load)
            self.centres.append(centre)
            self.wheels.append(wheel)
            self.springs.append(spring)
        places, weights, height = [], [], ca.SX(0)
        for sign, centre, frame, mass, inertia in parts:
            places += [centre, ca.vec(frame)]
            spread = sum(inertia) / 2 - np.array(inertia)  # second moments of the mass along the body's axes
            weights += [sign * mass] * 3 + np.repeat(sign * spread, 3).tolist()
            height += sign * mass * centre[2]
        self.places, self.weights, self.height = ca.vertcat(*places), np.array(weights), height

    @cached_property
    def inertia_forces(self) -> ca.Function:
        """(q, steering, derivatives of q, second derivatives) → generalized forces that these accelerations take."""
        rate, acceleration = ca.SX.sym("rate", 14), ca.SX.sym("acceleration", 14)
        moved = ca.jtimes(self.places, self.q, rate)
        second = ca.jtimes(self.places, self.q, acceleration) + ca.jtimes(moved, self.q, rate)
        force = ca.jtimes(self.places, self.q, self.weights * second, True)
        return ca.Function("inertia", [self.q, self.steering, rate, acceleration], [force])

    @cached_property
    def own_forces(self) -> ca.Function:
        """(q, steering, derivatives of q) → generalized forces of weight, springs, dampers and bars."""
        q, rate = self.q, ca.SX.sym("rate", 14)
        force = ca.SX(14, 1)
        for axle, c in zip(self.axles, self.springs, strict=True):
            by_q = ca.jacobian(c, q).T
            force -= axle.suspension_damping * by_q * ca.dot(by_q, rate)
        return ca.Function("own", [q, self.steering, rate], [force - ca.gradient(self.potential, q)])

    @cached_property
    def potential(self) -> ca.SX:
        """Potential energy of weight, springs and bars [J]."""
        q, potential = self.q, G * self.height
        for i, axle in enumerate(self.axles):
            preload = self.loads[i] * self._lift(i) - (axle.hub_mass + axle.wheel_mass) * G
            c = self.springs[i]
            potential += preload * c + axle.suspension_stiffness * c**2 / 2
        for left in (0, 2):
            potential += self.axles[left].antiroll_stiffness * (q[6 + left] - q[7 + left]) ** 2 / 2
        return potential

    def _lift(self, i: int) -> float:
        """How much a point of the hub at the contact of the design position rises, per travel."""
        hub = ca.Function("hub", [self.q, self.steering], [self.centres[i], self.wheels[i]])
        rest = np.zeros(14)
        centre, frame = (np.asarray(r) for r in hub(rest, 0))
        down = np.cross(frame[:, 1], [1.0, 0.0, 0.0])
        down *= self.axles[i].unloaded_radius - self.loads[i] / self.axles[i].tyre_stiffness
        point = frame.T @ down
        ends = []
        for travel in (-1e-5, 1e-5):
            rest[6 + i] = travel
            centre, frame = (np.asarray(r) for r in hub(rest, 0))
            ends.append(centre[2, 0] + (frame @ point)[2])
        return (ends[1] - ends[0]) / 2e-5

    @cached_property
    def wheel_motion(self) -> ca.Function:
        """(q, steering) → of each wheel: centre, frame, and their Jacobians by q (3×14, 9×14)."""
        outputs = []
        for centre, wheel in zip(self.centres, self.wheels, strict=True):
            outputs += [centre, wheel, ca.jacobian(centre, self.q), ca.jacobian(ca.vec(wheel), self.q)]
        return ca.Function("wheels", [self.q, self.steering], [ca.densify(o) for o in outputs])

    def turning(self, frame: np.ndarray, by_q: np.ndarray) -> np.ndarray:
        """Angular velocity per rate of each coordinate, 3×14."""
        columns = []
        for k in range(14):
            spin = by_q[:, k].reshape(3, 3, order="F") @ frame.T
            columns.append([spin[2, 1], spin[0, 2], spin[1, 0]])
        return np.array(columns).T


@pytest.fixture(scope="module")
def bodies(tabled: Vehicle) -> Bodies:
    return Bodies(tabled)


@pytest.fixture(scope="module")
def dynamics(tabled_car: Car) -> ca.Function:
    return dynamics_function(tabled_car)


def tyre_function(tyre: TMeasy) -> ca.Function:
    p, symbolic = symbols(tyre)
    free = ca.SX.sym("a", 6)
    return ca.Function("tyre", [p, free], [ca.vertcat(*symbolic.forces(TyreInput(*ca.vertsplit(free))))])


def state_of(vehicle: Vehicle, seed: int, travel: float, steering: float) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    q, u = np.zeros(14), np.zeros(14)
    q[:3] = *random.uniform(-50, 50, 2), vehicle.physics.chassis.cog_height - random.uniform(0, 0.02)
    q[3:6] = *random.uniform(-0.03, 0.03, 2), random.uniform(-3, 3)
    q[6:10] = random.uniform(-travel, travel, 4)
    q[10:] = random.uniform(-3, 3, 4)
    u[:6] = random.uniform([-5, -2, -0.5, -0.5, -0.5, -0.8], [40, 2, 0.5, 0.5, 0.5, 0.8])
    u[6:10] = random.uniform(-0.5, 0.5, 4)
    u[10:] = u[0] / 0.33 * random.uniform(0.8, 1.2, 4)
    return {
        "q": q,
        "u": u,
        "force": random.normal(size=14) * np.array([500] * 6 + [100] * 8),
        "disturbances": np.zeros(7),
        "inputs": np.array([random.uniform(-steering, steering), *random.uniform(-800, 800, 4), 0.0]),
        "p": vehicle.parameter_vector(),
        "internal_state": np.zeros(0),
    }


def expected_forces(bodies: Bodies, state: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Generalized forces on the derivatives of q (14), rates of q (14), outputs of the wheels (7×4)."""
    q, u, inputs, vehicle = state["q"], state["u"], state["inputs"], bodies.vehicle
    symbol = ca.SX.sym("u", 14)
    velocities = ca.Function("k", [bodies.q, symbol], [kinematics(bodies.q, symbol, ca.SX.zeros(7))])
    to_rate = np.column_stack([np.asarray(velocities(q, unit))[:, 0] for unit in np.eye(14)])
    rate = to_rate @ u
    own = np.asarray(bodies.own_forces(q, inputs[0], rate))[:, 0]
    extra = state["force"].copy()
    extra[0] -= 0.5 * 1.204 * vehicle.physics.aerodynamics.drag_area * abs(u[0]) * u[0]
    extra[10:] += inputs[TORQUES]
    total = own + np.linalg.solve(to_rate.T, extra)
    outputs = np.zeros((7, 4))
    motion = [np.asarray(r) for r in bodies.wheel_motion(q, inputs[0])]
    for i, axle in enumerate(bodies.axles):
        centre, frame, by_q, frame_by_q = motion[4 * i : 4 * i + 4]
        turning = bodies.turning(frame, frame_by_q)
        carried = turning.copy()
        carried[:, 10 + i] = 0  # the hub's
        up, spindle = np.array([0.0, 0.0, 1.0]), frame[:, 1]
        ahead = np.cross(spindle, up)
        ahead /= np.linalg.norm(ahead)
        left = np.cross(up, ahead)
        down = np.cross(spindle, ahead)
        loaded = -centre[2, 0] / down[2]
        arm = loaded * down
        velocity = (by_q + np.cross(carried.T, arm).T) @ rate
        load = axle.tyre_stiffness * (axle.unloaded_radius - loaded) - axle.tyre_damping * velocity[2]
        load = max(load, 0.0) if axle.unloaded_radius > loaded else 0.0
        effective = axle.dynamic_radius_factor * axle.unloaded_radius + (1 - axle.dynamic_radius_factor) * loaded
        rolling = effective * u[10 + i]
        inclination = np.arcsin(spindle[2])
        slide = load, ahead @ velocity, left @ velocity, rolling, vehicle.physics.road.friction, inclination
        x, y, moment, slip_x, slip_y = np.asarray(tyre_function(axle.tyre)(vector(axle.tyre), list(slide)))[:, 0]
        outputs[:, i] = x, y, load, moment, slip_x, -np.arctan(slip_y), inclination
        drop = axle.rolling_resistance * load * effective * rolling / np.hypot(rolling, axle.tyre.standstill_speed)
        total += (by_q + np.cross(turning.T, arm).T).T @ (x * ahead + y * left + load * up)
        total += turning.T @ (moment * up - drop * spindle)
    return total, rate, outputs


def check(bodies: Bodies, dynamics: ca.Function, state: dict[str, np.ndarray]) -> np.ndarray:
    """Asserts that the accelerations of the model balance all forces; returns the outputs of the wheels."""
    udot, wheels = (np.asarray(r) for r in dynamics(*state.values()))
    total, rate, outputs = expected_forces(bodies, state)
    symbols_ = ca.SX.sym("u", 14), ca.SX.sym("udot", 14)
    velocities = kinematics(bodies.q, symbols_[0], ca.SX.zeros(7))
    second = ca.jtimes(velocities, bodies.q, velocities) + ca.jtimes(velocities, symbols_[0], symbols_[1])
    acceleration = ca.Function("a", [bodies.q, *symbols_], [second])(state["q"], state["u"], udot)
    inertia = np.asarray(bodies.inertia_forces(state["q"], state["inputs"][0], rate, acceleration))[:, 0]
    scale = np.abs(outputs).max(axis=1, keepdims=True) + 1e-6
    assert_allclose(wheels / scale, outputs / scale, rtol=1e-7, atol=1e-7)
    assert_allclose(inertia, total, rtol=1e-7, atol=1e-7 * np.abs(total).max())
    return wheels


@relaxed
@given(seed=seeds)
def test_a_driving_car_on_tables_obeys_lagranges_equations(seed, tabled, bodies, dynamics):
    check(bodies, dynamics, state_of(tabled, seed, 0.045, 0.3))


@relaxed
@given(seed=seeds)
def test_so_does_one_in_the_air_with_its_wheels_and_its_rack_beyond_the_tables(seed, tabled, bodies, dynamics):
    state = state_of(tabled, seed, 0.12, 0.6)
    state["q"][2] += 2
    assert not check(bodies, dynamics, state)[:4].any()


@relaxed
@given(seed=seeds, wheel=st.integers(0, 3), end=st.sampled_from([LOW, HIGH]))
def test_nothing_jumps_at_the_end_of_the_table_but_what_its_bend_does_to_a_travelling_wheel(
    seed, wheel, end, tabled, dynamics
):
    state = state_of(tabled, seed, 0.04, 0.3)
    state["u"][6 + wheel] = 0
    sides = []
    for beyond in (-1e-9, 1e-9):
        state["q"][6 + wheel] = end + beyond
        sides.append(np.asarray(dynamics(*state.values())[0])[:, 0])
    assert_allclose(sides[1], sides[0], atol=1e-3)


@pytest.fixture(scope="module")
def differentiated(tabled_car: Car) -> ca.Function:
    """Jacobians of the articulated-body recursion, by automatic differentiation."""
    car = tabled_car
    by_q = ca.jacobian(car.dynamics, car.q)[:, list(DYNAMIC_COORDINATES)]
    by_others = [ca.jacobian(car.dynamics, symbols) for symbols in (car.u, car.disturbances)]
    arguments = [car.q, car.u, car.force, car.disturbances, car.inputs, car.p, car.internal_state]
    return ca.Function("differentiated", arguments, [by_q, *by_others])


@pytest.fixture(scope="module")
def linearize(tabled_car: Car) -> ca.Function:
    return linearize_function(tabled_car)


@relaxed
@given(seed=seeds, height=st.sampled_from([0.0, 2.0]))
def test_its_jacobians_are_those_of_the_articulated_body_recursion(seed, height, tabled, linearize, differentiated):
    state = state_of(tabled, seed, 0.045, 0.3)
    state["q"][2] += height
    state["disturbances"] = np.random.default_rng(seed).uniform(-0.02, 0.02, 7) * [1, 1, 0.1, 0.1, 1, 1, 1]
    _, *found, _ = linearize(*state.values())
    for jacobian, expected in zip(found, differentiated(*state.values()), strict=True):
        rows = np.abs(np.asarray(expected)).max(axis=1, keepdims=True)
        assert_allclose(np.asarray(jacobian), np.asarray(expected), rtol=0, atol=1e-10 * rows.max())


@relaxed
@given(seed=seeds)
def test_a_generalized_force_causes_the_acceleration_it_was_asked_for(seed, tabled, tabled_car, dynamics):
    state = state_of(tabled, seed, 0.1, 0.5)
    wish = np.random.default_rng(seed).normal(size=14)
    more = force_function(tabled_car)(*(state[k] for k in ("q", "inputs", "disturbances", "p", "internal_state")), wish)
    before = np.asarray(dynamics(*state.values())[0])[:, 0]
    state["force"] = state["force"] + np.asarray(more)[:, 0]
    after = np.asarray(dynamics(*state.values())[0])[:, 0]
    assert_allclose(after - before, wish, atol=1e-9 * (1 + np.abs(before).max()))


def test_energy_of_a_thrown_car_without_dampers_is_kept_to_second_order_of_the_step(tabled, monkeypatch):
    """Kinetic energy from places by finite differences."""
    monkeypatch.setenv("VSENSE_COMPILE", "0")  # for a thousand steps
    none = {f"{axle}.{name}": 0.0 for axle in ("front", "rear") for name in ("suspension_damping", "tyre_damping")}
    lossless = tabled.with_parameters(none | {"aerodynamics.drag_area": 0.0})
    bodies, steering = Bodies(lossless), 0.1
    holding = np.zeros(14)
    holding[6:10] = np.array(bodies.loads) - [(a.hub_mass + a.wheel_mass) * G for a in bodies.axles]
    place = ca.Function("place", [bodies.q, bodies.steering], [bodies.places])
    potential = ca.Function("potential", [bodies.q, bodies.steering], [bodies.potential])
    speeds = ca.SX.sym("u", 14)
    rate_of = ca.Function("rate", [bodies.q, speeds], [kinematics(bodies.q, speeds, ca.SX.zeros(7))])

    def energy(q: np.ndarray, u: np.ndarray) -> float:
        step = 1e-6 * np.asarray(rate_of(q, u))[:, 0]
        velocity = (np.asarray(place(q + step, steering)) - np.asarray(place(q - step, steering)))[:, 0] / 2e-6
        return float(bodies.weights @ velocity**2 / 2 + potential(q, steering) - holding @ q)

    q = np.array([0, 0, 5.0, 0.3, -0.2, 0.7, 0.02, -0.03, 0.01, 0.03, 0, 0, 0, 0])
    u = np.array([15.0, -3.0, 4.0, 1.5, -0.4, 1.0, 0.5, -0.4, 0.3, -0.2, 60.0, 40.0, 50.0, -30.0])
    start, drift = energy(q, u), []
    for h in (2e-3, 1e-3, 5e-4):
        stepper = Stepper(lossless, q, u)
        stepper.inputs[0], stepper.force[:] = steering, holding
        stepper.run(0.3, h)
        assert np.abs(stepper.q[6:10] - q[6:10]).max() > 0.01
        drift.append(abs(energy(stepper.q, stepper.u) - start))
    assert drift[-1] < 1e-5 * start
    assert drift[0] / drift[1] > 3.5
    assert drift[1] / drift[2] > 3.5


def changed(tables: SuspensionTables, **top: object) -> dict[str, object]:
    """Content of the tables with other values; two underscores stand for a dot."""
    data = tables.model_dump()
    for dotted, value in top.items():
        *path, leaf = dotted.split("__")
        node = data
        for key in path:
            node = node[key]
        node[leaf] = value
    return data


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"travel": (0.01, 0.06)}, r"travel must reach from below to above 0, within 1 m, found 0\.01 to 0\.06"),
        ({"front__toe": ((0.0, 1.0), (0.0,))}, r"toe must have rows of one length, .* found rows of 2, 1"),
        ({"front__toe": ()}, r"toe must have rows of one length, .* found rows of none"),
        ({"rear__x": ((0.01,), (0.02,))}, r"rear\.x is 0\.0\d+ m in the design position, where it must be 0"),
        (
            {"rear__spring": ((0.011,), (0.072,), (0.036,))},
            r"rear\.spring moves by .* of the wheel's travel at -50 mm; at least 0\.05 is needed",
        ),
        ({"rear__spring": ((0.02,), (0.06,))}, r"rear\.spring is 0\.0\d+ m in the design position, where it must be 0"),
        (
            {"rear__spring": ((0.005,), (0.03,))},
            r"rear\.spring moves by 0\.5 of the wheel's travel in the design position, .* 1 is expected",
        ),
        ({"steering": 0.0}, "greater than 0"),
    ],
)
def test_tables_that_cannot_be_are_refused(tabled, change, complaint):
    with pytest.raises(ValidationError, match=complaint):
        SuspensionTables.model_validate(changed(tabled.suspension, **change))
