"""The car from recorded inputs, again and again: what identification and the search for missing physics run.

Steps are those of `simulate` (ROS2), with the Jacobian renewed only where a state is kept: the method is of second
order with any matrix. With a compiler a whole run is one call of C; without one the same loop runs in Python.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.model import codegen
from vsense_ros.model.car import COORDINATES, INPUTS, SPIN, SURROUNDINGS, Car
from vsense_ros.model.codegen import Kernel
from vsense_ros.model.steps import GAMMA, advance_function, linearize_function, remember_function

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inputs:
    """What drives a run, one row for each of n steps."""

    step: float  # [s]
    inputs: Array  # (n, 5) in the middle of each step, as model.car.INPUTS
    surroundings: Array  # (n, 4) as model.car.SURROUNDINGS
    varying: Mapping[str, Array] = field(default_factory=dict)  # (n,) each in place of the parameter of this name
    target: Array | None = None  # (n,) mean spin of the wheels [rad/s] that a torque on each of them holds …
    gain: Array | None = None  # (n, 4) … by this much [N m s/rad], zero for torques as they are

    def __len__(self) -> int:
        return len(self.inputs)


@dataclass(frozen=True)
class Motion:
    """Every `keep`-th state of a run, (rows, 14) each; rows that the run did not reach are NaN."""

    t: Array  # (rows,) from the beginning of the run [s]
    q: Array
    u: Array
    udot: Array


class OpenLoop:
    """Runs of one car; `keep` says that every so many steps a state is kept, and the car linearised."""

    def __init__(self, car: Car, keep: int = 2) -> None:
        self.car = car
        self.keep = keep
        self._compiled = _compiled(car)
        self._place = {name: place for place, name in enumerate(car.parameter_names)}

    def run(self, q: Array, u: Array, inputs: Inputs, parameters: Array) -> Motion:
        """A run from the state `q`, `u` (14 each), with the effects' memories empty."""
        steps = len(inputs)
        rows = (steps + self.keep - 1) // self.keep
        kept = [np.full((rows, COORDINATES), np.nan) for _ in range(3)]
        state = [np.array(q, dtype=float), np.array(u, dtype=float), np.zeros(self.car.memory.numel())]
        parameters = np.array(parameters, dtype=float)
        if self._compiled is not None:
            self._run_compiled(state, inputs, parameters, kept)
        else:
            self._run_plain(state, inputs, parameters, kept)
        return Motion(np.arange(rows, dtype=float) * self.keep * inputs.step, *kept)

    def _run_compiled(self, state: list[Array], inputs: Inputs, parameters: Array, kept: list[Array]) -> None:
        assert self._compiled is not None
        function, work, integers = self._compiled
        n = len(inputs)
        columns = [
            np.ascontiguousarray(column, dtype=float)
            for column in (
                inputs.inputs,
                inputs.surroundings,
                np.zeros(n) if inputs.target is None else inputs.target,
                np.zeros((n, 4)) if inputs.gain is None else inputs.gain,
                np.column_stack(list(inputs.varying.values())) if inputs.varying else np.zeros(0),
            )
        ]
        places = np.array([self._place[name] for name in inputs.varying], dtype=np.int64)
        run = _Run(
            n, self.keep, inputs.step, *map(_pointer, state), *map(_pointer, columns), _pointer(parameters),
            len(places), places.ctypes.data_as(_Integers), *map(_pointer, kept), _pointer(work),
            integers.ctypes.data_as(_Integers),
        )  # fmt: skip
        function(ctypes.byref(run))

    def _run_plain(self, state: list[Array], inputs: Inputs, parameters: Array, kept: list[Array]) -> None:
        now_q, now_u, memory = state
        size = COORDINATES
        functions = _functions(self.car)
        driving, around = np.zeros(len(INPUTS)), np.zeros(len(SURROUNDINGS))
        arguments = [now_q, now_u, np.zeros(size), around, driving, parameters, memory]
        h, inverse = np.array([inputs.step]), np.zeros(size**2)
        linearize = Kernel(functions["linearize"], arguments)
        udot, by_q, by_u, _, by_q_rates = linearize.results
        # The memory belongs to the beginning of a step, inputs to its middle.
        between, before = np.zeros(len(INPUTS)), np.zeros(len(INPUTS))
        beginning = [*arguments[:4], between, *arguments[5:], h]
        remember = Kernel(functions["remember"], beginning) if memory.size else None
        advance = Kernel(functions["advance"], [*arguments, h, inverse, by_q.reshape(-1, order="F")])
        unit, scale = np.eye(size), GAMMA * inputs.step
        for i in range(len(inputs)):
            driving[:], around[:] = inputs.inputs[i], inputs.surroundings[i]
            for name, values in inputs.varying.items():
                parameters[self._place[name]] = values[i]
            if inputs.gain is not None and inputs.target is not None:
                driving[1:] += inputs.gain[i] * (inputs.target[i] - now_u[SPIN].mean())
            if remember is not None:
                between[:] = (before + driving) / 2 if i else driving
                before[:] = driving
                remember.call()
                memory[:] = remember.results[0][:, 0]
            if i % self.keep == 0:
                linearize.call()
                for column, value in zip(kept, (now_q, now_u, udot[:, 0]), strict=True):
                    column[i // self.keep] = value
                try:
                    inverse[:] = np.linalg.inv(unit - scale * (by_u + scale * by_q_rates)).reshape(-1, order="F")
                except np.linalg.LinAlgError:
                    return
            advance.call()
            if not np.isfinite(sum(result.sum() for result in advance.results)):
                return
            now_q[:], now_u[:] = (result[:, 0] for result in advance.results)


_Doubles = ctypes.POINTER(ctypes.c_double)
_Integers = ctypes.POINTER(ctypes.c_longlong)


class _Run(ctypes.Structure):
    _fields_ = (
        ("steps", ctypes.c_longlong),
        ("keep", ctypes.c_longlong),
        ("h", ctypes.c_double),
        *((name, _Doubles) for name in ("q", "u", "memory")),
        *((name, _Doubles) for name in ("inputs", "surroundings", "target", "gain", "varying")),
        ("parameters", _Doubles),
        ("varied", ctypes.c_longlong),
        ("places", _Integers),
        *((name, _Doubles) for name in ("kept_q", "kept_u", "kept_udot")),
        ("work", _Doubles),
        ("integers", _Integers),
    )


def _pointer(array: Array) -> ctypes._Pointer[ctypes.c_double]:
    return array.ctypes.data_as(_Doubles)


@cache
def _functions(car: Car) -> dict[str, ca.Function]:
    made = [linearize_function(car), advance_function(car)]
    if car.memory.numel():
        made.append(remember_function(car))
    return {function.name(): function.expand() for function in made}


@cache
def _compiled(car: Car) -> tuple[ctypes._FuncPointer, Array, NDArray[np.int64]] | None:
    """The loop in C for this car, and the memory that its functions work in; None without a compiler."""
    if codegen.compiler() is None:
        return None
    generator = ca.CodeGenerator("model.c", {"with_header": False})
    functions = _functions(car).values()
    for function in functions:
        generator.add(function)
    loop = resources.files("vsense_ros.model").joinpath("open_loop.c").read_text(encoding="utf-8")
    if not car.memory.numel():
        generated = "static int remember(const double **a, double **r, long long *i, double *w, int m) { return 0; }\n"
    else:
        generated = ""
    # Not to be mistaken for functions of the same names elsewhere, such as the C library's own `advance`.
    private = "#define CASADI_SYMBOL_EXPORT static\n"
    constants = f"#define MEMORY {car.memory.numel()}\n#define GAMMA {GAMMA!r}\n"
    built = codegen.library("open_loop", "\n".join((private, generator.dump(), generated, constants, loop)))
    if built is None:
        return None
    loop_function = ctypes.CDLL(str(built)).open_loop
    loop_function.restype = ctypes.c_longlong
    work = np.zeros(max(f.sz_w() for f in functions))
    integers = np.zeros(max(f.sz_iw() for f in functions) + 1, dtype=np.int64)
    return loop_function, work, integers
