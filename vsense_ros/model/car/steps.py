"""The functions that simulators and observers call, made from a `Car`.

Time integration is ROS2 (Verwer, Spee, Blom & Hundsdorfer 1999): a two-stage Rosenbrock method, second order with *any*
matrix in place of the Jacobian, and L-stable with the exact one. Tyres near standstill are stiffer than any step length
that a vehicle computer can afford, and an explicit method would ring there. The matrix is the exact Jacobian, stiffened
against wheel slip (`Car.stiffening`): a change of rank four, made within the step.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.model.car.car import Car, kinematics, motion_of
from vsense_ros.model.coordinates import (
    ATTITUDE,
    COORDINATES,
    DISTURBANCES,
    DYNAMIC_COORDINATES,
    PITCH,
    POSE,
    ROLL,
    SPIN,
    TRAVEL,
    TWIST,
    WHEELS,
    Z,
)
from vsense_ros.model.multibody.tree import inverse_spd, solve_dominant
from vsense_ros.model.sensors import SensorBase

GAMMA = 1 - 2**-0.5  # makes ROS2 L-stable

_STATE_NAMES = ("q", "u", "force", "disturbances", "inputs", "p", "internal_state")
_STATE_SIZES = (len(DYNAMIC_COORDINATES), COORDINATES, len(DISTURBANCES))  # of what `linearize` derives by


def _arguments(car: Car) -> list[ca.SX]:
    return [car.q, car.u, car.force, car.disturbances, car.inputs, car.p, car.internal_state]


def _dynamic(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[Z], q[ROLL], q[PITCH], q[TRAVEL])


def dynamics_function(car: Car) -> ca.Function:
    """(q, u, force, disturbances, inputs, p, internal_state) → derivatives of u (14), wheel outputs (7×4)."""
    return codegen.function("dynamics", _arguments(car), [car.dynamics, car.wheel_outputs], _STATE_NAMES)


def linearize_function(car: Car) -> ca.Function:
    """(…) → derivatives of u, their Jacobians by `DYNAMIC_COORDINATES` (14×7), u (14×14), disturbances (14×4), and the
    first of these times the rates of the dynamic coordinates by u (14×14).

    Differentiating the articulated-body recursion would take a third more operations than the implicit derivative of
    the equations of motion, M ∂u̇ = -∂r with r(u̇, tyre forces) = 0, where the forces of each tyre depend on few
    quantities. The virtual machine multiplies the sparse factors as matrices, in a third of the time that it would need
    for their elements one by one.
    """
    state = [ca.MX.sym(name, argument.shape) for name, argument in zip(_STATE_NAMES, _arguments(car), strict=True)]
    udot, inverse, direct, by_forces, by_motions, motions, beside, rates = _factors_function(car)(*state)
    jacobian = -inverse @ (direct + by_forces @ (by_motions @ motions + beside))
    by_q, by_u, by_disturbances = ca.horzsplit(jacobian, [0, *np.cumsum(_STATE_SIZES).tolist()])
    results = [udot, *(ca.densify(m) for m in (by_q, by_u, by_disturbances, by_q @ rates))]
    return ca.Function("linearize", state, results, _STATE_NAMES, [f"r{i}" for i in range(len(results))])


def _factors_function(car: Car) -> ca.Function:
    """(…) → derivatives of u; inverse of the mass matrix; the missing force's derivative by the state `z` (dynamic
    coordinates, u, disturbances) at given accelerations and tyre forces, and by tyre forces; the derivative of tyre
    forces by tyre motions, of these by z, of tyre forces by z at given motions; rates of the dynamic coordinates by u.
    """

    def by_state(expression: ca.SX) -> ca.SX:
        columns = [*DYNAMIC_COORDINATES, *range(COORDINATES, 2 * COORDINATES + len(DISTURBANCES))]
        return ca.jacobian(expression, ca.vertcat(car.q, car.u, car.disturbances))[:, columns]

    arguments = _arguments(car)
    udot = ca.SX.sym("udot", COORDINATES)
    forces, motions = ca.SX.sym("forces", 4, len(WHEELS)), ca.SX.sym("motions", 5, len(WHEELS))
    missing, tyres = car.missing_force(udot, forces), ca.vec(car.tyre_forces(motions))
    parts = [by_state(missing), ca.jacobian(missing, ca.vec(forces)), ca.jacobian(tyres, ca.vec(motions))]
    in_parts = ca.Function("parts", [*arguments, udot, forces, motions], [*parts, by_state(tyres)])
    *parts, beside = in_parts(*arguments, car.dynamics, car.tyre_forces(car.tyre_motions), car.tyre_motions)
    # Joints first: they are coupled with each other through the chassis only, which keeps the factors sparse.
    joints = (joint.start + corner for corner in range(len(WHEELS)) for joint in (SPIN, TRAVEL))
    order = [*joints, *range(TWIST.stop)]
    back = sorted(range(COORDINATES), key=order.__getitem__)
    inverse = inverse_spd(ca.jacobian(car.inertia_times(udot), udot)[order, order])[back, back]
    rates = ca.jacobian(_dynamic(kinematics(car.q, car.u)), car.u)
    results = [car.dynamics, inverse, *parts, by_state(ca.vec(car.steady_tyre_motions)), beside, rates]
    return ca.Function("factors", arguments, results, {"cse": True})


def advance_function(car: Car) -> ca.Function:
    """(…, h, inverse, by_q) → q, u after a step of `h` [s].

    `inverse` is (I - γ h (∂f/∂u + γ h ∂f/∂q N))⁻¹ (14×14), `by_q` the Jacobian by the dynamic coordinates (14×7).
    """
    h = ca.SX.sym("h")
    inverse = ca.SX.sym("inverse", COORDINATES, COORDINATES)
    by_q = ca.SX.sym("by_q", COORDINATES, len(DYNAMIC_COORDINATES))
    dynamics = ca.Function("f", _arguments(car), [car.dynamics])
    q, u = car.q, car.u
    rest = _arguments(car)[2:]
    # Inverse of the stiffened matrix by Woodbury's identity.
    responses, slopes, foreseen = car.stiffening
    columns, rows = inverse @ responses, GAMMA * h * slopes
    reduced = ca.SX.eye(len(WHEELS)) - rows @ columns

    def solve(right: ca.SX, known: ca.SX) -> ca.SX:
        """A stage without the stiffening that its `known` part (4) would cause."""
        plain = inverse @ right
        return plain + columns @ solve_dominant(reduced, rows @ plain - known)

    rate, rate_u = kinematics(q, u), dynamics(q, u, *rest)
    # A second stage begins as minus the first: with opposite signs, whatever is known leaves the step of second order.
    known = GAMMA * h * (foreseen @ rate_u)
    first_u = solve(rate_u + GAMMA * h * (by_q @ _dynamic(rate)), known)
    first_q = rate + GAMMA * h * kinematics(q, first_u)
    middle_q, middle_u = q + h * first_q, u + h * first_u
    right_q = kinematics(middle_q, middle_u) - 2 * first_q
    right_u = dynamics(middle_q, middle_u, *rest) - 2 * first_u
    second_u = solve(right_u + GAMMA * h * (by_q @ _dynamic(right_q)), -known)
    second_q = right_q + GAMMA * h * kinematics(q, second_u)
    return codegen.function(
        "advance",
        [*_arguments(car), h, inverse, by_q],
        [q + h * (1.5 * first_q + 0.5 * second_q), u + h * (1.5 * first_u + 0.5 * second_u)],
        (*_STATE_NAMES, "h", "inverse", "by_q"),
    )


def kinematics_function(car: Car) -> ca.Function:
    """(q, u) → ∂q̇/∂(roll, pitch, yaw) of the first six coordinates (6×3), ∂q̇/∂u of the first six (6×6)."""
    rate = kinematics(car.q, car.u)[POSE]
    by_attitude, by_twist = ca.jacobian(rate, car.q)[:, ATTITUDE], ca.jacobian(rate, car.u)[:, TWIST]
    return codegen.function("kinematics", [car.q, car.u], [by_attitude, by_twist], ("q", "u"))


def force_function(car: Car) -> ca.Function:
    """(q, inputs, disturbances, p, internal_state, acceleration) → generalized force M(q) · acceleration (14)."""
    acceleration = ca.SX.sym("acceleration", COORDINATES)
    return codegen.function(
        "force",
        [car.q, car.inputs, car.disturbances, car.p, car.internal_state, acceleration],
        [car.inertia_times(acceleration)],
        ("q", "inputs", "disturbances", "p", "internal_state", "acceleration"),
    )


def internal_state_function(car: Car) -> ca.Function:
    """(…, h) → the internal state of the effects for a step of `h` [s] that begins now."""
    h = ca.SX.sym("h")
    return codegen.function("internal_state", [*_arguments(car), h], [car.next_internal_state(h)], (*_STATE_NAMES, "h"))


def sensor_function(car: Car, sensor: SensorBase) -> ca.Function:
    """(q, u, udot, disturbances, inputs, biases, mounting) → measurement (m), and its Jacobians by q (m×14), u (m×14),
    udot (m×14), disturbances (m×4); by the biases it is the unit matrix if there are any."""
    udot = ca.SX.sym("udot", COORDINATES)
    biases = ca.SX.sym("biases", len(sensor.biases()))
    mounting = ca.SX.sym("mounting", len(sensor.mounting()))
    value = sensor.equation(motion_of(car.q, car.u, udot, car.disturbances, car.inputs), biases, mounting)
    return codegen.function(
        f"sense_{sensor.kind}",
        [car.q, car.u, udot, car.disturbances, car.inputs, biases, mounting],
        [value, *(ca.jacobian(value, s) for s in (car.q, car.u, udot, car.disturbances))],
        ("q", "u", "udot", "disturbances", "inputs", "biases", "mounting"),
    )


@cache
def model_functions(car: Car) -> dict[str, ca.Function]:
    """All functions of a car by name, compiled where possible."""
    functions = [
        dynamics_function(car),
        linearize_function(car),
        advance_function(car),
        kinematics_function(car),
        force_function(car),
    ]
    if car.internal_state.numel():
        functions.append(internal_state_function(car))
    return {f.name(): f for f in codegen.compiled("car", functions, expand=True)}


@cache
def sensor_functions(car: Car, sensors: tuple[SensorBase, ...]) -> dict[str, ca.Function]:
    """The functions of the sensors that correct the model, by kind, compiled where possible."""
    kinds = {sensor.kind: sensor for sensor in sensors if not sensor.is_input}
    return dict(zip(kinds, codegen.compiled("sensors", [sensor_function(car, s) for s in kinds.values()]), strict=True))
