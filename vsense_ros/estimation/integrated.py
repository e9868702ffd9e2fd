"""A state space of differential equations: the midpoint rule makes steps of rates."""

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
    """x⁺ = x + h f(x + h/2 f(x, u), u), second order in h.

    Euler's rule, which papers print, is not good enough where a state follows another with a lag of a few steps: a tyre
    of 30 ms at steps of 10 ms. `densities`: of each state by name, the standard deviation [unit/√s] that disturbances
    add; 0 where none is given.
    """

    def __init__(self, model: Rates, densities: Mapping[str, float]) -> None:
        if unknown := sorted(set(densities) - set(model.states)):
            raise InputError(f"{type(model).__name__} has no state {unknown[0]!r}; it has: {', '.join(model.states)}")
        self.model = model
        self.names, self.inputs, self.parameters = model.states, model.inputs, model.parameters
        self.density = np.square([densities.get(name, 0.0) for name in model.states])

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """State (n,) after a step of `h` [s]."""
        first = expression(list(self.model.rates(x, u, theta)))
        middle = Named(x.vector + h / 2 * first, self.names, "state")
        return x.vector + h * expression(list(self.model.rates(middle, u, theta)))

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """Variances (n,) that a step adds."""
        return ca.SX(self.density) * h

    def measurement(self, deviations: Sequence[float], name: str = "outputs") -> Measurement:
        """The model's outputs, measured together with these standard deviations (m,)."""
        return Measurement(name, lambda x, z, u, p: list(self.model.measured(x, u, p)), tuple(deviations))
