"""The car from recorded inputs, again and again: what identification and the search for missing physics run.

Steps are those of `simulate` (ROS2), with the Jacobian renewed only every few steps: the method is of second order with
any matrix. With a compiler several runs go side by side in one call of C, as many as the processor's vectors
have lanes; without one the same loop runs in Python, one run after the other.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel, simd
from vsense_ros.codegen.columns import Doubles, Integers, beside, in_lanes, integers, pointer
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.steps import (
    GAMMA,
    accelerations_function,
    advance_function,
    internal_state_function,
    linearize_function,
)
from vsense_ros.model.coordinates import (
    COORDINATES,
    DISTURBANCES,
    DYNAMIC_COORDINATES,
    INPUTS,
    SPIN,
    TORQUES,
    WHEELS,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inputs:
    """The inputs that drive a run, one row for each of n steps."""

    step: float  # [s]
    inputs: Array  # (n, 6) in the middle of each step, as model.coordinates.INPUTS
    disturbances: Array  # (n, 7) as model.coordinates.DISTURBANCES
    varying: Mapping[str, Array] = field(default_factory=dict)  # (n,) each in place of the parameter of this name
    target: Array | None = None  # (n,) mean spin of the wheels [rad/s] that a torque on each of them holds …
    gain: Array | None = None  # (n, 4) … by this much [N m s/rad], zero for torques as they are

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def held(self) -> tuple[Array, Array]:
        """The mean spin (n,) that is held, and the gain (n, 4); zeros where torques are as they are."""
        n = len(self.inputs)
        return (
            np.zeros(n) if self.target is None else self.target,
            np.zeros((n, len(WHEELS))) if self.gain is None else self.gain,
        )

    def first(self, steps: int) -> Inputs:
        """The inputs of the first so many steps."""
        varying = {name: values[:steps] for name, values in self.varying.items()}
        target, gain = (None if values is None else values[:steps] for values in (self.target, self.gain))
        return Inputs(self.step, self.inputs[:steps], self.disturbances[:steps], varying, target, gain)


@dataclass(frozen=True)
class StateHistory:
    """Every `keep`-th state of a run, (rows, 14) each; rows that the run did not reach are NaN."""

    t: Array  # (rows,) from the beginning of the run [s]
    q: Array
    u: Array
    udot: Array
    internal_state: Array  # (m,) of the effects in the last step, as `Car.internal_state`; NaN if not reached


@dataclass(frozen=True)
class Run:
    """From the state `q`, `u` (14 each) and the effects' internal state (m,), zero if it is not given; parameters in
    the order of the car."""

    q: Array
    u: Array
    inputs: Inputs
    parameters: Array
    internal_state: Array | None = None


class OpenLoop:
    """Runs of one car: every `keep` steps a state is kept, and every `renew` steps, as often if that is not given, the
    Jacobian is renewed."""

    def __init__(self, car: Car, keep: int = 2, renew: int | None = None) -> None:
        self.car = car
        self.keep = keep
        self.renew = keep if renew is None else renew
        self._compiled = _compiled(car)
        self.place = {name: place for place, name in enumerate(car.parameter_names)}

    @property
    def lanes(self) -> int:
        """How many runs cost no more than one."""
        return 1 if self._compiled is None else self._compiled.lanes

    @property
    def library(self) -> ctypes.CDLL | None:
        """The compiled functions, those of differences.c too; None without a compiler."""
        return None if self._compiled is None else self._compiled.library

    def run(self, q: Array, u: Array, inputs: Inputs, parameters: Array) -> StateHistory:
        """One run alone, which costs as much as several side by side."""
        return self.runs([Run(q, u, inputs, parameters)])[0]

    def runs(self, runs: Sequence[Run]) -> list[StateHistory]:
        """Motions of several runs, one for each; all of them have steps of the same length, else `ValueError`."""
        if len({run.inputs.step for run in runs}) > 1:
            raise ValueError("runs side by side need steps of the same length")
        motions = [self._motion(run) for run in runs]
        if self._compiled is None:
            for run, motion in zip(runs, motions, strict=True):
                self._run_plain(run, motion)
            return motions
        # Those that take about as long go together.
        order = sorted(range(len(runs)), key=lambda i: len(runs[i].inputs))
        count = self._compiled.lanes
        for begin in range(0, len(order), count):
            lanes = order[begin : begin + count]
            self._compiled.run([runs[i] for i in lanes], [motions[i] for i in lanes], self.keep, self.renew, self.place)
        return motions

    def _motion(self, run: Run) -> StateHistory:
        rows = (len(run.inputs) + self.keep - 1) // self.keep
        q, u, udot = (np.full((rows, COORDINATES), np.nan) for _ in range(3))
        internal_state = np.full(self.car.internal_state.numel(), np.nan)
        return StateHistory(np.arange(rows, dtype=float) * self.keep * run.inputs.step, q, u, udot, internal_state)

    def _run_plain(self, run: Run, motion: StateHistory) -> None:
        inputs, recorded = run.inputs, (motion.q, motion.u, motion.udot)
        now_q, now_u, parameters = (np.array(begin, dtype=float) for begin in (run.q, run.u, run.parameters))
        internal_state = beginning(run, len(motion.internal_state))
        size = COORDINATES
        functions = _functions(self.car)
        driving, around = np.zeros(len(INPUTS)), np.zeros(len(DISTURBANCES))
        arguments = [now_q, now_u, np.zeros(size), around, driving, parameters, internal_state]
        h, inverse = np.array([inputs.step]), np.zeros(size**2)
        linearize = Kernel(functions["linearize"], arguments)
        _, by_q, by_u, by_q_rates = linearize.results
        # The internal state belongs to the beginning of a step, inputs to its middle.
        inputs_at_begin, before = np.zeros(len(INPUTS)), np.zeros(len(INPUTS))
        from_beginning = [*arguments[:4], inputs_at_begin, *arguments[5:], h]
        move_on = Kernel(functions["internal_state"], from_beginning) if internal_state.size else None
        advance = Kernel(functions["advance"], [*arguments, h, inverse, by_q.reshape(-1, order="F")])
        unit, scale, by_held_speed = np.eye(size), GAMMA * inputs.step, np.zeros((size, size))
        target, gain = inputs.held
        for i in range(len(inputs)):
            driving[:], around[:] = inputs.inputs[i], inputs.disturbances[i]
            for name, values in inputs.varying.items():
                parameters[self.place[name]] = values[i]
            driving[TORQUES] += gain[i] * (target[i] - now_u[SPIN].mean())
            if move_on is not None:
                inputs_at_begin[:] = (before + driving) / 2 if i else driving
                before[:] = driving
                move_on.call()
                internal_state[:] = move_on.results[0][:, 0]
            if i % self.renew == 0:
                # Torques that hold a speed follow the mean spin. Accelerations are linear in them.
                driving[TORQUES] += gain[i]
                linearize.call()
                pulled = linearize.results[0].copy()
                driving[TORQUES] -= gain[i]
                linearize.call()
                by_held_speed[:, SPIN] = (linearize.results[0] - pulled) / len(WHEELS)
                try:
                    matrix = by_u + by_held_speed + scale * by_q_rates
                    inverse[:] = np.linalg.inv(unit - scale * matrix).reshape(-1, order="F")
                except np.linalg.LinAlgError:
                    return
            advance.call()
            if i % self.keep == 0:
                for column, value in zip(recorded, (now_q, now_u, advance.results[2].ravel()), strict=True):
                    column[i // self.keep] = value
            if not np.isfinite(sum(result.sum() for result in advance.results[:2])):
                return
            now_q[:], now_u[:] = (result[:, 0] for result in advance.results[:2])
        motion.internal_state[:] = internal_state


class _Run(ctypes.Structure):
    """`struct run` of open_loop.c."""

    _fields_ = (
        ("keep", ctypes.c_longlong),
        ("renew", ctypes.c_longlong),
        ("h", ctypes.c_double),
        ("steps", Integers),
        *((name, Doubles) for name in ("q", "u")),
        *((name, Doubles) for name in ("inputs", "disturbances", "target", "gain", "varying", "parameters")),
        ("varied", ctypes.c_longlong),
        ("places", Integers),
        *((name, Doubles) for name in ("memory", "remembered")),
        *((name, Doubles) for name in ("kept_q", "kept_u", "kept_udot")),
        ("rows", ctypes.c_longlong),
        ("kept", Integers),
    )


@dataclass(frozen=True)
class _Compiled:
    """The loop in C for one car."""

    library: ctypes.CDLL
    lanes: int

    def run(
        self, runs: Sequence[Run], motions: Sequence[StateHistory], keep: int, renew: int, place: Mapping[str, int]
    ) -> None:
        """At most as many runs as there are lanes; fills their motions."""
        steps = np.array([len(run.inputs) for run in runs] + [0] * (self.lanes - len(runs)), dtype=np.int64)
        longest, h = int(steps.max()), runs[0].inputs.step
        varied = sorted({name for run in runs for name in run.inputs.varying})
        places = np.array([place[name] for name in varied], dtype=np.int64)

        drives = [run.inputs for run in runs]
        columns = [
            in_lanes(self.lanes, *(run.q for run in runs)),
            in_lanes(self.lanes, *(run.u for run in runs)),
            beside(self.lanes, longest, *(drive.inputs for drive in drives)),
            beside(self.lanes, longest, *(drive.disturbances for drive in drives)),
            *(beside(self.lanes, longest, *column) for column in zip(*(drive.held for drive in drives), strict=True)),
            beside(self.lanes, longest, *(varying_of(run, varied, places) for run in runs)),
            in_lanes(self.lanes, *(run.parameters for run in runs)),
        ]
        rows = max(len(motion.t) for motion in motions)
        size = len(motions[0].internal_state)
        internal_state = in_lanes(self.lanes, *(beginning(run, size) for run in runs))
        remembered = np.full((self.lanes, size), np.nan)
        recorded = [np.zeros((self.lanes, rows, COORDINATES)) for _ in range(3)]
        reached = np.zeros(self.lanes, dtype=np.int64)
        arguments = _Run(
            keep, renew, h, integers(steps), *map(pointer, columns), len(places), integers(places),
            *map(pointer, (internal_state, remembered, *recorded)), rows, integers(reached),
        )  # fmt: skip
        self.library.open_loop(ctypes.byref(arguments))
        for lane, motion in enumerate(motions):
            for state, column in zip((motion.q, motion.u, motion.udot), recorded, strict=True):
                state[: reached[lane]] = column[lane, : reached[lane]]
            motion.internal_state[:] = remembered[lane]


def beginning(run: Run, size: int) -> Array:
    """A copy of the effects' internal state where a run begins, (size,)."""
    return np.zeros(size) if run.internal_state is None else np.array(run.internal_state, dtype=float)


def varying_of(run: Run, names: Sequence[str], places: NDArray[np.int64]) -> Array:
    """(n, names) of the parameters that vary in any of the runs."""
    varying = np.tile(run.parameters[places], (len(run.inputs), 1))
    for column, name in enumerate(names):
        if name in run.inputs.varying:
            varying[:, column] = run.inputs.varying[name]
    return varying


@cache
def _functions(car: Car) -> dict[str, ca.Function]:
    """Straight code on scalars. Of the Jacobians only those that a step needs."""
    linearize = linearize_function(car).expand()
    state = [ca.SX.sym(linearize.name_in(i), *linearize.size_in(i)) for i in range(linearize.n_in())]
    udot, by_q, by_u, _, by_q_rates = linearize(*state)
    functions = [
        ca.Function("linearize", state, [udot, by_q, by_u, by_q_rates]),
        accelerations_function(car).expand(),
        advance_function(car, with_udot=True).expand(),
        ca.Function("rates", [car.q, car.u, car.disturbances], [ca.densify(car.kinematics)], {"cse": True}),
    ]
    if car.internal_state.numel():
        functions.append(internal_state_function(car).expand())
    return {function.name(): function for function in functions}


@cache
def _compiled(car: Car) -> _Compiled | None:
    """The loop in C for this car; None without a compiler."""
    if codegen.compiler() is None:
        return None
    functions = _functions(car)
    constants = {
        "MEMORY": car.internal_state.numel(), "GAMMA": repr(GAMMA), "PARAMETERS": car.p.numel(),
        "COORDINATES": COORDINATES, "DYNAMIC": len(DYNAMIC_COORDINATES), "INPUTS": len(INPUTS), "WHEELS": len(WHEELS),
        "DISTURBANCES": len(DISTURBANCES), "SPIN": SPIN.start, "TORQUES": TORQUES.start,
        "DYNAMIC_PLACES": ", ".join(map(str, DYNAMIC_COORDINATES)),
    }  # fmt: skip
    defined = "\n".join(f"#define {name} {value}" for name, value in constants.items())
    if "internal_state" not in functions:
        defined += "\n#define INTERNAL_STATE_WORK 0\n#define internal_state(in, out, work)"
    folder = resources.files("vsense_ros.model.simulation")
    loops = (folder.joinpath(name).read_text(encoding="utf-8") for name in ("open_loop.c", "differences.c"))
    code = "\n".join((defined, *loops))
    all_functions = list(functions.values())
    built = codegen.library(
        "open_loop",
        lambda: f"{simd.source(all_functions)}\n{code}",
        codegen.vector_math(),
        identity=f"{codegen.identity_of(all_functions)}\n{code}",
    )
    if built is None:
        return None
    library = ctypes.CDLL(str(built))
    library.open_loop.restype = None
    return _Compiled(library, ctypes.c_longlong.in_dll(library, "lanes_at_once").value)
