"""The unscented Kalman filter (Julier & Uhlmann 1997; Wan & van der Merwe 2000 for alpha and beta).

Points around the mean go through the equations themselves, no Jacobian is made: exact to second order where the
extended filter is to first, at 2 e + 1 evaluations in place of one. With ⊞ and ⊟ the points lie about a mean that need
not be of a vector space (Hertzberg et al. 2013, table 3): attitudes and headings are no exception.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Entry, Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import UNLIMITED, laid_out
from vsense_ros.estimation.filter import Array, Course, Followed, Gaussian, Given, Innovation, Measured, Step
from vsense_ros.estimation.gaussian import COMPONENTS, GaussianFilter, check_variances, whiten
from vsense_ros.estimation.operations import ADDRESS, Operations, library
from vsense_ros.estimation.state_space import (
    Measurement,
    StateSpace,
    Symbols,
    by_name,
    parameter_values,
    title,
)

_TURN = 2 * np.pi
_ROUNDS = 20  # at most, of the search for the mean of points that are no vectors


class Ukf(GaussianFilter):
    """Filter of a state space. `alpha`, `beta` and `kappa` place and weigh the points: λ = α² (e + κ) - e.

    With the defaults the point in the middle has no weight and all others the same, and a covariance stays positive
    definite; κ = 3 - e makes fourth moments of a normal distribution right, with a negative weight for e > 3.
    """

    def __init__(
        self,
        system: StateSpace,
        measurements: Sequence[Measurement],
        parameters: Mapping[str, float] | Sequence[float] | Array = (),
        *,
        alpha: float = 1.0,
        beta: float = 0.0,
        kappa: float = 0.0,
        memory: Array | None = None,
    ) -> None:
        self.system, self.measurements = system, by_name(measurements, COMPONENTS)
        self.names, self.sensors = system.names, tuple(self.measurements)
        values = parameter_values(system, parameters)
        self.memory, self.mean, self.covariance, self.inputs, self.parameters, _ = laid_out(system, memory)
        self.parameters[:] = values
        self.alpha, self.beta, self.kappa = alpha, beta, kappa
        e = len(self.covariance)
        if not alpha > 0 or not e + kappa > 0:
            raise InputError(f"alpha and e + kappa must be positive, but are {alpha} and {e} + {kappa}")
        around = alpha**2 * (e + kappa)
        self._reach = np.sqrt(around)
        self._weights = np.array([around - e, *[0.5] * (2 * e)]) / around
        self._weights_of_squares = self._weights.copy()
        self._weights_of_squares[0] += 1 - alpha**2 + beta
        self._largest = np.array([system.largest.get(name, UNLIMITED) for name in self.names])
        self._points = _Points(self)
        self._operations = self._points.operations()

    def at(self, memory: Array) -> Ukf:
        """This filter with its memory in another array (s,)."""
        memory[:] = self.memory
        weights = {"alpha": self.alpha, "beta": self.beta, "kappa": self.kappa}
        sensors = tuple(self.measurements.values())
        return Ukf(self.system, sensors, self.parameters.copy(), **weights, memory=memory)

    def start(self, belief: Gaussian) -> None:
        """As `GaussianFilter.start`; inputs that the system needs must be there before."""
        super().start(belief)
        moved = self._points.moved(self._spread(), 1e-3)
        if not np.isfinite(moved).all():
            raise InputError(f"{title(self.system)}: after a step the state is not finite, at {belief.mean}")

    def predict(self, h: float) -> None:
        """Go on by `h` [s]. Raises `FloatingPointError` where the state would not be finite."""
        if self._operations is not None:
            self._operations.predict(h)
            return
        moved = self._points.moved(self._spread(), h)
        if not np.isfinite(moved).all():
            raise FloatingPointError(f"{title(self.system)} cannot be moved by {h} s: its state would not be finite")
        noise = self._points.noise(h)
        mean, apart = self._mean(moved)
        grown = (apart.T * self._weights_of_squares) @ apart + noise
        self.mean[:] = mean
        self.covariance[:] = 0.5 * (grown + grown.T)

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """As `Filter.correct`. A covariance that has lost positive definiteness is reported, and reset."""
        measurement = self._measurement(sensor, value, variance)
        if self._operations is not None:
            nis, m = self._operations.correct(sensor, value, variance, limit, scale), len(value)
            if nis != nis:
                self.recover(sensor)
            whitened, factor = self._operations.whitened[:m], self._operations.factor[: m * m].reshape(m, m)
            return Innovation(whitened, factor, nis, 0.0 <= nis <= limit)
        try:
            points = self._spread()
        except FloatingPointError:
            self.recover(sensor)
            return _nothing(len(value))
        expected, apart = self._expected(measurement, points)
        by_square = apart.T * self._weights_of_squares
        correction = whiten(
            _wrapped(np.asarray(value, dtype=float) - expected, measurement),
            scale * (by_square @ apart + np.diag(variance)),
            by_square @ points,
        )
        if 0.0 <= correction.nis <= limit:
            self.covariance -= correction.projected.T @ correction.projected
            self.mean[:] = self._points.retracted(correction.error[None])[0]
        elif correction.nis != correction.nis:
            self.recover(sensor)
        factor = np.zeros((len(value), len(value)))
        correction.write(correction.whitened, factor.reshape(-1))
        return Innovation(correction.whitened, factor, correction.nis, 0.0 <= correction.nis <= limit)

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`, in one call where the system is compiled."""
        return super().advance(step) if self._operations is None else self._operations.advance(step)

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """As `Filter.repeat`, in one call where the system is compiled."""
        return super().repeat(events) if self._operations is None else self._operations.repeat(events)

    def follow(self, course: Course, every: int = 0) -> Followed:
        """As `Filter.follow`, in one call where the system is compiled."""
        if self._operations is None:
            return super().follow(course, every)
        return self._operations.follow(course, self.memory.size, every)

    def is_valid(self) -> bool:
        """True if the mean is finite and within its bounds, and no variance below zero."""
        return bool((np.abs(self.mean) < self._largest).all() and (self.covariance.diagonal() >= 0).all())

    def _measurement(self, sensor: str, value: Array, variance: Array) -> Measurement:
        """Raises `InputError` for a sensor that is not known, or a value that is not one of its."""
        measurement = self.measurements.get(sensor)
        if measurement is None:
            raise InputError(f"the filter has no sensor {sensor!r}; it has: {', '.join(self.sensors) or 'none'}")
        m = len(measurement.deviations)
        if len(value) != m:
            raise InputError(f"a measurement of {sensor!r} has {m} components, but got {len(value)}")
        check_variances(sensor, value, variance)
        return measurement

    def _spread(self) -> Array:
        """Errors (2 e + 1, e) of the points about the mean."""
        try:
            root = self._reach * np.linalg.cholesky(self.covariance).T
        except np.linalg.LinAlgError:
            root = self._reach * _root_of_semidefinite(self.covariance).T
        return np.concatenate([np.zeros((1, len(root))), root, -root])

    def _mean(self, points: Array) -> tuple[Array, Array]:
        """Mean (n,) of points (2 e + 1, n), and their errors (2 e + 1, e) from it."""
        if self.system.is_flat:
            mean = self._weights @ points
            return mean, points - mean
        mean = points[0]
        for _ in range(_ROUNDS):
            apart = self._points.difference(points, mean)
            by = self._weights @ apart
            if np.abs(by).max() < 1e-14:
                break
            mean = self._points.retracted(by[None], mean)[0]
        return mean, self._points.difference(points, mean)

    def _expected(self, measurement: Measurement, points: Array) -> tuple[Array, Array]:
        """What a sensor should measure (m,), NaN where it is not used, and how the points differ (2 e + 1, m)."""
        values, used = self._points.sensed(measurement.name, points)
        if not used:
            return np.full(values.shape[1], np.nan), np.zeros_like(values)
        apart = _wrapped(values - values[0], measurement)
        by = self._weights @ apart
        return values[0] + by, _wrapped(apart - by, measurement)


def _wrapped(difference: Array, measurement: Measurement) -> Array:
    """Differences (…, m), those of angles in [-π, π)."""
    for i in measurement.angles:
        difference[..., i] -= _TURN * np.floor((difference[..., i] + np.pi) / _TURN)
    return difference


def _nothing(m: int) -> Innovation:
    """The innovation where the covariance has no root: no numbers, and nothing accepted."""
    return Innovation(np.full(m, np.nan), np.full((m, m), np.nan), np.nan, False)


def _root_of_semidefinite(covariance: Array) -> Array:
    """R with R Rᵀ = P, of a covariance that may have directions without variance."""
    if not np.isfinite(covariance).all():
        raise FloatingPointError("the covariance is not finite")
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < -1e-9 * max(values[-1], 1e-300):
        raise FloatingPointError("the covariance is not positive definite")
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


class _Points:
    """The functions of a state space, each for all points by one call."""

    def __init__(self, ukf: Ukf) -> None:
        functions = self._functions = point_functions(ukf.system, tuple(ukf.measurements.values()))
        e, self._ukf = len(ukf.covariance), ukf
        count = 2 * e + 1
        shape = {"x": len(ukf.mean), "u": len(ukf.inputs), "p": len(ukf.parameters), "h": 1, "d": e, "y": len(ukf.mean)}
        self._at = {name: np.zeros((count, size)) for name, size in shape.items()}
        self._kernels = {name: self._bound(function, count) for name, function in functions.items() if name != "noise"}
        self._h = np.zeros(1)
        self._noise = Kernel(functions["noise"], [ukf.mean, ukf.inputs, ukf.parameters, self._h])

    def _bound(self, function: ca.Function, count: int) -> Kernel:
        arguments = [self._at[function.name_in(i)].reshape(-1) for i in range(function.n_in())]
        return Kernel(function.map(count), arguments)

    def operations(self) -> Operations | None:
        """The filter in C, of a state that is a vector; None for another, or without a compiler."""
        ukf = self._ukf
        if not ukf.system.is_flat:
            return None
        point, h = np.zeros(len(ukf.mean)), np.zeros(1)
        at = [point, ukf.inputs, ukf.parameters]
        move = Kernel(self._functions["move"], [*at, h])
        noise = Kernel(self._functions["noise"], [*at, h])
        expect = {name: Kernel(self._functions[f"sensor {name}"], at) for name in ukf.sensors}
        if any(kernel.entry() is None for kernel in (move, noise, *expect.values())):
            return None
        compiled = library("ukf", len(point), "estimation/innovation.c", "estimation/ukf.c")
        if compiled is None:
            return None
        whitened, factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)
        live = _live(ukf, (move, noise), point, h, (whitened, factor))
        sensors = {
            name: (_sensor(kernel, ukf.measurements[name]), len(ukf.measurements[name].deviations))
            for name, kernel in expect.items()
        }
        impossible = f"{title(ukf.system)} cannot be moved: its state would not be finite, or its covariance is not one"
        return Operations(compiled, live, sensors, h, (whitened, factor), impossible)

    def _place(self, errors: Array) -> None:
        """Put the points that are these errors away from the mean where the functions look for them."""
        at, ukf = self._at, self._ukf
        at["x"][:] = self.retracted(errors)
        at["u"][:], at["p"][:] = ukf.inputs, ukf.parameters

    def retracted(self, errors: Array, mean: Array | None = None) -> Array:
        """mean ⊞ each of some errors (c, e), (c, n)."""
        mean = self._ukf.mean if mean is None else mean
        if self._ukf.system.is_flat:
            return mean + errors
        c = len(errors)
        self._at["x"][:c], self._at["d"][:c] = mean, errors
        self._kernels["retract"].call()
        return self._kernels["retract"].results[0].T[:c].copy()

    def difference(self, points: Array, mean: Array) -> Array:
        """Each of some points (c, n) ⊟ mean, (c, e)."""
        self._at["y"][:], self._at["x"][:] = points, mean
        self._kernels["difference"].call()
        return self._kernels["difference"].results[0].T.copy()

    def moved(self, errors: Array, h: float) -> Array:
        """States (2 e + 1, n) after a step of `h` [s]."""
        self._place(errors)
        self._at["h"][:] = h
        self._kernels["move"].call()
        return self._kernels["move"].results[0].T.copy()

    def noise(self, h: float) -> Array:
        """Covariance (e, e) that a step from the mean adds."""
        self._h[0] = h
        self._noise.call()
        return self._noise.results[0]

    def sensed(self, sensor: str, errors: Array) -> tuple[Array, bool]:
        """What a sensor should measure at each point (2 e + 1, m), and whether it is used at the mean."""
        self._place(errors)
        kernel = self._kernels[f"sensor {sensor}"]
        kernel.call()
        return kernel.results[0].T.copy(), bool(kernel.results[1][0, 0] != 0)


class _Live(ctypes.Structure):
    """`struct live` of ukf.c."""

    _fields_ = [
        *((name, Entry) for name in ("move", "noise")),
        ("size", ctypes.c_longlong),
        *((n, ADDRESS) for n in ("memory", "mean", "covariance", "inputs", "h", "point", "whitened", "factor")),
        *((name, ADDRESS) for name in ("moved", "q", "largest")),
        ("reach", ctypes.c_double),
        *((name, ctypes.c_double * 2) for name in ("weights", "squares")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of ukf.c."""

    _fields_ = [
        *(("expect", Entry), ("components", ctypes.c_longlong)),
        *((name, ADDRESS) for name in ("expected", "used", "angles")),
    ]


def _live(ukf: Ukf, kernels: tuple[Kernel, Kernel], point: Array, h: Array, innovation: tuple[Array, Array]) -> _Live:
    move, noise = kernels
    arrays = {
        **{name: getattr(ukf, name) for name in ("memory", "mean", "covariance", "inputs")},
        "h": h,
        "point": point,
        "whitened": innovation[0],
        "factor": innovation[1],
        "largest": ukf._largest,
        "moved": _flat(move.results[0]),
        "q": _flat(noise.results[0]),
    }
    pairs = ((ctypes.c_double * 2)(*w[:2]) for w in (ukf._weights, ukf._weights_of_squares))
    made = _Live(
        move=move.entry(),
        noise=noise.entry(),
        size=ukf.memory.size,
        reach=ukf._reach,
        **{name: array.ctypes.data for name, array in arrays.items()},
        **dict(zip(("weights", "squares"), pairs, strict=True)),
    )
    made.kept = (arrays, kernels)  # type: ignore[attr-defined]
    return made


def _sensor(expect: Kernel, measurement: Measurement) -> _Sensor:
    expected, used = (_flat(result) for result in expect.results)
    angles = np.array([float(i in measurement.angles) for i in range(len(expected))])
    arrays = {"expected": expected, "used": used, "angles": angles}
    addresses = {name: array.ctypes.data for name, array in arrays.items()}
    made = _Sensor(expect=expect.entry(), components=len(expected), **addresses)
    made.kept = (arrays, expect)  # type: ignore[attr-defined]
    return made


def _flat(result: Array) -> Array:
    """A kernel's result as the memory that it stands in."""
    return result.reshape(-1, order="F")


def point_functions(system: StateSpace, measurements: Sequence[Measurement]) -> dict[str, ca.Function]:
    """Step, noise, ⊞, ⊟ and what each sensor should measure, without Jacobians, compiled together."""
    at = Symbols(system)
    delta, y = ca.SX.sym("delta", len(system.error_names)), ca.SX.sym("y", len(system.names))
    made = {
        "move": codegen.function("move", [*at.now, at.h], [at.moved()], ("x", "u", "p", "h")),
        "noise": codegen.function("noise", [*at.now, at.h], [at.noise()], ("x", "u", "p", "h")),
        "retract": codegen.function("retract", [at.x.vector, delta], [at.retracted(delta)], ("x", "d")),
        "difference": codegen.function("difference", [y, at.x.vector], [at.difference(y)], ("y", "x")),
    }
    for i, one in enumerate(measurements):
        made[f"sensor {one.name}"] = codegen.function(f"expect_{i}", at.now, list(at.measured(one)), ("x", "u", "p"))
    return dict(zip(made, codegen.compiled(f"points_{title(system)}", list(made.values())), strict=True))
