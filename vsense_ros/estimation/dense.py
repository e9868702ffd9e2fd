"""A state space at numbers, for an extended Kalman filter: Jacobians written out, all in one call of C where it can be.

The transition matrix is sparse in most systems, biases and parameters have rows with a single 1 in them: F P Fᵀ uses
what is there, row by row. ekf.c has the operations, and those of NumPy here are what remains without a compiler.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from struct import Struct
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Entry, Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Gaussian, Given, Measured, Step
from vsense_ros.estimation.gaussian import COMPONENTS
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
    """Of a state space and its measurements, with numbers for its parameters, by name or in their order.

    `memory` is one array: mean (n,), covariance (e, e), inputs (k,), parameters (p,). It may be given, as a part of
    another's, and so may `functions` that were made before of the same state space. Raises `InputError` where the
    state space does not fit itself, its measurements or the parameters.
    """

    def __init__(
        self,
        system: StateSpace,
        measurements: Sequence[Measurement],
        parameters: Mapping[str, float] | Sequence[float] | Array = (),
        memory: Array | None = None,
        functions: Jacobians | None = None,
    ) -> None:
        self.system = system
        self.measurements = by_name(measurements, COMPONENTS)
        self.names, self.sensors = system.names, tuple(self.measurements)
        values = parameter_values(system, parameters)
        self.memory, self.mean, self.covariance, self.inputs, self.parameters = laid_out(system, memory)
        self.parameters[:] = values
        self._kernels = _Kernels(self, functions or Jacobians(system, measurements))
        self._operations = _compiled(self, self._kernels)

    def at(self, memory: Array) -> Dense:
        """The same, with its memory in this array (s,)."""
        memory[:] = self.memory
        sensors, functions = tuple(self.measurements.values()), self._kernels.functions
        return Dense(self.system, sensors, self.parameters.copy(), memory, functions)

    @property
    def operations(self) -> DenseOperations | None:
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
        for found, what in zip(kernels.transition.results, ("state", "Jacobian", "noise"), strict=True):
            if not np.isfinite(found).all():
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
        kernels = self._kernels
        kernels.h[0] = h
        kernels.transition.call()
        moved = kernels.transition.results[0][:, 0]
        if not np.isfinite(moved).all():
            raise FloatingPointError(f"{title(self.system)} cannot be moved, {self._where()}")
        f = kernels.matrix()
        grown = f @ self.covariance @ f.T + kernels.noise()
        self.covariance[:] = 0.5 * (grown + grown.T)
        self.mean[:] = moved

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
        """Whether the mean is finite and within its bounds, and no variance below zero."""
        within = np.abs(self.mean) < self._kernels.largest
        return bool(within.all() and (self.covariance.diagonal() >= 0).all())


def laid_out(system: StateSpace, memory: Array | None) -> tuple[Array, Array, Array, Array, Array]:
    """Memory, and the parts of it: mean, covariance, inputs, parameters."""
    check_names(system)
    n, e, k, p = (len(s) for s in (system.names, system.error_names, system.inputs, system.parameters))
    memory = np.zeros(n + e * e + k + p) if memory is None else memory
    mean, covariance, inputs, parameters = np.split(memory, np.cumsum([n, e * e, k]).tolist())
    return memory, mean, covariance.reshape(e, e), inputs, parameters


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
        self.name, self.value, self.variance = measurement.name, np.zeros(m), np.zeros(m)
        self.kernel = Kernel(function, [*at, self.value])
        self.call = self.kernel.call
        found, by_error, self._used = self.kernel.results
        self.residual, self.by_error = found[:, 0], by_error.T

    @property
    def used(self) -> bool:
        """Whether its condition held at the last call."""
        return bool(self._used[0, 0] != 0)

    def measured(self, value: Array) -> None:
        """Take a value. Raises `InputError` if it is not one of this sensor's."""
        if len(value) != self.components:
            raise self.misfit(value)
        self.value[:] = value

    def misfit(self, value: Array) -> InputError:
        """What to say of a value with another number of components."""
        return InputError(f"a measurement of {self.name!r} has {self.components} components, but got {len(value)}")


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
        found = self.sense.get(sensor)
        if found is None:
            raise InputError(f"the filter has no sensor {sensor!r}; it has: {', '.join(self.sense) or 'none'}")
        return found

    def matrix(self) -> Array:
        """F (e, e) of the last call."""
        return self._square(self._places, self.transition.results[1])

    def noise(self) -> Array:
        """Q (e, e) of the last call."""
        return self._square(self.functions.place, self.transition.results[2])

    def _square(self, places: Places, elements: Array) -> Array:
        e = self.functions.errors
        found = np.zeros(e * e)
        found[places] = elements[: len(places), 0]
        return found.reshape(e, e)


_ADDRESS, _COUNT, _NUMBER = ctypes.c_void_p, ctypes.c_longlong, ctypes.c_double
_EVENT = Struct("2P2d3q")  # `struct event` of ekf.c


class _System(ctypes.Structure):
    """`struct system` of ekf.c."""

    _fields_ = [
        *((name, Entry) for name in ("transition", "retract")),
        *((name, _COUNT) for name in ("size", "numbers", "added")),
        *((name, _ADDRESS) for name in ("memory", "mean", "covariance", "inputs", "h", "error", "whitened", "factor")),
        *((name, _ADDRESS) for name in ("moved", "f", "q", "off", "largest", "row", "column", "place")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of ekf.c."""

    _fields_ = [
        *(("sense", Entry), ("components", _COUNT)),
        *((name, _ADDRESS) for name in ("value", "variance", "residual", "by_error", "used")),
    ]


class DenseOperations:
    """What ekf.c does in one call each. The arrays of the filter must stay where they are."""

    def __init__(self, library: ctypes.CDLL, dense: Dense, kernels: _Kernels) -> None:
        self.whitened, self.factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)
        self._kernels, self._name = kernels, title(dense.system)
        self._system = _system_structure(dense, kernels, self.whitened, self.factor)
        self._sensors = {name: _sensor_structure(sense) for name, sense in kernels.sense.items()}
        self._address = ctypes.addressof(self._system)
        self._measured = {
            name: (ctypes.addressof(structure), kernels.sense[name].value, kernels.sense[name].variance)
            for name, structure in self._sensors.items()
        }
        self._predict, self._correct = library.vsense_predict, library.vsense_correct
        self._advance, self._repeat = library.vsense_advance, library.vsense_repeat

    def predict(self, h: float) -> None:
        """As `Dense.step`."""
        if not self._predict(self._address, h):
            raise FloatingPointError(f"{self._name} cannot be moved by {h} s: its state would not be finite")

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """As `Filter.correct`; returns the normalized innovation squared."""
        try:
            address, values, variances = self._measured[sensor]
        except KeyError:
            self._kernels.of(sensor)
            raise
        if len(value) != len(values):
            raise self._kernels.of(sensor).misfit(value)
        values[:] = value
        variances[:] = variance
        return self._correct(self._address, address, limit, scale)

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`."""
        kept, steps, h = step
        return bool(self._advance(self._address, kept.address, steps, h))

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """As `Filter.repeat`."""
        if not events:
            return 0, False, []
        rows, values, variances = [], [], []
        for step, event in events:
            kept, steps, h = (0, 0, 0.0) if step is None else (step.kept.address, step.steps, step.h)
            value = np.asarray(event.value, dtype=float)
            if isinstance(event, Measured):
                self._kernels.of(event.sensor).measured(value)
                rows.append(_EVENT.pack(self._measured[event.sensor][0], kept, h, event.limit, steps, 0, len(value)))
            else:
                rows.append(_EVENT.pack(0, kept, h, np.inf, steps, event.first, len(value)))
            values.append(value)
            variances.append(event.variance if isinstance(event, Measured) else value)
        return self._run(rows, np.concatenate(values), np.concatenate(variances))

    def _run(self, rows: list[bytes], values: Array, variances: Array) -> tuple[int, bool, list[float]]:
        """Let events happen that are packed as C reads them."""
        moved, nis = ctypes.c_int(), np.zeros(len(rows))
        addresses = values.ctypes.data, variances.ctypes.data, nis.ctypes.data, ctypes.addressof(moved)
        done = self._repeat(self._address, len(rows), b"".join(rows), *addresses)
        return done, bool(moved.value), nis[: done + moved.value].tolist()


def _system_structure(dense: Dense, kernels: _Kernels, whitened: Array, factor: Array) -> _System:
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
    made = _System(
        transition=kernels.transition.entry(),
        retract=Entry() if dense.system.is_flat else kernels.retract.entry(),
        size=dense.memory.size,
        numbers=dense.mean.size,
        added=len(functions.place),
        **{name: array.ctypes.data for name, array in arrays.items()},
    )
    made.kept = arrays  # type: ignore[attr-defined]
    return made


def _sensor_structure(sense: _Sense) -> _Sensor:
    found, by_error, used = (result.reshape(-1, order="F") for result in sense.kernel.results)
    arrays = {"value": sense.value, "variance": sense.variance, "residual": found, "by_error": by_error, "used": used}
    addresses = {name: array.ctypes.data for name, array in arrays.items()}
    made = _Sensor(sense=sense.kernel.entry(), components=sense.components, **addresses)
    made.kept = arrays  # type: ignore[attr-defined]
    return made


def _compiled(dense: Dense, kernels: _Kernels) -> DenseOperations | None:
    """The operations of ekf.c, or None if the functions or these are not compiled."""
    every = [kernels.transition, kernels.retract, *(sense.kernel for sense in kernels.sense.values())]
    if any(kernel.entry() is None for kernel in every):
        return None
    library = _library(kernels.functions.errors)
    return None if library is None else DenseOperations(library, dense, kernels)


def _library(errors: int) -> ctypes.CDLL | None:
    folder = resources.files("vsense_ros.estimation")
    source = "".join((folder / name).read_text(encoding="utf-8") for name in ("algebra.c", "ekf.c"))
    built = codegen.library("ekf", f"#define STATES {errors}\n{source}")
    return None if built is None else _loaded(built)


@lru_cache
def _loaded(path: Path) -> ctypes.CDLL:
    library, integer = ctypes.CDLL(str(path)), ctypes.c_int
    library.vsense_predict.argtypes = [_ADDRESS, _NUMBER]
    library.vsense_correct.argtypes = [_ADDRESS, _ADDRESS, _NUMBER, _NUMBER]
    library.vsense_correct.restype = _NUMBER
    library.vsense_advance.argtypes = [_ADDRESS, _ADDRESS, _COUNT, _NUMBER]
    library.vsense_repeat.argtypes = [_ADDRESS, integer, ctypes.c_char_p, *[_ADDRESS] * 4]
    return library
