"""A state space whose state is continued by parameters: any filter of it identifies these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.state_space import Named, StateSpace, Symbols, expression, title


class Augmented(StateSpace):
    """z = [x; θ] with ż = [f(x, θ); 0] (Best & Bogdanski 2016, eq. 5).

    `drifts` are the parameters that are identified, each with the standard deviation [unit of the parameter/√s] by
    which it drifts: 0 for a constant. The rest remain parameters. Measurements of the system are measurements of this.
    """

    def __init__(self, system: StateSpace, drifts: Mapping[str, float]) -> None:
        if unknown := [name for name in drifts if name not in system.parameters]:
            raise InputError(
                f"{title(system)} has no parameter {unknown[0]!r} to identify; it has: "
                f"{', '.join(system.parameters) or 'none'}"
            )
        if clash := set(drifts) & set(system.names):
            raise InputError(f"{title(system)} has a state and a parameter called {min(clash)!r}")
        self.system, self.identified = system, tuple(drifts)
        self.density = np.square(list(drifts.values()))
        self.names = system.names + self.identified
        self.errors = system.error_names + self.identified
        self.inputs, self.auxiliaries, self.largest = system.inputs, system.auxiliaries, system.largest
        self.parameters = tuple(name for name in system.parameters if name not in drifts)

    @property
    def is_flat(self) -> bool:
        """True if ⊞ is +."""
        return self.system.is_flat

    def seen(self, x: Named, theta: Named) -> tuple[Named, Named]:
        """State and parameters as measurements of the system know them."""
        return self.system.seen(*self._split(x, theta))

    def _split(self, x: Named, theta: Named) -> tuple[Named, Named]:
        """State and parameters as the system itself knows them."""
        state = Named(x.vector[: len(self.system.names)], self.system.names, "state")
        values = [x[p] if p in self.identified else theta[p] for p in self.system.parameters]
        return state, Named(expression(values), self.system.parameters, "parameter")

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """As the system's; parameters stay."""
        state, every = self._split(x, theta)
        moved = expression(self.system.transition(state, u, every, h))
        return ca.vertcat(moved, x.vector[len(self.system.names) :])

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        """As the system's."""
        state, every = self._split(x, theta)
        return self.system.auxiliary(state, u, every)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        """The system's, and the drift of the parameters."""
        state, every = self._split(x, theta)
        at = Symbols(self.system)
        old = [at.x.vector, at.u.vector, at.theta.vector, at.h]
        own = ca.substitute([at.noise()], old, [state.vector, u.vector, every.vector, h])[0]
        return ca.diagcat(own, ca.diag(ca.SX(self.density) * h))

    def retract(self, x: Named, delta: ca.SX) -> Any:
        """The system's, and + for the parameters."""
        n, e = len(self.system.names), len(self.system.error_names)
        state = Named(x.vector[:n], self.system.names, "state")
        return ca.vertcat(expression(self.system.retract(state, delta[:e])), x.vector[n:] + delta[e:])

    def difference(self, y: Named, x: Named) -> Any:
        """The system's, and - for the parameters."""
        n, names = len(self.system.names), self.system.names
        to, of = Named(y.vector[:n], names, "state"), Named(x.vector[:n], names, "state")
        return ca.vertcat(expression(self.system.difference(to, of)), y.vector[n:] - x.vector[n:])
