"""The errorEKF whose car moves by the implicit trapezoidal rule with Newton's method, as that of Rodríguez 2020.

`CarBlocks` moves in a linearly implicit step without iterations. Here a step solves

    u₁ = u₀ + h/2 (f₀ + f₁),   q₁ = q₀ + h/2 (q̇₀ + q̇₁)

with one matrix a step, M (I - h/2 ∂f/∂u - h²/4 ∂f/∂q N), whose systems have 14 unknowns and may be solved elsewhere: on
an accelerator in binary32. That changes how many iterations there are, not where they end.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import Car, kinematics
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.state import DISTURB, FORCE, Prior, Q, U

Array = NDArray[np.float64]
Solve = Callable[[Array, Array], Array]

TOLERANCE = 1e-5  # of the change of the velocities in the last iteration, his finest [m/s, rad/s]
MOST = 20  # iterations, after which the step is made without them


def in_double(matrix: Array, right: Array) -> Array:
    """Solution of a linear system in double precision."""
    return np.asarray(np.linalg.solve(matrix, right))


class ImplicitCar(CarBlocks):
    """As `CarBlocks`; `solve(matrix, right)` solves the systems of the iteration, `at(time)` is told the seconds since
    the start before each step, for what keeps time. `steps`, `iterations` and `given_up` count."""

    in_blocks = False

    def __init__(
        self,
        vehicle: Vehicle,
        sensors: dict[str, SensorBase],
        *,
        extra: int = 0,
        prior: Prior | None = None,
        solve: Solve = in_double,
        at: Callable[[float], None] | None = None,
        tolerance: float = TOLERANCE,
    ) -> None:
        super().__init__(vehicle, sensors, extra=extra, prior=prior)
        self.solve, self.tolerance = solve, tolerance
        self._at = at or (lambda _: None)
        self.steps = self.iterations = self.given_up = 0
        self._elapsed = 0.0
        q, u = np.zeros(COORDINATES), np.zeros(COORDINATES)
        self._moved_q, self._moved_u = q, u
        around = [self.mean[FORCE], self.mean[DISTURB], self.inputs, self.parameters, self.effects]
        rate, mass = codegen.compiled("implicit", [_rate_function(), _mass_function(self.car)])
        self._here = Kernel(self.functions["dynamics"], self.arguments)
        self._there = Kernel(self.functions["dynamics"], [q, u, *around])
        self._rate_here = Kernel(rate, [self.mean[Q], self.mean[U], self.mean[DISTURB]])
        self._rate_there = Kernel(rate, [q, u, self.mean[DISTURB]])
        self._mass = Kernel(mass, [self.mean[Q], *around[1:]])

    def step(self, h: float) -> None:
        process = self.process(h)
        self.move_effects(h)
        self.respond(h)
        self.kinematics.call()
        self._elapsed += h
        self._at(self._elapsed)
        moved = self._iterated(h)
        if moved is None:
            self.given_up += 1
            self.advanced.call()
            moved = self.advanced.results[0][:, 0], self.advanced.results[1][:, 0]
        noise = self.map_road(h, process)
        self.propagate(self.transition(h, process.decay), noise)
        self.move(*moved, h, process)
        self.linearize()

    def _iterated(self, h: float) -> tuple[Array, Array] | None:
        """Coordinates and velocities after the step; None where the iteration does not end."""
        self._here.call()
        self._rate_here.call()
        self._mass.call()
        q0, u0 = self.mean[Q].copy(), self.mean[U].copy()
        f0, rate0 = self._here.results[0][:, 0].copy(), self._rate_here.results[0][:, 0].copy()
        mass = self._mass.results[0]
        matrix = mass @ (np.eye(COORDINATES) - h / 2 * self.by_u - h * h / 4 * self.by_q_rates)
        q, u = self._moved_q, self._moved_u
        u[:], q[:] = u0 + h * f0, q0 + h * rate0
        self.steps += 1
        for _ in range(MOST):
            self._there.call()
            self._rate_there.call()
            q[:] = q0 + h / 2 * (rate0 + self._rate_there.results[0][:, 0])
            missing = u0 + h / 2 * (f0 + self._there.results[0][:, 0]) - u
            change = self.solve(matrix, mass @ missing)
            u += change
            self.iterations += 1
            size = float(np.linalg.norm(change))
            if not np.isfinite(size):
                return None
            if size < self.tolerance:
                self._rate_there.call()
                q[:] = q0 + h / 2 * (rate0 + self._rate_there.results[0][:, 0])
                return q.copy(), u.copy()
        return None


def implicit_error_ekf(
    solve: Solve = in_double, at: Callable[[float], None] | None = None, tolerance: float = TOLERANCE
) -> Callable[..., CarFilter]:
    """What makes such a filter of a vehicle, as `observer.catalogue.MakeFilter`."""

    def make(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        return ErrorEkf(ImplicitCar(vehicle, sensors, prior=prior, solve=solve, at=at, tolerance=tolerance))

    return make


def _rate_function() -> ca.Function:
    """(q, u, disturbances) → derivatives of q (14)."""
    q, u = ca.SX.sym("q", COORDINATES), ca.SX.sym("u", COORDINATES)
    disturbances = ca.SX.sym("disturbances", len(DISTURBANCES))
    return codegen.function("rate", [q, u, disturbances], [kinematics(q, u, disturbances)], ["q", "u", "disturbances"])


def _mass_function(car: Car) -> ca.Function:
    """(q, disturbances, inputs, p, internal_state) → mass matrix (14×14)."""
    acceleration = ca.SX.sym("acceleration", COORDINATES)
    matrix = ca.jacobian(car.inertia_times(acceleration), acceleration)
    arguments = [car.q, car.disturbances, car.inputs, car.p, car.internal_state]
    return codegen.function("mass", arguments, [matrix], ["q", "disturbances", "inputs", "p", "internal_state"])
