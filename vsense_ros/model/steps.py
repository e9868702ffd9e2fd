"""The functions that simulators and observers call, made from a `Car`.

Time integration is ROS2 (Verwer, Spee, Blom & Hundsdorfer 1999): a two-stage Rosenbrock method, second order with *any*
matrix in place of the Jacobian, and L-stable with the exact one. Tyres near standstill are stiffer than any step length
that a vehicle computer can afford, and an explicit method would ring there. The matrix is the exact Jacobian, stiffened
against wheel slip (`Car.stiffening`): a change of rank four, made within the step.
"""

from __future__ import annotations

from functools import cache

import casadi as ca

from vsense_ros.model import codegen
from vsense_ros.model.car import PITCH, ROLL, TRAVEL, Car, Motion, Z, kinematics
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.tree import solve_dominant

GAMMA = 1 - 2**-0.5  # makes ROS2 L-stable

# Coordinates that the dynamics depend on: not where the car is, not its heading, not how far the wheels have turned.
DYNAMIC_COORDINATES = (Z, ROLL, PITCH, 6, 7, 8, 9)

_STATE_NAMES = ("q", "u", "force", "surroundings", "inputs", "p")


def _arguments(car: Car) -> list[ca.SX]:
    return [car.q, car.u, car.force, car.surroundings, car.inputs, car.p]


def _dynamic(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[Z], q[ROLL], q[PITCH], q[TRAVEL])


def dynamics_function(car: Car) -> ca.Function:
    """(q, u, force, surroundings, inputs, p) → derivatives of u (14), wheel outputs (7×4)."""
    return codegen.function("dynamics", _arguments(car), [car.dynamics, car.wheel_outputs], _STATE_NAMES)


def linearize_function(car: Car) -> ca.Function:
    """(…) → derivatives of u, their Jacobians by `DYNAMIC_COORDINATES` (14×7), u (14×14), surroundings (14×4), and the
    first of these times the rates of the dynamic coordinates by u (14×14)."""
    by_u = ca.jacobian(car.dynamics, car.u)
    by_q = ca.jacobian(car.dynamics, car.q)[:, list(DYNAMIC_COORDINATES)]
    by_surroundings = ca.jacobian(car.dynamics, car.surroundings)
    rates = ca.jacobian(_dynamic(kinematics(car.q, car.u)), car.u)
    return codegen.function(
        "linearize", _arguments(car), [car.dynamics, by_q, by_u, by_surroundings, by_q @ rates], _STATE_NAMES
    )


def advance_function(car: Car) -> ca.Function:
    """(…, h, inverse, by_q) → q, u after a step of `h` [s].

    `inverse` is (I - γ h (∂f/∂u + γ h ∂f/∂q N))⁻¹ (14×14), `by_q` the Jacobian by the dynamic coordinates (14×7).
    """
    h = ca.SX.sym("h")
    inverse = ca.SX.sym("inverse", 14, 14)
    by_q = ca.SX.sym("by_q", 14, 7)
    dynamics = ca.Function("f", _arguments(car), [car.dynamics])
    q, u = car.q, car.u
    rest = _arguments(car)[2:]
    # Inverse of the stiffened matrix by Woodbury's identity.
    responses, slopes = car.stiffening
    columns, rows = inverse @ responses, GAMMA * h * slopes
    reduced = ca.SX.eye(4) - rows @ columns

    def solve(right: ca.SX) -> ca.SX:
        plain = inverse @ right
        return plain + columns @ solve_dominant(reduced, rows @ plain)

    rate = kinematics(q, u)
    first_u = solve(dynamics(q, u, *rest) + GAMMA * h * (by_q @ _dynamic(rate)))
    first_q = rate + GAMMA * h * kinematics(q, first_u)
    middle_q, middle_u = q + h * first_q, u + h * first_u
    right_q = kinematics(middle_q, middle_u) - 2 * first_q
    right_u = dynamics(middle_q, middle_u, *rest) - 2 * first_u
    second_u = solve(right_u + GAMMA * h * (by_q @ _dynamic(right_q)))
    second_q = right_q + GAMMA * h * kinematics(q, second_u)
    return codegen.function(
        "advance",
        [*_arguments(car), h, inverse, by_q],
        [q + h * (1.5 * first_q + 0.5 * second_q), u + h * (1.5 * first_u + 0.5 * second_u)],
        (*_STATE_NAMES, "h", "inverse", "by_q"),
    )


def kinematics_function(car: Car) -> ca.Function:
    """(q, u) → ∂q̇/∂(roll, pitch, yaw) of the first six coordinates (6×3), ∂q̇/∂u of the first six (6×6)."""
    rate = kinematics(car.q, car.u)[:6]
    return codegen.function(
        "kinematics", [car.q, car.u], [ca.jacobian(rate, car.q)[:, 3:6], ca.jacobian(rate, car.u)[:, :6]], ("q", "u")
    )


def force_function(car: Car) -> ca.Function:
    """(q, inputs, surroundings, p, acceleration) → generalized force M(q) · acceleration (14)."""
    acceleration = ca.SX.sym("acceleration", 14)
    return codegen.function(
        "force",
        [car.q, car.inputs, car.surroundings, car.p, acceleration],
        [car.inertia_times(acceleration)],
        ("q", "inputs", "surroundings", "p", "acceleration"),
    )


def sensor_function(car: Car, sensor: SensorBase) -> ca.Function:
    """(q, u, udot, surroundings, inputs, biases, mounting) → measurement (m), and its Jacobians by q (m×14), u (m×14),
    udot (m×14), surroundings (m×4); by the biases it is the unit matrix if there are any."""
    udot = ca.SX.sym("udot", 14)
    biases = ca.SX.sym("biases", len(sensor.biases()))
    mounting = ca.SX.sym("mounting", len(sensor.mounting()))
    value = sensor.equation(Motion(car.q, car.u, udot, car.surroundings, car.inputs), biases, mounting)
    return codegen.function(
        f"sense_{sensor.kind}",
        [car.q, car.u, udot, car.surroundings, car.inputs, biases, mounting],
        [value, *(ca.jacobian(value, s) for s in (car.q, car.u, udot, car.surroundings))],
        ("q", "u", "udot", "surroundings", "inputs", "biases", "mounting"),
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
    return {f.name(): f for f in codegen.compiled("car", functions)}


@cache
def sensor_functions(car: Car, sensors: tuple[SensorBase, ...]) -> dict[str, ca.Function]:
    """The functions of the sensors that correct the model, by kind, compiled where possible."""
    kinds = {sensor.kind: sensor for sensor in sensors if not sensor.is_input}
    return dict(zip(kinds, codegen.compiled("sensors", [sensor_function(car, s) for s in kinds.values()]), strict=True))
