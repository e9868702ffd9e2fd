"""The model's time step on its own: linearize, invert, advance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import GAMMA, model_functions
from vsense_ros.model.coordinates import DISTURBANCES, INPUTS
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


class Stepper:
    """A car with its state in `q`, `u`; change `inputs`, `force`, `disturbances` in place."""

    def __init__(self, vehicle: Vehicle, q: Array | None = None, u: Array | None = None) -> None:
        self.q, self.u = np.zeros(14), np.zeros(14)
        self.q[2] = vehicle.physics.chassis.cog_height
        if q is not None:
            self.q[:] = q
        if u is not None:
            self.u[:] = u
        self.force, self.disturbances, self.inputs = np.zeros(14), np.zeros(len(DISTURBANCES)), np.zeros(len(INPUTS))
        self._h, self._inverse, self._by_q = np.zeros(1), np.zeros(196), np.zeros(98)
        functions = model_functions(car_of(vehicle))
        state = [self.q, self.u, self.force, self.disturbances, self.inputs]
        arguments = [*state, vehicle.parameter_vector(), np.zeros(0)]
        self._linearize = Kernel(functions["linearize"], arguments)
        self._dynamics = Kernel(functions["dynamics"], arguments)
        self._advance = Kernel(functions["advance"], [*arguments, self._h, self._inverse, self._by_q])

    def step(self, h: float, exact_jacobian: bool = True) -> None:
        """One step of `h` [s]; without Jacobian it is an explicit Runge-Kutta step."""
        self._h[0] = h
        inverse = np.eye(14)
        self._by_q[:] = 0
        if exact_jacobian:
            self._linearize.call()
            _, by_q, by_u, _, by_q_rates = self._linearize.results
            inverse = np.linalg.inv(np.eye(14) - GAMMA * h * (by_u + GAMMA * h * by_q_rates))
            self._by_q[:] = by_q.reshape(-1, order="F")
        self._inverse[:] = inverse.reshape(-1, order="F")
        self._advance.call()
        self.q[:], self.u[:] = self._advance.results[0][:, 0], self._advance.results[1][:, 0]

    def run(self, duration: float, h: float, control: Callable[[Stepper], None] | None = None) -> Stepper:
        for _ in range(round(duration / h)):
            if control is not None:
                control(self)
            self.step(h)
        return self

    @property
    def acceleration(self) -> Array:
        """Derivatives of `u`, (14,)."""
        self._dynamics.call()
        return self._dynamics.results[0][:, 0].copy()

    @property
    def wheels(self) -> Array:
        """Outputs of the wheels, (7, 4)."""
        self._dynamics.call()
        return self._dynamics.results[1].copy()
