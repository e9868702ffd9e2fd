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
        others = [self.others] if self.elsewhere else []
        return [*self.state, *model, self.sensitivity, self.covariance, self.car.internal_state, *others]

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

    def through(self, by: ca.SX) -> ca.SX:
        """What errors of the state (n×k) do to the accelerations (14×k)."""
        return (
            self.by_q @ by[DYNAMIC.tolist(), :]
            + self.by_u @ by[U, :]
            + by[FORCE, :]
            + self.by_disturbances @ by[DISTURB, :]
        )

    def predict(self) -> ca.Function:
        """(S, M, effect, drift, gain, by_angles, by_velocity, by_road, road_map, h, decay) → S, M, and columns (n×k)
        whose square is added to the covariance of the state.

        `gain` (14×42, transposed), `by_angles`, `by_velocity`, `by_road`, `road_map` (5×10, transposed) and `decay` are
        those of the errorEKF's step. Where the parameters drift (variances `drift` (k) in one second) S loses what M
        gains, and leaves it to the state: S ← S̄ M M₊⁻¹, P ← P + S̄ (M - M M₊⁻¹ M) S̄ᵀ with M₊ = M + Q (Hsieh & Chen
        1999).
        """
        n, k = self.size, self.count
        s, m = self.sensitivity, self.covariance
        effect, drift = ca.SX.sym("effect", COORDINATES, k), ca.SX.sym("drift", k)
        transposed = ca.SX.sym("gain", len(GAIN_COLUMNS), COORDINATES)
        by = by_angles, by_velocity, by_road = [
            ca.SX.sym(name, 6, size) for name, size in (("by_angles", 3), ("by_velocity", 6), ("by_road", 4))
        ]
        road_map = ca.SX.sym("road_map", len(FOLLOWED), ROAD.stop)
        h, decay = ca.SX.sym("h"), ca.SX.sym("decay", n - U.stop)
        forces = slice(len(DYNAMIC) + COORDINATES, len(DYNAMIC) + 2 * COORDINATES)
        velocities = transposed.T @ s[GAIN_COLUMNS.tolist(), :] + transposed[forces, :].T @ effect
        body = by_angles @ s[3:6, :] + by_velocity @ velocities[:6, :] + by_road @ s[FORM, :]
        coordinates = s[Q, :] + h * ca.vertcat(body, velocities[6:, :])
        slow = ca.repmat(decay, 1, k) * s[U.stop :, :]
        road = road_map.T @ ca.vertcat(velocities[:6, :], s[FORM, :])
        road[-1, :] += s[ROAD_STATES.stop - 1, :]
        here = slice(ROAD_STATES.start - U.stop, ROAD_STATES.stop - U.stop)
        slow[here, :] = ca.repmat(decay[here], 1, k) * road
        moved = ca.vertcat(coordinates, velocities, slow)
        grown = m + h * ca.diag(drift)
        kept = _solve(grown, m)
        lost = m - m @ kept
        return codegen.function(
            "parameters_predict",
            [s, m, effect, drift, transposed, *by, road_map, h, decay],
            [moved @ kept.T, grown, moved @ _root((lost + lost.T) / 2)],
            ("S", "M", "effect", "drift", "gain", "by_angles", "by_velocity", "by_road", "road_map", "h", "decay"),
        )

    def seen(self, name: str, sensor: SensorBase, biases: slice) -> ca.Function:
        """(arguments, effect, biases, mounting, variance, L⁻¹ r, L transposed, Jacobians of the sensor) → Yᵀ R⁻¹ H
        (p×n), Yᵀ C⁻¹ Y (p×p), Yᵀ C⁻¹ r (p), D (k×p); components of L⁻¹ r that are NaN are left out."""
        m, p = len(sensor.deviations()), self.width
        variance, whitened = (ca.SX.sym(s, m) for s in ("variance", "whitened"))
        transposed = ca.SX.sym("factor", m, m)
        sizes = {"by_q": 14, "by_u": 14, "by_udot": 14, "by_disturbances": len(DISTURBANCES), "by_biases": 1}
        by = [ca.SX.sym(name, m, columns) for name, columns in sizes.items()]
        y = ca.SX.sym("Y", m, p)
        present = ca.fabs(whitened) < np.inf  # false for NaN
        weighted = ca.repmat(ca.if_else(present, 1 / variance, 0), 1, p) * y
        columns = ca.solve(ca.tril(transposed.T), ca.repmat(ca.if_else(present, 1, 0), 1, p) * y)
        innovation = ca.if_else(present, whitened, 0)
        v = ca.SX.zeros(self.size, p)
        v[Q, :], v[U, :], v[DISTURB, :] = by[0].T @ weighted, by[1].T @ weighted, by[3].T @ weighted
        if sensor.uses_acceleration:
            accelerations = by[2].T @ weighted
            v[DYNAMIC.tolist(), :] += self.by_q.T @ accelerations
            v[U, :] += self.by_u.T @ accelerations
            v[FORCE, :] = accelerations
            v[DISTURB, :] += self.by_disturbances.T @ accelerations
        if biases.stop > biases.start:
            v[biases, :] = ca.repmat(by[4], 1, p) * weighted
        model = [self.by_q, self.by_u, self.by_disturbances]
        weigh = ca.Function(
            "weigh",
            [*model, variance, whitened, transposed, *by, y],
            [v.T, columns.T @ columns, columns.T @ innovation],
        )
        arguments = [_like(a) for a in self.arguments]
        effect, bias, mounting = (ca.MX.sym("", *shape) for shape in (
            (COORDINATES, self.count), (len(sensor.biases()), 1), (len(sensor.mounting()), 1),
        ))  # fmt: skip
        measured = [_like(a) for a in (variance, whitened, transposed)]
        sensed = [_like(a) for a in by]
        spread, d = self.spread(sensor, biases)(*arguments, effect, bias, mounting, *sensed)
        found = weigh(*arguments[7:10], *measured, *sensed, spread)
        return codegen.function(
            name, [*arguments, effect, bias, mounting, *measured, *sensed], [*found, d], numbered(len(arguments) + 11)
        )

    def learn(self) -> ca.Function:
        """(arguments, effect, Yᵀ R⁻¹ H times P, Yᵀ C⁻¹ Y, Yᵀ C⁻¹ r, D, information, θ, bounds) → θ, M, S, information,
        and the changes of the state (n) and of the accelerations (14).

        P is the covariance that the errorEKF has corrected. `information` (k×k) is the sum of Tᵀ C⁻¹ T, what the
        measurements so far determine of the parameters whatever state and forces were.
        """
        n, k, p = self.size, self.count, self.width
        effect, pv = ca.SX.sym("effect", COORDINATES, k), ca.SX.sym("PV", p, n)
        g, right, d = ca.SX.sym("G", p, p), ca.SX.sym("g", p), ca.SX.sym("D", k, p)
        information = ca.SX.sym("J", k, k)
        theta, lower, upper = ca.SX.sym("theta", k), ca.SX.sym("lower", k), ca.SX.sym("upper", k)
        s, m = self.sensitivity, self.covariance
        displaced = right + self.displacement * g[:, 0]
        factor = ca.chol(ca.SX.eye(p) + g)  # upper triangular R with Rᵀ R
        half = ca.solve(factor.T, d.T)
        new = theta + half.T @ ca.solve(factor.T, displaced)
        new = ca.fmin(ca.fmax(new, lower), upper)
        regression = _solve(m, d).T  # Y times this is T
        moved = s - pv.T @ regression
        change = moved @ (new - theta)
        udot = self.through(change) + effect @ (new - theta)
        return codegen.function(
            "parameters_learn",
            [*self.arguments, effect, pv, g, right, d, information, theta, lower, upper],
            [new, half.T @ half, moved, information + regression.T @ g @ regression, change, udot],
            numbered(len(self.arguments) + 9),
        )


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
