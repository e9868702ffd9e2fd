"""The functions that simulators and observers call, made from a `Car`.

Time integration is ROS2 (Verwer, Spee, Blom & Hundsdorfer 1999): a two-stage Rosenbrock method, second order with *any*
matrix in place of the Jacobian, and L-stable with the exact one. Tyres near standstill are stiffer than any step length
that a vehicle computer can afford, and an explicit method would ring there. The matrix is the exact Jacobian, stiffened
against wheel slip (`stiffening.py`): a change of rank four, made within the step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Sequence
from functools import cache

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.model.car.car import PLACEMENT, Car
from vsense_ros.model.car.kinematics import kinematics, motion_of, road_kinematics
from vsense_ros.model.car.stiffening import stiffening
from vsense_ros.model.coordinates import (
    ATTITUDE,
    COORDINATES,
    DISTURBANCES,
    DYNAMIC_COORDINATES,
    PITCH,
    POSE,
    ROLL,
    SPIN,
    SURFACE,
    TRAVEL,
    TWIST,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)
from vsense_ros.model.multibody.tree import inverse_spd, solve_dominant
from vsense_ros.model.sensors import SensorBase

GAMMA = 1 - 2**-0.5  # makes ROS2 L-stable

_STATE_NAMES = ("q", "u", "force", "disturbances", "inputs", "p", "internal_state")
_STATE_SIZES = (len(DYNAMIC_COORDINATES), COORDINATES, len(DISTURBANCES))  # of what `linearize` derives by
# Arguments with a row for each coordinate.
_BY_COORDINATE = frozenset(
    ("q", "u", "force", "acceleration", "columns", "rate", "plain", "first_q", "first_u", "right_q", "rate_u")
)


def _arguments(car: Car) -> list[ca.SX]:
    placement = [] if car.placement.is_constant() else [car.placement]
    return [car.q, car.u, car.force, car.disturbances, car.inputs, car.p, car.internal_state, *placement]


def _names(car: Car) -> list[str]:
    return [*_STATE_NAMES, "placement"][: len(_arguments(car))]


def _symbols(car: Car) -> list[ca.MX]:
    """Symbols of matrix expressions with the names and shapes of `_arguments`."""
    return [ca.MX.sym(name, argument.shape) for name, argument in zip(_names(car), _arguments(car), strict=True)]


def _dynamic(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[Z], q[ROLL], q[PITCH], q[TRAVEL])


def dynamics_function(car: Car) -> ca.Function:
    """(q, u, force, disturbances, inputs, p, internal_state) → derivatives of u (14), wheel outputs (7×4)."""
    return codegen.function("dynamics", _arguments(car), [car.dynamics, car.wheel_outputs], _names(car))


def sensitivity_function(car: Car, columns: Sequence[int]) -> ca.Function:
    """(q, u, force, disturbances, inputs, p, internal_state) → derivatives of the accelerations by some of the
    parameters (14×k), `columns` of p.

    Each is a derivative by itself: the whole Jacobian, of which few columns are wanted, would share its work among all.
    """
    seeds = [ca.SX.eye(car.p.numel())[:, column] for column in columns]
    effect = ca.horzcat(*(ca.jtimes(car.dynamics, car.p, seed) for seed in seeds))
    return codegen.function("parameters_effect", _arguments(car), [effect], _names(car))


def linearize_function(car: Car) -> ca.Function:
    """(…) → derivatives of u, their Jacobians by `DYNAMIC_COORDINATES` (14×7), u (14×14), disturbances (14×7), and the
    first of these times the rates of the dynamic coordinates by u (14×14).

    Differentiating the articulated-body recursion would take a third more operations than the implicit derivative of
    the equations of motion, M ∂u̇ = -∂r with r(u̇, tyre forces) = 0, where the forces of each tyre depend on few
    quantities. Products of matrices stay products: the virtual machine and compilers are quick with them.
    """
    state = _symbols(car)
    udot, inverse, missing, rates = _missing_function(car)(*state)
    jacobian = ca.mac(inverse, missing, ca.MX.zeros(COORDINATES, sum(_STATE_SIZES)))
    by_q, by_u, by_disturbances = ca.horzsplit(jacobian, [0, *np.cumsum(_STATE_SIZES).tolist()])
    results = [udot, by_q, by_u, by_disturbances, ca.mac(by_q, rates, ca.MX.zeros(COORDINATES, COORDINATES))]
    return ca.Function("linearize", state, results, _names(car), [f"r{i}" for i in range(len(results))])


def _missing_function(car: Car) -> ca.Function:
    """(…) → derivatives of u; inverse of the mass matrix; minus the derivative of the missing force by the state (14×28
    and sparse); rates of the dynamic coordinates by u (7×14, sparse)."""
    state = _symbols(car)
    udot, inverse, direct, by_forces, by_motions, motions, tyres_by_state, rates = _factors_function(car)(*state)
    missing, by_state = direct, by_motions @ motions + tyres_by_state
    # A product for each tyre, which vectors do all at once, or one for the virtual machine.
    tyres = [slice(None)] if car.placement.is_constant() else [slice(4 * i, 4 * i + 4) for i in range(len(WHEELS))]
    for tyre in tyres:
        missing += by_forces[:, tyre] @ by_state[tyre, :]
    return ca.Function("missing", state, [udot, inverse, missing, rates], _names(car), ["r0", "r1", "r2", "r3"])


def _factors_function(car: Car) -> ca.Function:
    """(…) → derivatives of u; inverse of the mass matrix; minus the missing force's derivative by the state `z`, which
    is dynamic coordinates, u, disturbances, at given accelerations and tyre forces, and by tyre forces; the derivative
    of tyre forces by tyre motions, of these by z, of tyre forces by z at given motions; rates of the dynamic
    coordinates by u.
    """

    def by_state(expression: ca.SX) -> ca.SX:
        columns = [*DYNAMIC_COORDINATES, *range(COORDINATES, 2 * COORDINATES + len(DISTURBANCES))]
        return ca.jacobian(expression, ca.vertcat(car.q, car.u, car.disturbances))[:, columns]

    arguments = _arguments(car)
    udot = ca.SX.sym("udot", COORDINATES)
    forces, motions = ca.SX.sym("forces", 4, len(WHEELS)), ca.SX.sym("motions", 5, len(WHEELS))
    missing, tyres = -car.missing_force(udot, forces), ca.vec(car.tyre_forces(motions))
    parts = [by_state(missing), ca.jacobian(missing, ca.vec(forces)), ca.jacobian(tyres, ca.vec(motions))]
    in_parts = ca.Function("parts", [*arguments, udot, forces, motions], [*parts, by_state(tyres)])
    *parts, tyres_by_state = in_parts(*arguments, car.dynamics, car.tyre_forces(car.tyre_motions), car.tyre_motions)
    # Joints first: they are coupled with each other through the chassis only, which keeps the factors sparse.
    joints = (joint.start + corner for corner in range(len(WHEELS)) for joint in (SPIN, TRAVEL))
    order = [*joints, *range(TWIST.stop)]
    original_order = sorted(range(COORDINATES), key=order.__getitem__)
    inverse = ca.densify(
        inverse_spd(ca.jacobian(car.inertia_times(udot), udot)[order, order])[original_order, original_order]
    )
    rates = ca.jacobian(_dynamic(car.kinematics), car.u)
    results = [
        ca.densify(car.dynamics),
        inverse,
        *parts,
        by_state(ca.vec(car.steady_tyre_motions)),
        tyres_by_state,
        rates,
    ]
    return ca.Function("factors", arguments, results, {"cse": True})


def advance_function(car: Car, with_udot: bool = False) -> ca.Function:
    """(…, h, inverse, by_q) → q, u after a step of `h` [s]; `with_udot`, also the derivatives of u before it.

    `inverse` is (I - γ h (∂f/∂u + γ h ∂f/∂q N))⁻¹ (14×14), `by_q` the Jacobian by the dynamic coordinates (14×7).
    """
    state, h = _symbols(car), ca.MX.sym("h")
    inverse = ca.MX.sym("inverse", COORDINATES, COORDINATES)
    by_q = ca.MX.sym("by_q", COORDINATES, len(DYNAMIC_COORDINATES))
    (q, u), other_arguments = state[:2], state[2:]
    rate, udot, moved, responses, rows, known = _first_stage(car)(*state, h)
    # Stages without the stiffening are plain; Woodbury's identity brings it in.
    plain = ca.mac(inverse, ca.mac(by_q, moved, udot), ca.MX.zeros(COORDINATES))
    common = {
        "q": q,
        "u": u,
        "disturbances": state[3],
        "h": h,
        "columns": ca.mac(inverse, responses, ca.MX.zeros(COORDINATES, len(WHEELS))),
        "rows": rows,
        "known": known,
    }
    first_q, first_u, q, u, reduced = _called("middle", _middle, **common, rate=rate, plain=plain)
    rate_u, first = accelerations_function(car)(q, u, *other_arguments), {"first_q": first_q, "first_u": first_u}
    right_q, right_u, moved = _called(
        "second_stage", _second_stage, q=q, u=u, disturbances=state[3], h=h, **first, rate_u=rate_u
    )
    plain = ca.mac(inverse, ca.mac(by_q, moved, right_u), ca.MX.zeros(COORDINATES))
    results = _called("end", _end, **common, **first, reduced=reduced, right_q=right_q, plain=plain)
    arguments, names = [*state, h, inverse, by_q], ["r0", "r1"]
    if with_udot:
        results, names = [*results, udot], [*names, "r2"]
    return ca.Function("advance", arguments, results, [*_names(car), "h", "inverse", "by_q"], names)


def _called(name: str, make: Callable[..., list[ca.SX]], **arguments: ca.MX) -> list[ca.MX]:
    """What a function that `make` makes of symbols gives for these arguments."""
    symbols = {word: ca.SX.sym(word, value.sparsity()) for word, value in arguments.items()}
    results = [ca.densify(result) for result in make(**symbols)]
    names = [f"r{i}" for i in range(len(results))]
    function = ca.Function(name, list(symbols.values()), results, list(symbols), names, {"cse": True})
    return list(function.call(list(arguments.values())))


def accelerations_function(car: Car) -> ca.Function:
    """(…) → derivatives of u (14)."""
    return ca.Function(
        "accelerations", _arguments(car), [ca.densify(car.dynamics)], _names(car), ["udot"], {"cse": True}
    )


def _first_stage(car: Car) -> ca.Function:
    """(…, h) → derivatives of q and u; γ h times those of the dynamic coordinates; of the stiffening the responses
    (14×4, sparse), γ h times the slopes (4×14, sparse), and what the rates at the step's beginning cause of it (4)."""
    h = ca.SX.sym("h")
    rate, (responses, slopes, foreseen) = car.kinematics, stiffening(car)
    known = GAMMA * h * (foreseen @ car.dynamics)
    rates = [ca.densify(value) for value in (rate, car.dynamics, GAMMA * h * _dynamic(rate))]
    results = [*rates, ca.sparsify(responses), ca.sparsify(GAMMA * h * slopes), ca.densify(known)]
    names = ["rate", "rate_u", "moved", "responses", "rows", "known"]
    return ca.Function("first_stage", [*_arguments(car), h], results, [*_names(car), "h"], names, {"cse": True})


def _middle(
    q: ca.SX,
    u: ca.SX,
    disturbances: ca.SX,
    h: ca.SX,
    columns: ca.SX,
    rows: ca.SX,
    known: ca.SX,
    rate: ca.SX,
    plain: ca.SX,
) -> list[ca.SX]:
    """First stage of q and u; q and u where the second is; the inverse of the matrix (4×4) to which Woodbury's identity
    reduces the stiffened one."""
    reduced = solve_dominant(ca.SX.eye(len(WHEELS)) - rows @ columns, ca.SX.eye(len(WHEELS)))
    first_u = plain + columns @ (reduced @ (rows @ plain - known))
    first_q = rate + GAMMA * h * kinematics(q, first_u, disturbances)
    return [first_q, first_u, q + h * first_q, u + h * first_u, reduced]


def _second_stage(
    q: ca.SX, u: ca.SX, disturbances: ca.SX, h: ca.SX, first_q: ca.SX, first_u: ca.SX, rate_u: ca.SX
) -> list[ca.SX]:
    """Right sides of the second stage of q and u, which begins as minus the first; γ h times those of the dynamic
    coordinates."""
    right_q = kinematics(q, u, disturbances) - 2 * first_q
    return [right_q, rate_u - 2 * first_u, GAMMA * h * _dynamic(right_q)]


def _end(
    q: ca.SX, u: ca.SX, disturbances: ca.SX, h: ca.SX, columns: ca.SX, rows: ca.SX, known: ca.SX, reduced: ca.SX,
    first_q: ca.SX, first_u: ca.SX, right_q: ca.SX, plain: ca.SX,
) -> list[ca.SX]:  # fmt: skip
    """q and u at the end. With opposite signs in both stages, whatever is known leaves the step of second order."""
    second_u = plain + columns @ (reduced @ (rows @ plain + known))
    second_q = right_q + GAMMA * h * kinematics(q, second_u, disturbances)
    return [q + h * (1.5 * first_q + 0.5 * second_q), u + h * (1.5 * first_u + 0.5 * second_u)]


def kinematics_function(car: Car) -> ca.Function:
    """(q, u, disturbances) → of the first six coordinates ∂q̇/∂(roll, pitch, yaw) (6×3), ∂q̇/∂u by the first six (6×6),
    by the form of the road (6×4); how fast grade, bank and height of the road change (3), and that by the first six of
    u (3×6) and by the form of the road (3×4). That the body leans changes the latter by next to nothing."""
    rate, road = car.kinematics[POSE], road_kinematics(car.q, car.u, car.disturbances)
    by_attitude = ca.jacobian(rate, car.q)[:, ATTITUDE]
    by_twist, by_road = (
        (ca.jacobian(f, car.u)[:, TWIST], ca.jacobian(f, car.disturbances)[:, SURFACE]) for f in (rate, road)
    )
    results = [by_attitude, *by_twist, road, *by_road]
    return codegen.function("kinematics", [car.q, car.u, car.disturbances], results, ("q", "u", "disturbances"))


def force_function(car: Car) -> ca.Function:
    """(q, inputs, disturbances, p, internal_state, acceleration) → generalized force M(q) · acceleration (14)."""
    acceleration = ca.SX.sym("acceleration", COORDINATES)
    return codegen.function(
        "force",
        [car.q, car.inputs, car.disturbances, car.p, car.internal_state, acceleration, *_arguments(car)[7:]],
        [car.inertia_times(acceleration)],
        ("q", "inputs", "disturbances", "p", "internal_state", "acceleration", *_names(car)[7:]),
    )


def wheel_force_function(car: Car) -> ca.Function:
    """(…) → derivatives of force x, y, z and aligning moment of each wheel, fl, fr, rl, rr, by `DYNAMIC_COORDINATES`, u
    and disturbances (16×28); rows x, y and yaw of the mass matrix (3×14)."""
    columns = [*DYNAMIC_COORDINATES, *range(COORDINATES, 2 * COORDINATES + len(DISTURBANCES))]
    state = ca.vertcat(car.q, car.u, car.disturbances)
    derivative = ca.jacobian(ca.vec(car.wheel_outputs[:4, :]), state)[:, columns]
    acceleration = ca.SX.sym("acceleration", COORDINATES)
    mass = ca.jacobian(car.inertia_times(acceleration)[[X, Y, YAW]], acceleration)
    return codegen.function("wheel_forces", _arguments(car), [derivative, mass], _names(car))


def internal_state_function(car: Car) -> ca.Function:
    """(…, h) → the internal state of the effects for a step of `h` [s] that begins now."""
    h = ca.SX.sym("h")
    return codegen.function("internal_state", [*_arguments(car), h], [car.next_internal_state(h)], (*_names(car), "h"))


def sensor_function(car: Car, sensor: SensorBase) -> ca.Function:
    """(q, u, udot, disturbances, inputs, biases, mounting) → measurement (m), and its Jacobians by q (m×14), u (m×14),
    udot (m×14), disturbances (m×7); of each component by its own bias (m), zero for a sensor without biases."""
    udot = ca.SX.sym("udot", COORDINATES)
    biases = ca.SX.sym("biases", len(sensor.biases()))
    mounting = ca.SX.sym("mounting", len(sensor.mounting()))
    value = sensor.equation(motion_of(car.q, car.u, udot, car.disturbances, car.inputs), biases, mounting)
    by_biases = ca.diag(ca.jacobian(value, biases)) if biases.numel() else ca.SX(value.numel(), 1)
    return codegen.function(
        f"sense_{sensor.kind}",
        [car.q, car.u, udot, car.disturbances, car.inputs, biases, mounting],
        [value, *(ca.jacobian(value, s) for s in (car.q, car.u, udot, car.disturbances)), ca.densify(by_biases)],
        ("q", "u", "udot", "disturbances", "inputs", "biases", "mounting"),
    )


@cache
def model_functions(car: Car) -> dict[str, ca.Function]:
    """All functions of a car by name, compiled where possible."""
    functions = None if codegen.compiler() is None else _compiled("car", car, functions_of, _names_of(car))
    return {f.name(): f for f in functions or _for_virtual_machine(car)}


def _for_virtual_machine(car: Car) -> list[ca.Function]:
    """The functions as CasADi runs them quickest: of a step in straight code, of the linearisation as matrices."""
    return [codegen.expanded(f) if f.name() == "advance" else f for f in functions_of(car)]


def _names_of(car: Car) -> tuple[str, ...]:
    """Names of the functions that `functions_of` makes."""
    names = ("dynamics", "linearize", "advance", "kinematics", "force")
    return (*names, "internal_state") if car.internal_state.numel() else names


def functions_of(car: Car) -> list[ca.Function]:
    """All functions of a car but those of its sensors."""
    functions = [
        dynamics_function(car),
        linearize_function(car),
        advance_function(car),
        kinematics_function(car),
        force_function(car),
    ]
    return [*functions, internal_state_function(car)] if car.internal_state.numel() else functions


def _compiled(
    name: str, car: Car, make: Callable[[Car], list[ca.Function]], names: Sequence[str]
) -> list[ca.Function] | None:
    """The functions with these names that `make` makes, compiled, with what the corners have in common done for all
    four at once. Their expressions are made only if the cache does not have them for a car with this identity."""

    def source() -> str:
        generic_car = car.corners_alike
        return codegen.native_source(make(generic_car), corners_of(generic_car))

    return codegen.loaded(name, source, names, car.identity or codegen.identity_of(make(car)))


def corners_of(car: Car) -> codegen.Corners:
    """How arguments of the functions of a car with `corners_alike` belong to its corners."""
    return codegen.Corners(_alike(car), {"placement": car.placed})


def _alike(car: Car) -> codegen.Alike:
    """What the elements of arguments are at each corner: names without the wheel or axle, and which corner it is."""
    generic = dict.fromkeys(WHEELS, "wheel") | dict.fromkeys(("front", "rear"), "axle")
    parameters = [".".join(generic.get(w, w) for w in name.split(".")) for name in car.parameter_names]
    parameters = [re.sub("_to_(front|rear)_axle", "_to_axle", name) for name in parameters]
    internal = {
        part.start + i: ((effect, i % (size // 4)), i // (size // 4)) if size % 4 == 0 else ((effect, i), None)
        for effect, part in car.internal_state_slices.items()
        for size in (part.stop - part.start,)
        for i in range(size)
    }

    axle = (len(car.placed) - len(PLACEMENT)) // 2  # numbers of an axle's tables

    def alike(argument: str, element: int) -> tuple[Hashable, int | None]:
        if argument == "p":
            return parameters[element], None
        if argument == "placement":
            return (argument, (element - len(PLACEMENT)) % axle if element >= len(PLACEMENT) else -1), None
        if argument == "internal_state":
            return internal[element]
        if argument == "inputs" and element:
            return "torque", element - 1
        column, row = divmod(element, COORDINATES)
        if argument in _BY_COORDINATE and row >= TRAVEL.start:
            return (argument, column, (row - TRAVEL.start) // 4), (row - TRAVEL.start) % 4
        return (argument, element), None

    return alike


@cache
def compiled_wheel_forces(car: Car) -> ca.Function:
    """`wheel_force_function`, compiled where possible."""
    names = ("wheel_forces",)
    functions = None if codegen.compiler() is None else _compiled("wheel_forces", car, _wheel_functions, names)
    return functions[0] if functions else wheel_force_function(car)


def _wheel_functions(car: Car) -> list[ca.Function]:
    return [wheel_force_function(car)]


@cache
def sensor_functions(car: Car, sensors: tuple[SensorBase, ...]) -> dict[str, ca.Function]:
    """The functions of the sensors that correct the model, by kind, compiled where possible."""
    kinds = {sensor.kind: sensor for sensor in sensors if not sensor.is_input}
    return dict(zip(kinds, codegen.compiled("sensors", [sensor_function(car, s) for s in kinds.values()]), strict=True))
