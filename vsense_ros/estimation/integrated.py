"""A state space of differential equations: a Runge-Kutta rule makes steps of rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace, expression


class Rates(Protocol):
    """What gives time derivatives, and outputs that are measured: a model of a car, that knows no filter."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]

    def rates(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Time derivatives of the states, (n,)."""

    def measured(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Outputs, (m,)."""


class Integrated(StateSpace):
    """Steps by the rule of third order of Ralston (1962), with three evaluations of the rates.

    Euler's rule, which papers print, is not good enough where a state follows another with a lag of a few steps: a tyre
    of 30 ms at steps of 10 ms. The midpoint rule of second order is nearly, but its frequencies are wrong by (ω h)²/6:
    roll stiffness and height of the centre of gravity were identified 1 % too small.

    `densities`: of each state by name, the standard deviation [unit/√s] that disturbances add; 0 where none is given.
    `input_noise`: of inputs by name, the standard deviation in each step, which acts on the states through the
    equations.
    """

    def __init__(
        self, model: Rates, densities: Mapping[str, float], input_noise: Mapping[str, float] | None = None
    ) -> None:
        if unknown := sorted(set(densities) - set(model.states)):
            raise InputError(f"{type(model).__name__} has no state {unknown[0]!r}; it has: {', '.join(model.states)}")
        self.model = model
        self.names, self.inputs, self.parameters = model.states, model.inputs, model.parameters
        self.input_noise = {name: deviation**2 for name, deviation in (input_noise or {}).items()}
        self.density = np.square([densities.get(name, 0.0) for name in model.states])

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """State (n,) after a step of `h` [s]."""

        def rates(at: ca.SX) -> ca.SX:
            return expression(list(self.model.rates(Named(at, self.names, "state"), u, theta)))

        k1 = rates(x.vector)
        k2 = rates(x.vector + h / 2 * k1)
        k3 = rates(x.vector + 3 * h / 4 * k2)
        return x.vector + h / 9 * (2 * k1 + 3 * k2 + 4 * k3)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """Variances (n,) that a step adds, or with noise of inputs the covariance (n, n)."""
        if not self.input_noise:
            return ca.SX(self.density) * h
        return ca.diag(ca.SX(self.density) * h) + self.noise_of_inputs(x, u, theta, h, self.input_noise)

    def measurement(self, deviations: Sequence[float], name: str = "outputs") -> Measurement:
        """The model's outputs, measured together with these standard deviations (m,)."""
        return Measurement(name, lambda x, z, u, p: list(self.model.measured(x, u, p)), tuple(deviations))
