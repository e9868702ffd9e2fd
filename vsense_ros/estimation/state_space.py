"""What a filter needs to know of a system, as CasADi expressions.

    x⁺ = f(x, u, θ, h) ⊞ w,  w ~ N(0, Q(x, u, θ, h))    transition, noise
    z  = g(x, u, θ)                                      auxiliary: accelerations, say, that several sensors refer to
    y  = h(x, z, u, θ) + v,  v ~ N(0, R)                 measurement

n states, e elements of their error, k inputs, p parameters, a auxiliary quantities, m components of a measurement. The
error δ of a state is such that x ⊞ δ is the true one, and y ⊟ x is the error that leads from x to y (Hertzberg, Wagner,
Frese & Schröder 2013): of a vector space they are + and -, of an attitude they are a rotation and its angles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Measured, largest_nis


class Named:
    """The elements of a symbolic vector by name: `x.yaw`, as a paper writes them. `vector` is all of it."""

    def __init__(self, vector: ca.SX, names: Sequence[str], what: str = "name") -> None:
        self.vector, self._what = vector, what
        self._place = {name: i for i, name in enumerate(names)}

    def __getattr__(self, name: str) -> ca.SX:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._place:
            raise InputError(f"there is no {self._what} {name!r}; there are: {', '.join(self._place) or 'none'}")
        return self.vector[self._place[name]]

    def __getitem__(self, name: str) -> ca.SX:
        return getattr(self, name)


class StateSpace(ABC):
    """A system. A subclass names its states and says how they change; the rest has defaults.

    Its methods are called once, with symbols, when a filter is built; what they return may be a CasADi expression, an
    array, or a list of scalars.
    """

    names: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    auxiliaries: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()  # elements of the error, (e,): the names, unless ⊞ is not +
    largest: Mapping[str, float] = {}  # amounts beyond which a state is impossible, by name

    @abstractmethod
    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """State (n,) after a step of `h` [s]."""

    @abstractmethod
    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """What `h` [s] add to the covariance of the error: variances (e,), or a matrix (e, e)."""

    def noise_of_inputs(self, x: Named, u: Named, theta: Named, h: ca.SX, variances: Mapping[str, Any]) -> ca.SX:
        """G diag(variances) Gᵀ (e, e), with G = ∂x⁺/∂u, for `noise`: what inputs with these variances, by name, add."""
        moved = expression(self.transition(x, u, theta, h))
        by_input = ca.jacobian(moved, ca.vertcat(*(u[name] for name in variances)))
        if not self.is_flat:
            by_input = Symbols(self).inward(moved) @ by_input
        return by_input @ ca.diag(expression(list(variances.values()))) @ by_input.T

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        """Quantities (a,) that measurements refer to."""
        return []

    def retract(self, x: Named, delta: ca.SX) -> Any:
        """State (n,) that is `delta` (e,) away: x ⊞ δ."""
        return x.vector + delta

    def difference(self, y: Named, x: Named) -> Any:
        """Error (e,) that leads from `x` to `y`: y ⊟ x, so that x ⊞ (y ⊟ x) = y."""
        return y.vector - x.vector

    def seen(self, x: Named, theta: Named) -> tuple[Named, Named]:
        """State and parameters as the equations of measurements know them."""
        return x, theta

    @property
    def error_names(self) -> tuple[str, ...]:
        """Names of the elements of the error, (e,)."""
        return self.errors or self.names

    @property
    def is_flat(self) -> bool:
        """True if ⊞ is +."""
        return type(self).retract is StateSpace.retract and type(self).difference is StateSpace.difference


@dataclass(frozen=True)
class Measurement:
    """One sensor.

    `equation(x, z, u, theta)` is what it should measure (m,), `deviations` (m,) its usual standard deviations. The
    innovations of those components that are `angles` [rad] are wrapped to [-π, π). It is used where the number
    `when(x, u, theta)` is not zero. `gate`: the largest innovation believed, in standard deviations of one component.
    """

    name: str
    equation: Callable[[Named, Named, Named, Named], Any]
    deviations: tuple[float, ...]
    angles: tuple[int, ...] = ()
    gate: float = np.inf
    when: Callable[[Named, Named, Named], Any] | None = None

    @property
    def variances(self) -> Array:
        """(m,)"""
        return np.square(self.deviations)

    @property
    def limit(self) -> float:
        """The largest normalized innovation squared that is believed: gate² √m, as wide for many components as for one
        in units of what is usual."""
        return largest_nis(self.gate, len(self.deviations))

    def measured(self, value: Sequence[float] | Array, variances: Array | None = None) -> Measured:
        """A value (m,) of this sensor, as a filter takes it: `filter.correct(*sensor.measured(value))`."""
        values = np.asarray(value, dtype=float)
        return Measured(self.name, values, self.variances if variances is None else variances, self.limit)


class Symbols:
    """Symbols of a state space: state, inputs, parameters by name, and the length `h` of a step."""

    def __init__(self, system: StateSpace) -> None:
        check_names(system)
        self.system = system
        self.x = Named(ca.SX.sym("x", len(system.names)), system.names, "state")
        self.u = Named(ca.SX.sym("u", len(system.inputs)), system.inputs, "input")
        self.theta = Named(ca.SX.sym("theta", len(system.parameters)), system.parameters, "parameter")
        self.h = ca.SX.sym("h")

    @property
    def now(self) -> list[ca.SX]:
        """Arguments of most functions: state, inputs, parameters."""
        return [self.x.vector, self.u.vector, self.theta.vector]

    def moved(self) -> ca.SX:
        """State after a step, (n,)."""
        moved = expression(self.system.transition(self.x, self.u, self.theta, self.h))
        return shaped(moved, (len(self.system.names), 1), f"the transition of {title(self.system)}")

    def noise(self) -> ca.SX:
        """Covariance that a step adds, (e, e)."""
        e, system = len(self.system.error_names), self.system
        noise = expression(system.noise(self.x, self.u, self.theta, self.h))
        if noise.shape == (e, 1):
            return ca.sparsify(ca.diag(noise))
        what = f"the noise of {title(system)}, where variances are not {e} numbers in one column,"
        return ca.sparsify(shaped(noise, (e, e), what))

    def measured(self, measurement: Measurement) -> tuple[ca.SX, ca.SX]:
        """What a sensor should measure (m,), and a number that is not zero where it is used."""
        system = self.system
        x, theta = system.seen(self.x, self.theta)
        z = expression(system.auxiliary(self.x, self.u, self.theta))
        z = shaped(z, (len(system.auxiliaries), 1), f"what is auxiliary in {title(system)}")
        named = Named(z, system.auxiliaries, "auxiliary quantity")
        measured = expression(measurement.equation(x, named, self.u, theta))
        what = f"the measurement {measurement.name!r} of {title(system)}, which has as many deviations,"
        measured = shaped(measured, (len(measurement.deviations), 1), what)
        used = ca.SX(1) if measurement.when is None else expression(measurement.when(x, self.u, theta))
        return measured, shaped(used, (1, 1), f"the condition of the measurement {measurement.name!r}")

    def retracted(self, delta: ca.SX) -> ca.SX:
        """x ⊞ δ, (n,)."""
        moved = expression(self.system.retract(self.x, delta))
        return shaped(moved, (len(self.system.names), 1), f"⊞ of {title(self.system)}")

    def difference(self, y: ca.SX) -> ca.SX:
        """y ⊟ x, (e,)."""
        error = expression(self.system.difference(Named(y, self.system.names, "state"), self.x))
        return shaped(error, (len(self.system.error_names), 1), f"⊟ of {title(self.system)}")

    def outward(self) -> ca.SX:
        """∂(x ⊞ δ)/∂δ at δ = 0, (n, e): from a derivative by the state to one by its error."""
        delta = ca.SX.sym("delta", len(self.system.error_names))
        return ca.substitute(ca.jacobian(self.retracted(delta), delta), delta, ca.DM.zeros(delta.shape))

    def inward(self, at: ca.SX) -> ca.SX:
        """∂(y ⊟ x)/∂y at y = x = `at` (n,), (e, n): from the change of a state to that of its error."""
        y = ca.SX.sym("y", len(self.system.names))
        return ca.substitute(ca.substitute(ca.jacobian(self.difference(y), y), y, self.x.vector), self.x.vector, at)

    def by_error(self, term: ca.SX) -> ca.SX:
        """Derivative of an expression by the error of the state."""
        by_state = ca.jacobian(term, self.x.vector)
        return by_state if self.system.is_flat else by_state @ self.outward()

    def transition_matrix(self, moved: ca.SX) -> ca.SX:
        """F (e, e): the error after a step by the error before it."""
        if self.system.is_flat:
            return ca.sparsify(self.by_error(moved))
        return ca.sparsify(self.inward(moved) @ self.by_error(moved))


def wrapped(angle: ca.SX) -> ca.SX:
    """An angle [rad] less whole turns, in [-π, π); one that is there already stays as it is, to the last bit."""
    return angle - 2 * np.pi * ca.floor((angle + np.pi) / (2 * np.pi))


def residual(value: ca.SX, expected: ca.SX, angles: Sequence[int]) -> ca.SX:
    """Innovation (m,): value less expectation, angles wrapped."""
    difference = value - expected
    return ca.vertcat(*(wrapped(difference[i]) if i in angles else difference[i] for i in range(difference.numel())))


def expression(given: Any) -> ca.SX:
    """What an equation returned, as one expression: a list of scalars is a column."""
    if isinstance(given, (list, tuple)):
        return ca.vertcat(ca.SX(0, 1), *given)
    return ca.SX(given)


def shaped(term: ca.SX, shape: tuple[int, int], what: str) -> ca.SX:
    """The expression, if it has this shape. Raises `InputError`."""
    if term.shape != shape:
        raise InputError(f"{what} must be {_in_words(shape)}, but is {_in_words(term.shape)}")
    return term


def _in_words(shape: tuple[int, int]) -> str:
    return f"{shape[0]} numbers in a column" if shape[1] == 1 else f"{shape[0]} × {shape[1]} numbers"


def title(system: StateSpace) -> str:
    """What to call a state space in a message."""
    return type(system).__name__


def check_names(system: StateSpace) -> None:
    """Raises `InputError` if a name stands for two things of one kind, or there is no state."""
    kinds = {"state": system.names, "input": system.inputs, "parameter": system.parameters}
    for kind, names in kinds.items():
        for name in names:
            if tuple(names).count(name) > 1:
                raise InputError(f"{title(system)} has two {kind}s called {name!r}")
    if not system.names:
        raise InputError(f"{title(system)} has no states")
    if unknown := set(system.largest) - set(system.names):
        raise InputError(f"{title(system)} limits {sorted(unknown)[0]!r}, which is none of its states")


def parameter_values(system: StateSpace, values: Mapping[str, float] | Sequence[float] | Array) -> Array:
    """Parameters (p,) in the order of the state space, from values by name or in that order. Raises `InputError`."""
    names = system.parameters
    if isinstance(values, Mapping):
        if missing := [name for name in names if name not in values]:
            raise InputError(f"{title(system)} needs the parameter {missing[0]!r}, which is not given")
        if unknown := [name for name in values if name not in names]:
            raise InputError(f"{title(system)} has no parameter {unknown[0]!r}; it has: {', '.join(names) or 'none'}")
        values = [values[name] for name in names]
    parameters = np.array(values, dtype=float)
    if parameters.shape != (len(names),):
        raise InputError(f"{title(system)} has {len(names)} parameters ({', '.join(names)}), but got {parameters.size}")
    return parameters


def by_name(measurements: Sequence[Measurement], components: int) -> dict[str, Measurement]:
    """Measurements by their names. Raises `InputError` for two of one name, and for more than `components` numbers."""
    known: dict[str, Measurement] = {}
    for one in measurements:
        if one.name in known:
            raise InputError(f"there are two measurements called {one.name!r}")
        m = len(one.deviations)
        if not 1 <= m <= components:
            raise InputError(f"the measurement {one.name!r} has {m} components; possible are 1 to {components}")
        if not all(0 <= i < m for i in one.angles):
            raise InputError(f"the angles of the measurement {one.name!r} must be among its components 0 to {m - 1}")
        known[one.name] = one
    return known
