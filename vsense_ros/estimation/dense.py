"""A state space at numbers, for an extended Kalman filter: Jacobians written out, all in one call of C where it can be.

The transition matrix is sparse in most systems, biases and parameters have rows with a single 1 in them: F P Fᵀ uses
what is there, row by row. ekf.c has the operations, and those of NumPy here are what remains without a compiler.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Entry, Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.estimation.operations import ADDRESS, Operations, library, misfit, unknown_sensor
from vsense_ros.estimation.state_space import (
    Measurement,
    StateSpace,
    Symbols,
    by_name,
    check_names,
    parameter_values,
    residual,
    title,
)

UNLIMITED = 1e15  # amount beyond which a state is impossible, where none is named
Places = NDArray[np.int64]
_CHECKED = 1e-3  # [s], step with which a state space is tried at start


class Dense:
    """A state space and its measurements, with numbers for its parameters, by name or in their order.

    `memory` is one array: mean (n,), covariance (e, e), inputs (k,), parameters (p,), and `extra` numbers of a filter
    that needs some. It may be given, as a part of another's, and so may `functions` that were made before of the same
    state space. Raises `InputError` where the state space does not fit itself, its measurements or the parameters.
    """

    def __init__(
        self,
        system: StateSpace,
        measurements: Sequence[Measurement],
        parameters: Mapping[str, float] | Sequence[float] | Array = (),
        memory: Array | None = None,
        functions: Jacobians | None = None,
        extra: int = 0,
    ) -> None:
        self.system = system
        self.measurements = by_name(measurements, COMPONENTS)
        self.names, self.sensors = system.names, tuple(self.measurements)
        values = parameter_values(system, parameters)
        self.components: Mapping[str, int] = {name: len(one.deviations) for name, one in self.measurements.items()}
        self.memory, self.mean, self.covariance, self.inputs, self.parameters, self.extra = laid_out(
            system, memory, extra
        )
        self.parameters[:] = values
        self._kernels = _Kernels(self, functions or Jacobians(system, measurements))
        self._operations = _compiled(self, self._kernels)

    def at(self, memory: Array) -> Dense:
        """This system with its memory in another array (s,)."""
        memory[:] = self.memory
        sensors, functions = tuple(self.measurements.values()), self._kernels.functions
        return Dense(self.system, sensors, self.parameters.copy(), memory, functions, len(self.extra))

    @property
    def operations(self) -> Operations | None:
        """In C, or None without a compiler."""
        return self._operations

    @property
    def transition_matrix(self) -> Array:
        """F (e, e) of the last step."""
        return self._kernels.matrix()

    @property
    def noise(self) -> Array:
        """Q (e, e) of the last step."""
        return self._kernels.noise()

    def start(self, belief: Gaussian) -> None:
        """Begin anew at a mean and a covariance."""
        self.mean[:], self.covariance[:] = belief.mean, belief.covariance

    def linearize(self) -> None:
        """There is nothing to prepare: a step and a measurement linearise at the mean themselves. This tries both.

        Raises `InputError` where a Jacobian is not finite.
        """
        kernels = self._kernels
        kernels.h[0] = _CHECKED
        kernels.transition.call()
        for result, what in zip(kernels.transition.results, ("state", "Jacobian", "noise"), strict=True):
            if not np.isfinite(result).all():
                raise InputError(f"{title(self.system)}: after a step the {what} is not finite, {self._where()}")
        for name, kernel in kernels.sense.items():
            kernel.value[:] = 0.0
            kernel.call()
            if kernel.used and not (np.isfinite(kernel.residual).all() and np.isfinite(kernel.by_error).all()):
                raise InputError(
                    f"{title(self.system)}: the measurement {name!r} or its Jacobian is not finite, {self._where()}"
                )

    def _where(self) -> str:
        """The present state and inputs, for a message."""
        inputs = zip(self.system.inputs, self.inputs, strict=True)
        everything = [*zip(self.names, self.mean, strict=True), *inputs]
        return "at " + ", ".join(f"{name} = {value:.4g}" for name, value in everything)

    def step(self, h: float) -> None:
        """mean ← f(mean, h), covariance ← F P Fᵀ + Q."""
        moved, f, noise = self.moved(h)
        grown = f @ self.covariance @ f.T + noise
        self.covariance[:] = 0.5 * (grown + grown.T)
        self.mean[:] = moved

    def moved(self, h: float) -> tuple[Array, Array, Array]:
        """State (n,) after a step of `h` [s] from the mean, F and Q (e, e) of it; the mean stays. Raises
        `FloatingPointError` where that state is not finite."""
        kernels = self._kernels
        kernels.h[0] = h
        kernels.transition.call()
        moved = kernels.transition.results[0][:, 0].copy()
        if not np.isfinite(moved).all():
            raise FloatingPointError(f"{title(self.system)} cannot be moved, {self._where()}")
        return moved, kernels.matrix(), kernels.noise()

    def sense(self, sensor: str, value: Array) -> tuple[Array, Array]:
        """Innovation (m,), NaN where the measurement is not used, and H (m, e)."""
        kernel = self._kernels.of(sensor)
        kernel.measured(value)
        kernel.call()
        return (kernel.residual if kernel.used else np.full(len(value), np.nan)), kernel.by_error

    def retract(self, error: Array) -> None:
        """mean ← mean ⊞ error."""
        if self.system.is_flat:
            self.mean += error
            return
        self._kernels.error[:] = error
        self._kernels.retract.call()
        self.mean[:] = self._kernels.retract.results[0][:, 0]

    def retracted(self, mean: Array, error: Array) -> Array:
        """mean (n,) ⊞ error (e,), (n,)."""
        if self.system.is_flat:
            return mean + error
        return np.array(self._kernels.functions.retract(mean, error))[:, 0]

    def difference(self, to: Array, mean: Array) -> Array:
        """to (n,) ⊟ mean (n,), (e,)."""
        if self.system.is_flat:
            return to - mean
        return np.array(self._kernels.functions.difference(to, mean))[:, 0]

    def is_valid(self) -> bool:
        """True if the mean is finite and within its bounds, and no variance below zero."""
        within = np.abs(self.mean) < self._kernels.largest
        variances = self.covariance.diagonal()
        return np.count_nonzero(within) == within.size and bool(variances.min() >= 0)


def laid_out(
    system: StateSpace, memory: Array | None, extra: int = 0
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Memory, and the parts of it: mean, covariance, inputs, parameters and `extra` numbers."""
    check_names(system)
    n, e, k, p = (len(s) for s in (system.names, system.error_names, system.inputs, system.parameters))
    memory = np.zeros(n + e * e + k + p + extra) if memory is None else memory
    mean, covariance, inputs, parameters, rest = np.split(memory, np.cumsum([n, e * e, k, p]).tolist())
    return memory, mean, covariance.reshape(e, e), inputs, parameters, rest


class Jacobians:
    """Functions of a state space that an extended Kalman filter needs, compiled together."""

    def __init__(self, system: StateSpace, measurements: Sequence[Measurement]) -> None:
        at = Symbols(system)
        moved, noise = at.moved(), at.noise()
        turned = at.transition_matrix(moved).T  # column by column, as CasADi keeps it: F row by row
        self.row = np.array(turned.sparsity().colind(), dtype=np.int64)
        self.column = np.array(turned.sparsity().row(), dtype=np.int64)
        self.errors = len(system.error_names)
        self.place = _places(noise)
        results = [moved, _elements(turned), _elements(noise)]
        made = [codegen.function("transition", [*at.now, at.h], results, ("x", "u", "p", "h"))]
        delta = ca.SX.sym("delta", self.errors)
        made.append(codegen.function("retract", [at.x.vector, delta], [at.retracted(delta)], ("x", "d")))
        y = ca.SX.sym("y", len(system.names))
        self.difference = ca.Function("difference", [y, at.x.vector], [at.difference(y)])
        made += [sensing(at, one, i) for i, one in enumerate(measurements)]
        self.written = tuple(made)  # the same, not compiled: for who writes them as sources
        self.transition, self.retract, *self.sense = codegen.compiled(f"filter_{title(system)}", made)


def sensing(at: Symbols, measurement: Measurement, index: int) -> ca.Function:
    """(x, u, θ, value) → innovation (m,), Hᵀ (e, m), and a number that is not zero where the measurement is used."""
    expected, used = at.measured(measurement)
    value = ca.SX.sym("value", len(measurement.deviations))
    results = [residual(value, expected, measurement.angles), at.by_error(expected).T, used]
    return codegen.function(f"sense_{index}", [*at.now, value], results, ("x", "u", "p", "value"))


def _elements(matrix: ca.SX) -> ca.SX:
    """Elements that are not structurally zero, column by column, at least one."""
    return ca.SX(matrix.nz[:]) if matrix.nnz() else ca.SX(0.0)


def _places(matrix: ca.SX) -> Places:
    """Where the elements of a symmetric matrix stand in a row-major array."""
    rows, columns = matrix.sparsity().get_triplet()
    return np.array([j * matrix.shape[0] + i for i, j in zip(rows, columns, strict=True)], dtype=np.int64)


class _Sense:
    """One sensor's function, with the value and the variances (m,) that it reads."""

    def __init__(self, function: ca.Function, at: Sequence[Array], measurement: Measurement) -> None:
        m = self.components = len(measurement.deviations)
        self.name, self.value = measurement.name, np.zeros(m)
        self.kernel = Kernel(function, [*at, self.value])
        self.call = self.kernel.call
        residual, by_error, self._used = self.kernel.results
        self.residual, self.by_error = residual[:, 0], by_error.T

    @property
    def used(self) -> bool:
        """True if the sensor's condition held at the last call."""
        return bool(self._used[0, 0] != 0)

    def measured(self, value: Array) -> None:
        """Take a value. Raises `InputError` if it is not one of this sensor's."""
        if len(value) != self.components:
            raise misfit(self.name, self.components, value)
        self.value[:] = value


class _Kernels:
    """The functions of a state space, bound to the arrays of one filter."""

    def __init__(self, dense: Dense, functions: Jacobians) -> None:
        self.functions, e = functions, functions.errors
        self.h, self.error = np.zeros(1), np.zeros(e)
        at = [dense.mean, dense.inputs, dense.parameters]
        self.transition = Kernel(functions.transition, [*at, self.h])
        self.retract = Kernel(functions.retract, [dense.mean, self.error])
        pairs = zip(functions.sense, dense.measurements.values(), strict=True)
        self.sense = {one.name: _Sense(function, at, one) for function, one in pairs}
        self.largest = np.array([dense.system.largest.get(name, UNLIMITED) for name in dense.names])
        rows = np.repeat(np.arange(e), np.diff(functions.row))
        self._places = rows * e + functions.column

    def of(self, sensor: str) -> _Sense:
        """One sensor's. Raises `InputError` if there is none of this name."""
        sense = self.sense.get(sensor)
        if sense is None:
            raise unknown_sensor(sensor, tuple(self.sense))
        return sense

    def matrix(self) -> Array:
        """F (e, e) of the last call."""
        return self._square(self._places, self.transition.results[1])

    def noise(self) -> Array:
        """Q (e, e) of the last call."""
        return self._square(self.functions.place, self.transition.results[2])

    def _square(self, places: Places, elements: Array) -> Array:
        e = self.functions.errors
        square = np.zeros(e * e)
        square[places] = elements[: len(places), 0]
        return square.reshape(e, e)


_COUNT = ctypes.c_longlong


class _Live(ctypes.Structure):
    """`struct live` of ekf.c."""

    _fields_ = [
        *((name, Entry) for name in ("transition", "retract")),
        *((name, _COUNT) for name in ("size", "numbers", "added")),
        *((name, ADDRESS) for name in ("memory", "mean", "covariance", "inputs", "h", "error", "whitened", "factor")),
        *((name, ADDRESS) for name in ("moved", "f", "q", "off", "largest", "row", "column", "place")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of ekf.c."""

    _fields_ = [
        *(("sense", Entry), ("components", _COUNT)),
        *((name, ADDRESS) for name in ("value", "residual", "by_error", "used")),
    ]


def _compiled(dense: Dense, kernels: _Kernels) -> Operations | None:
    """The operations of ekf.c, or None if the functions or these are not compiled."""
    every = [kernels.transition, kernels.retract, *(sense.kernel for sense in kernels.sense.values())]
    if any(kernel.entry() is None for kernel in every):
        return None
    compiled = library("ekf", kernels.functions.errors, "estimation/innovation.c", "estimation/ekf.c")
    if compiled is None:
        return None
    innovation = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)
    sensors = {name: (_sensor(sense), sense.components) for name, sense in kernels.sense.items()}
    impossible = f"{title(dense.system)} cannot be moved: its state would not be finite"
    return Operations(compiled, _live(dense, kernels, *innovation), sensors, kernels.h, innovation, impossible)


def _live(dense: Dense, kernels: _Kernels, whitened: Array, factor: Array) -> _Live:
    moved, f, q = (result.reshape(-1, order="F") for result in kernels.transition.results)
    functions = kernels.functions
    arrays: dict[str, Any] = {
        **{name: getattr(dense, name) for name in ("memory", "mean", "covariance", "inputs")},
        **{name: getattr(kernels, name) for name in ("h", "error", "largest")},
        **{name: getattr(functions, name) for name in ("row", "column", "place")},
        "whitened": whitened,
        "factor": factor,
        "moved": moved,
        "f": f,
        "q": q,
        "off": kernels.retract.results[0].reshape(-1, order="F"),
    }
    made = _Live(
        transition=kernels.transition.entry(),
        retract=Entry() if dense.system.is_flat else kernels.retract.entry(),
        size=dense.memory.size,
        numbers=dense.mean.size,
        added=len(functions.place),
        **{name: array.ctypes.data for name, array in arrays.items()},
    )
    made.kept = arrays  # type: ignore[attr-defined]
    return made


def _sensor(sense: _Sense) -> _Sensor:
    residual, by_error, used = (result.reshape(-1, order="F") for result in sense.kernel.results)
    arrays = {"value": sense.value, "residual": residual, "by_error": by_error, "used": used}
    addresses = {name: array.ctypes.data for name, array in arrays.items()}
    made = _Sensor(sense=sense.kernel.entry(), components=sense.components, **addresses)
    made.kept = arrays  # type: ignore[attr-defined]
    return made
