"""errorEKF and SPI whose car moves by the implicit trapezoidal rule with Newton's method, as Rodríguez 2020.

`CarBlocks` moves in a linearly implicit step without iterations. Here a step solves

    u₁ = u₀ + h/2 (f₀ + f₁),   q₁ = q₀ + h/2 (q̇₀ + q̇₁)

with one matrix a step, M (I - h/2 ∂f/∂u - h²/4 ∂f/∂q N), whose systems have 14 unknowns and may be solved elsewhere: on
an accelerator in binary32. That changes how many iterations there are, not where they end. Suspension tables and the
inertias of the wheels may come from there, too (`offload`); these change where the iterations end, by their rounding.
The full car, whose own steps are implicit, may have its systems and the matrices of its bodies from there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.accelerator.client import Client
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.kinematics import kinematics
from vsense_ros.model.car.parts import CarInParts
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES
from vsense_ros.model.multibody.outside import Outside
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.catalogue import MakeFilter, extra_numbers, with_parameters
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.full_car_spi import FULL_CAR_FILTERS, FullCarSpi
from vsense_ros.observer.offload import PARTS, OffloadedParts, Parts, turned_by
from vsense_ros.observer.spi import FILTERS, Spi
from vsense_ros.observer.state import DISTURB, FORCE, Prior, Q, U

Array = NDArray[np.float64]
Solve = Callable[[Array, Array], Array]

SOLVER, FULL_KERNELS = "solve14", ("solve56", "body_mass")
TOLERANCE = 1e-5  # of the change of the velocities in the last iteration, his finest [m/s, rad/s]
MOST = 20  # iterations, after which the step is made without them


def in_double(matrix: Array, right: Array) -> Array:
    """Solution of a linear system in double precision."""
    return np.asarray(np.linalg.solve(matrix, right))


class ImplicitCar(CarBlocks):
    """As `CarBlocks`; `solve(matrix, right)` of `work` solves the systems of the iteration. `steps` and `iterations`
    count."""

    in_blocks = False

    def __init__(
        self,
        vehicle: Vehicle,
        sensors: dict[str, SensorBase],
        *,
        extra: int = 0,
        prior: Prior | None = None,
        work: Work | None = None,
    ) -> None:
        super().__init__(vehicle, sensors, extra=extra, prior=prior)
        work = work or Work()
        self.solve, self.tolerance, parts = work.solve, work.tolerance, work.parts
        self._at = work.at or (lambda _: None)
        self.steps = self.iterations = 0
        self._elapsed = 0.0
        q, u = np.zeros(COORDINATES), np.zeros(COORDINATES)
        self._moved_q, self._moved_u = q, u
        around = [self.mean[FORCE], self.mean[DISTURB], self.inputs, self.parameters, self.effects]
        rate, mass = codegen.compiled("implicit", [_rate_function(), _mass_function(self.car)])
        self._rate_at_begin = Kernel(rate, [self.mean[Q], self.mean[U], self.mean[DISTURB]])
        self._rate_at_end = Kernel(rate, [q, u, self.mean[DISTURB]])
        self._parts: tuple[OffloadedParts, ...] = ()
        if parts is None or not parts.names:
            self._at_begin = Kernel(self.functions["dynamics"], self.arguments)
            self._at_end = Kernel(self.functions["dynamics"], [q, u, *around])
            self._mass = Kernel(mass, [self.mean[Q], *around[1:]])
            return
        if vehicle.suspension is None:
            raise InputError(
                f"{vehicle.name}: an accelerator computes {', '.join(parts.names)} from tables of the suspensions, "
                "which the vehicle file lacks; make them with vsense suspension, or take the kernel solve14 alone"
            )
        in_parts = CarInParts(vehicle)
        dynamics, mass = codegen.compiled("car_in_parts", [in_parts.dynamics_function(), in_parts.mass_function()])
        at_begin, at_end = (
            OffloadedParts(in_parts, vehicle, parts, [*position, *around[1:]])
            for position in (self.arguments[:2], [q, u])
        )
        self._parts = at_begin, at_end
        self._at_begin = Kernel(dynamics, [*self.arguments, *at_begin.memory])
        self._at_end = Kernel(dynamics, [q, u, *around, *at_end.memory])
        self._mass = Kernel(mass, [self.mean[Q], *around[1:], *at_begin.memory])

    def step(self, h: float) -> None:
        process = self.process(h)
        self.move_effects(h)
        self.respond(h)
        self.kinematics.call()
        self._elapsed += h
        self._at(self._elapsed)
        moved = self._iterated(h)
        if moved is None:
            self.advanced.call()
            moved = self.advanced.results[0][:, 0], self.advanced.results[1][:, 0]
        noise = self.map_road(h, process)
        self.propagate(self.transition(h, process.decay), noise)
        self.share_torques(process.shared)
        self.move(*moved, h, process)
        self.linearize()

    def _iterated(self, h: float) -> tuple[Array, Array] | None:
        """Coordinates and velocities after the step; None where the iteration does not end."""
        for part in self._parts[:1]:
            part.update()
        self._at_begin.call()
        self._rate_at_begin.call()
        self._mass.call()
        q0, u0 = self.mean[Q].copy(), self.mean[U].copy()
        f0, rate0 = self._at_begin.results[0][:, 0].copy(), self._rate_at_begin.results[0][:, 0].copy()
        mass = self._mass.results[0]
        matrix = mass @ (np.eye(COORDINATES) - h / 2 * self.by_u - h * h / 4 * self.by_q_rates)
        q, u = self._moved_q, self._moved_u
        u[:], q[:] = u0 + h * f0, q0 + h * rate0
        self.steps += 1
        for _ in range(MOST):
            for part in self._parts[1:]:
                part.update()
            self._at_end.call()
            self._rate_at_end.call()
            q[:] = q0 + h / 2 * (rate0 + self._rate_at_end.results[0][:, 0])
            missing = u0 + h / 2 * (f0 + self._at_end.results[0][:, 0]) - u
            change = self.solve(matrix, mass @ missing)
            u += change
            self.iterations += 1
            size = float(np.linalg.norm(change))
            if not np.isfinite(size):
                return None
            if size < self.tolerance:
                self._rate_at_end.call()
                q[:] = q0 + h / 2 * (rate0 + self._rate_at_end.results[0][:, 0])
                return q.copy(), u.copy()
        return None


@dataclass(frozen=True)
class Work:
    """How the work of an implicit step is done: what solves its systems, what is given the seconds since the start
    before each step, when the iteration ends, and which parts of the car come from an accelerator."""

    solve: Solve = in_double
    at: Callable[[float], None] | None = None
    tolerance: float = TOLERANCE
    parts: Parts | None = None


def implicit_error_ekf(work: Work | None = None) -> MakeFilter:
    """The function that makes an errorEKF with implicit steps."""

    def make(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        return ErrorEkf(ImplicitCar(vehicle, sensors, prior=prior, work=work))

    return make


def implicit_spi(work: Work | None = None) -> MakeFilter:
    """The function that makes an SPI with implicit steps, of a vehicle that lists parameters."""

    def make(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        vehicle = with_parameters(vehicle)
        extra = extra_numbers(vehicle, sensors)
        car = ImplicitCar(vehicle, sensors, extra=extra, prior=prior, work=work)
        return Spi(car, FILTERS[vehicle.observer.parameter_filter])

    return make


def work_with(
    client: Client, kernels: Collection[str], at: Callable[[float], None] | None = None, tolerance: float = TOLERANCE
) -> Work:
    """An implicit step with these kernels by an accelerator. Raises `InputError` for those that there is no use for."""
    _refuse_others(kernels, (SOLVER, *PARTS))
    parts = tuple(name for name in kernels if name != SOLVER)
    solve = client.solve if SOLVER in kernels else in_double
    return Work(solve, at, tolerance, Parts(client, parts) if parts else None)


def outside_with(client: Client, kernels: Collection[str], at: Callable[[float], None] | None = None) -> Outside:
    """The observer's filter of a vehicle whose model is the full car."""
    _refuse_others(kernels, FULL_KERNELS)
    solve = client.solve if FULL_KERNELS[0] in kernels else in_double
    return Outside(solve, turned_by(client) if FULL_KERNELS[1] in kernels else None, at)


def _refuse_others(kernels: Collection[str], useful: Collection[str]) -> None:
    if unknown := [name for name in kernels if name not in useful]:
        raise InputError(
            f"this observer has no use for the kernel {', '.join(unknown)} of an accelerator; it has for "
            f"{', '.join(useful)}"
        )


ACCELERATED = ("error_ekf", "spi", "full_error_ekf", "full_spi")


def accelerated(
    name: str,
    client: Client,
    kernels: Collection[str],
    at: Callable[[float], None] | None = None,
    tolerance: float = TOLERANCE,
) -> MakeFilter:
    """What makes the filter of a name of `ACCELERATED`, with these kernels by an accelerator. `at` is given the seconds
    since the start before each step. Raises `InputError` for kernels that the filter has no use for."""
    if not name.startswith("full_"):
        work = work_with(client, kernels, at, tolerance)
        return implicit_error_ekf(work) if name == "error_ekf" else implicit_spi(work)
    outside = outside_with(client, kernels, at)

    def make(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        learns = name == "full_spi"
        vehicle = with_parameters(vehicle) if learns else vehicle
        extra = extra_numbers(vehicle, sensors) if learns else 0
        car = FullCarBlocks(vehicle, sensors, extra=extra, prior=prior, tolerance=tolerance, outside=outside)
        return FullCarSpi(car, FULL_CAR_FILTERS[vehicle.observer.parameter_filter]) if learns else ErrorEkf(car)

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
