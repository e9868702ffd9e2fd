"""What both parameter filters share: the algebra by which physical parameters are estimated beside the errorEKF.

The joint filter of state x and parameters θ is split in two (Friedland 1969; with drifting parameters Hsieh & Chen
1999): one filter of the state for known parameters, which is the errorEKF as it stands, and one of the parameters.
They are coupled by S = ∂x/∂θ (n×k), how different the estimated state would be had the parameters been different:

    predict   S ← F S + G                      G: what the parameters do to the accelerations, over the step
    correct   T = H S + D                      … and to the innovation r; D: directly, through the accelerations
              S ← S - K T
              M ← (M⁻¹ + Tᵀ C⁻¹ T)⁻¹,  Δθ = M Tᵀ C⁻¹ r
              x ← x + S Δθ

P, C = H P Hᵀ + R and K are the errorEKF's; M (k×k) is the covariance of the parameters, and P + S M Sᵀ that of the
state. In a linear system this is the joint Kalman filter, and the errorEKF needs to know nothing of it.

The errorEKF's gain is K = P Hᵀ R⁻¹ with its corrected P, so that K T costs no more than a product of P and a few
columns. C = L Lᵀ and L⁻¹ r are what its correction found: R⁻¹ - R⁻¹ H P Hᵀ R⁻¹, which is C⁻¹ too, loses four digits at
the start, where P is large. The parameters' spread is described by columns D (k×p) with D Dᵀ = M, and that of a
measurement by columns Y (m×p) that belong to them; the update with G = (L⁻¹ Y)ᵀ (L⁻¹ Y), M ← D (I + G)⁻¹ Dᵀ, is the
square of a matrix and so stays positive definite whatever the rounding.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.model.car.car import Car
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES, ROAD
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.state import DISTURB, DYNAMIC, FOLLOWED, FORCE, FORM, GAIN_COLUMNS, ROAD_STATES, Q, U

Array = NDArray[np.float64]


class ParameterFilter(ABC):
    """The functions of a parameter filter for a car, `columns` of its parameter vector, and a state of `size`.

    EKF and UKF differ in how they find what the parameters do: `effect` and `spread`. Both take the errorEKF's
    linearisation and its state as `arguments`.
    """

    def __init__(self, car: Car, columns: Sequence[int], size: int) -> None:
        self.car, self.columns, self.size = car, tuple(columns), size
        self.count = len(self.columns)
        self.state = [car.q, car.u, car.force, car.disturbances, car.inputs, car.p]
        self.udot = ca.SX.sym("udot", COORDINATES)
        self.by_q = ca.SX.sym("by_q", COORDINATES, len(DYNAMIC))
        self.by_u = ca.SX.sym("by_u", COORDINATES, COORDINATES)
        self.by_disturbances = ca.SX.sym("by_disturbances", COORDINATES, len(DISTURBANCES))
        self.sensitivity = ca.SX.sym("S", size, self.count)
        self.covariance = ca.SX.sym("M", self.count, self.count)
        self.others = ca.SX.sym("others", COORDINATES, self.elsewhere)

    @property
    def arguments(self) -> list[ca.SX]:
        """State, accelerations and their Jacobians, S, M, the memory of the effects, and accelerations of the cars that
        act elsewhere if there are any."""
        model = [self.udot, self.by_q, self.by_u, self.by_disturbances]
        of_other_cars = [self.others] if self.elsewhere else []
        return [*self.state, *model, self.sensitivity, self.covariance, self.car.internal_state, *of_other_cars]

    @property
    def elsewhere(self) -> int:
        """Number of cars with other parameters whose accelerations are given to the functions, not found by them."""
        return 0

    @property
    @abstractmethod
    def width(self) -> int:
        """Number of columns p that describe a spread."""

    @property
    def displacement(self) -> float:
        """How many times Y's first column the mean of the measurement lies away from what the errorEKF expects."""
        return 0.0

    @abstractmethod
    def effect(self) -> ca.Function:
        """(arguments) → what the parameters do to the accelerations while the state stays (14×k)."""

    @abstractmethod
    def spread(self, sensor: SensorBase, biases: slice) -> ca.Function:
        """(arguments, effect, biases, mounting, Jacobians of the sensor by q, u, udot, disturbances, and of its
        components by their own biases) → Y (m×p), D (k×p)."""

    def through(self, arguments: Sequence[ca.MX], dynamic: ca.MX, u: ca.MX, around: ca.MX, direct: ca.MX) -> ca.MX:
        """What errors of dynamic coordinates, velocities and disturbances do to the accelerations (14×k), beside what
        changes them directly; by the linearisation in `arguments`."""
        by_q, by_u, by_disturbances = arguments[7:10]
        return product(by_q, dynamic, product(by_u, u, product(by_disturbances, around, direct)))

    def predict(self) -> ca.Function:
        """(S, M, effect, drift, gain, by_angles, by_velocity, by_road, road_map, h, decay) → S, M, and columns (n×k)
        whose square is added to the covariance of the state.

        `gain` (14×42, transposed), `by_angles`, `by_velocity`, `by_road`, `road_map` (5×10, transposed) and `decay` are
        those of the errorEKF's step. Where the parameters drift (variances `drift` (k) in one second) S loses what M
        gains, and leaves it to the state: S ← S̄ M M₊⁻¹, P ← P + S̄ (M - M M₊⁻¹ M) S̄ᵀ with M₊ = M + Q (Hsieh & Chen
        1999).
        """
        s, m = (_like(symbol) for symbol in (self.sensitivity, self.covariance))
        effect, drift = ca.MX.sym("effect", COORDINATES, self.count), ca.MX.sym("drift", self.count)
        transposed = ca.MX.sym("gain", len(GAIN_COLUMNS), COORDINATES)
        by = by_angles, by_velocity, by_road = [
            ca.MX.sym(name, 6, size) for name, size in (("by_angles", 3), ("by_velocity", 6), ("by_road", 4))
        ]
        road_map = ca.MX.sym("road_map", len(FOLLOWED), ROAD.stop)
        h, decay = ca.MX.sym("h"), ca.MX.sym("decay", self.size - U.stop)
        velocities = product(self._driving()(s, effect), transposed)
        turned, twist, form, followed = self._following()(s, velocities)
        body = product(by_angles, turned, product(by_velocity, twist, product(by_road, form)))
        road = product(followed, road_map)
        moved, grown, retained, root = self._moved()(s, m, drift, velocities, body, road, h, decay)
        return codegen.function(
            "parameters_predict",
            [s, m, effect, drift, transposed, *by, road_map, h, decay],
            [product(moved, retained), grown, product(moved, root)],
            ("S", "M", "effect", "drift", "gain", "by_angles", "by_velocity", "by_road", "road_map", "h", "decay"),
        )

    def _driving(self) -> ca.Function:
        """(S, effect) → errors that those of the velocities depend on after a step (k×42)."""
        effect = ca.SX.sym("effect", COORDINATES, self.count)
        errors = self.sensitivity[GAIN_COLUMNS.tolist(), :]
        errors[len(DYNAMIC) + COORDINATES : len(DYNAMIC) + 2 * COORDINATES, :] += effect
        return function("driving", [self.sensitivity, effect], [errors.T])

    def _following(self) -> ca.Function:
        """(S, errors of the velocities after a step (k×14)) → errors of the attitude (3×k), of the body's velocities
        (6×k) and of the road's form (4×k), and the last two together (k×10)."""
        velocities = ca.SX.sym("velocities", self.count, COORDINATES)
        turned, twist, form = self.sensitivity[3:6, :], velocities[:, :6].T, self.sensitivity[FORM, :]
        results = [turned, twist, form, ca.vertcat(twist, form).T]
        return function("following", [self.sensitivity, velocities], results)

    def _moved(self) -> ca.Function:
        """(S, M, drift, errors of the velocities (k×14), of the pose's rates (6×k) and of the road (k×5), h, decay) → S
        before parameters drift, M, what remains of S, transposed (k×k), and columns of what the state gets (k×k)."""
        n, k = self.size, self.count
        s, m = self.sensitivity, self.covariance
        velocities, body = ca.SX.sym("velocities", k, COORDINATES), ca.SX.sym("body", 6, k)
        road, drift = ca.SX.sym("road", k, ROAD.stop), ca.SX.sym("drift", k)
        h, decay = ca.SX.sym("h"), ca.SX.sym("decay", n - U.stop)
        coordinates = s[Q, :] + h * ca.vertcat(body, velocities[:, 6:].T)
        slow = ca.repmat(decay, 1, k) * s[U.stop :, :]
        surface = road.T
        surface[-1, :] += s[ROAD_STATES.stop - 1, :]
        road_rows = slice(ROAD_STATES.start - U.stop, ROAD_STATES.stop - U.stop)
        slow[road_rows, :] = ca.repmat(decay[road_rows], 1, k) * surface
        grown = m + h * ca.diag(drift)
        retained = _solve(grown, m)
        lost = m - m @ retained
        results = [ca.vertcat(coordinates, velocities.T, slow), grown, retained.T, _root((lost + lost.T) / 2)]
        return function("moved", [s, m, drift, velocities, body, road, h, decay], results)

    def seen(self, name: str, sensor: SensorBase, biases: slice) -> ca.Function:
        """(arguments, effect, biases, mounting, variance, L⁻¹ r, L transposed, Jacobians of the sensor) → Yᵀ R⁻¹ H
        (p×n), Yᵀ C⁻¹ Y (p×p), Yᵀ C⁻¹ r (p), D (k×p); components of L⁻¹ r that are NaN are left out."""
        m = len(sensor.deviations())
        arguments = [_like(a) for a in self.arguments]
        effect, bias, mounting, variance, whitened, factor, *by = (ca.MX.sym(name, *shape) for name, shape in (
            ("effect", (COORDINATES, self.count)), ("biases", (len(sensor.biases()), 1)),
            ("mounting", (len(sensor.mounting()), 1)), ("variance", (m, 1)), ("whitened", (m, 1)), ("factor", (m, m)),
            *((f"by_{i}", (m, columns)) for i, columns in enumerate((COORDINATES,) * 3 + (len(DISTURBANCES), 1))),
        ))  # fmt: skip
        y, d = self.spread(sensor, biases)(*arguments, effect, bias, mounting, *by)
        weighted, *weighed = self._weighed(m)(variance, whitened, factor, y)
        by_q, by_u, by_disturbances = (product(weighted, by[i]) for i in (0, 1, 3))
        if sensor.uses_acceleration:
            forces = product(weighted, by[2])
            dynamic = product(forces, arguments[7])
            by_u, by_disturbances = product(forces, arguments[8], by_u), product(forces, arguments[9], by_disturbances)
        else:
            forces, dynamic = (ca.MX.zeros(self.width, columns) for columns in (COORDINATES, len(DYNAMIC)))
        across = self._across(m, biases)(by_q, by_u, by_disturbances, forces, dynamic, weighted, by[4])
        inputs = [*arguments, effect, bias, mounting, variance, whitened, factor, *by]
        return codegen.function(name, inputs, [across, *weighed, d], numbered(len(inputs)))

    def _weighed(self, m: int) -> ca.Function:
        """(variance (m), L⁻¹ r, L transposed, Y) → Yᵀ R⁻¹ (p×m), Yᵀ C⁻¹ Y, Yᵀ C⁻¹ r."""
        p = self.width
        variance, whitened = (ca.SX.sym(s, m) for s in ("variance", "whitened"))
        transposed, y = ca.SX.sym("factor", m, m), ca.SX.sym("Y", m, p)
        present = ca.fabs(whitened) < np.inf  # false for NaN
        weighted = ca.repmat(ca.if_else(present, 1 / variance, 0), 1, p) * y
        columns = ca.solve(ca.tril(transposed.T), ca.repmat(ca.if_else(present, 1, 0), 1, p) * y)
        innovation = ca.if_else(present, whitened, 0)
        results = [weighted.T, columns.T @ columns, columns.T @ innovation]
        return function("weighed", [variance, whitened, transposed, y], results)

    def _across(self, m: int, biases: slice) -> ca.Function:
        """(Yᵀ R⁻¹ times what a measurement changes by with coordinates, velocities, disturbances, accelerations, and
        through these with dynamic coordinates; Yᵀ R⁻¹; derivatives by biases) → Yᵀ R⁻¹ H (p×n)."""
        p = self.width
        sizes = (COORDINATES, COORDINATES, len(DISTURBANCES), COORDINATES, len(DYNAMIC), m)
        parts = [ca.SX.sym("part", p, columns) for columns in sizes]
        by_q, by_u, by_disturbances, forces, dynamic, weighted = parts
        by_biases = ca.SX.sym("by_biases", m)
        v = ca.SX.zeros(p, self.size)
        v[:, Q], v[:, U], v[:, FORCE], v[:, DISTURB] = by_q, by_u, forces, by_disturbances
        v[:, DYNAMIC.tolist()] += dynamic
        if biases.stop > biases.start:
            v[:, biases] = ca.repmat(by_biases.T, p, 1) * weighted
        return function("across", [*parts, by_biases], [v])

    def learn(self) -> ca.Function:
        """(arguments, effect, Yᵀ R⁻¹ H times P, Yᵀ C⁻¹ Y, Yᵀ C⁻¹ r, D, information, θ, bounds) → θ, M, S, information,
        and the changes of the state (n) and of the accelerations (14).

        P is the covariance that the errorEKF has corrected. `information` (k×k) is the sum of Tᵀ C⁻¹ T, what the
        measurements so far determine of the parameters whatever state and forces were.
        """
        n, k, p = self.size, self.count, self.width
        arguments = [_like(a) for a in self.arguments]
        shapes = ((COORDINATES, k), (p, n), (p, p), (p, 1), (k, p), (k, k), (k, 1), (k, 1), (k, 1))
        inputs = [ca.MX.sym("a", *shape) for shape in shapes]
        effect, pv, *innovation_terms = inputs
        sensitivity, covariance = arguments[10:12]
        new, corrected, regression, information, difference = self._corrected()(covariance, *innovation_terms)
        moved, change, *errors = self._changed()(sensitivity, product(regression, pv), effect, difference)
        udot = self.through(arguments, *errors)
        results = [new, corrected, moved, information, change, udot]
        return codegen.function("parameters_learn", [*arguments, *inputs], results, numbered(len(arguments) + 9))

    def _corrected(self) -> ca.Function:
        """(M, Yᵀ C⁻¹ Y, Yᵀ C⁻¹ r, D, information, θ, bounds) → θ, M, minus the transpose of what Y times is T (k×p),
        information, change of θ."""
        k, p, m = self.count, self.width, self.covariance
        g, right, d = ca.SX.sym("G", p, p), ca.SX.sym("g", p), ca.SX.sym("D", k, p)
        information = ca.SX.sym("J", k, k)
        theta, lower, upper = ca.SX.sym("theta", k), ca.SX.sym("lower", k), ca.SX.sym("upper", k)
        displaced = right + self.displacement * g[:, 0]
        factor = ca.chol(ca.SX.eye(p) + g)  # upper triangular R with Rᵀ R
        half = ca.solve(factor.T, d.T)
        new = theta + half.T @ ca.solve(factor.T, displaced)
        new = ca.fmin(ca.fmax(new, lower), upper)
        regression = _solve(m, d).T
        results = [new, half.T @ half, -regression.T, information + regression.T @ g @ regression, new - theta]
        return function("corrected", [m, g, right, d, information, theta, lower, upper], results)

    def _changed(self) -> ca.Function:
        """(S, change of its transpose (k×n), effect, change of θ) → S, change of the state, and of it what changes the
        accelerations, as `through` takes it."""
        k = self.count
        less, effect = ca.SX.sym("less", k, self.size), ca.SX.sym("effect", COORDINATES, k)
        difference = ca.SX.sym("difference", k)
        moved = self.sensitivity + less.T
        change = moved @ difference
        direct = change[FORCE] + effect @ difference
        results = [moved, change, change[DYNAMIC.tolist()], change[U], change[DISTURB], direct]
        return function("changed", [self.sensitivity, less, effect, difference], results)


def product(left: ca.MX, right: ca.MX, begin: ca.MX | None = None) -> ca.MX:
    """begin + left right, which stays a product for who writes or runs it."""
    return ca.mac(left, right, ca.MX.zeros(left.shape[0], right.shape[1]) if begin is None else begin)


def function(name: str, arguments: Sequence[ca.SX], results: Sequence[ca.SX]) -> ca.Function:
    """A function of scalars between products."""
    return codegen.function(name, arguments, results, numbered(len(arguments)))


def _like(symbol: ca.SX) -> ca.MX:
    return ca.MX.sym(symbol.name() if symbol.is_scalar() else "a", *symbol.shape)


def numbered(count: int) -> tuple[str, ...]:
    """Names of that many arguments."""
    return tuple(f"i{i}" for i in range(count))


def _solve(a: ca.SX, b: ca.SX) -> ca.SX:
    """a⁻¹ b with a positive definite."""
    factor = ca.chol(a)
    return ca.solve(factor, ca.solve(factor.T, b))


def _root(a: ca.SX) -> ca.SX:
    """Lower triangular L with L Lᵀ = a, positive semidefinite; columns are zero where nothing is left of a."""
    size = a.shape[0]
    factor = ca.SX.zeros(size, size)
    for j in range(size):
        pivot = a[j, j] - ca.sumsqr(factor[j, :j])
        some = pivot > 0
        inverse = ca.if_else(some, 1 / ca.sqrt(ca.if_else(some, pivot, 1)), 0)
        for i in range(j, size):
            factor[i, j] = (a[i, j] - ca.dot(factor[i, :j], factor[j, :j])) * inverse
    return factor
