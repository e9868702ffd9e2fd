"""Time steps of one mechanism with given parameters, by compiled functions of `augmented_lagrangian`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.multibody.augmented_lagrangian import STEP, Equations
from vsense_ros.model.multibody.mechanism import Mechanism

Array = NDArray[np.float64]

MOST_CALLS = 12  # of the iterating function before a step is given up


@dataclass
class State:
    """State of a mechanism: coordinates, rates, accelerations (N) and multipliers (m)."""

    z: Array
    dz: Array
    ddz: Array
    multipliers: Array

    def take(self, other: State) -> None:
        """Takes the values of another state, in place."""
        for present, value in ((self.z, other.z), (self.dz, other.dz), (self.ddz, other.ddz)):
            np.copyto(present, value)
        np.copyto(self.multipliers, other.multipliers)

    def copy(self) -> State:
        return State(self.z.copy(), self.dz.copy(), self.ddz.copy(), self.multipliers.copy())


class Integrator:
    """Steps of one mechanism with given parameters; nothing is allocated in a step.

    Write `guides` (g×3), `wrench` (6), `inputs` and `gravity` (3) in place for the *end* of the next step, then call
    `step()`. `state` holds the result. `tolerance` is the norm of the coordinates' change [m and rad] in the
    last iteration.
    """

    def __init__(
        self, mechanism: Mechanism, parameters: Array, h: float, tolerance: float = 1e-9, name: str = "mechanism"
    ) -> None:
        self.mechanism = mechanism
        self.h, self.tolerance = np.array([h]), tolerance
        self.steps = self.calls = 0  # made, and of the iterating functions, for statistics
        equations = Equations(mechanism)
        functions = codegen.compiled(
            name,
            [
                *equations.step_functions(),
                equations.settle_function(),
                equations.dynamics_function(),
                equations.outputs_function(),
            ],
        )
        sizes = [functions[0].size_in(i) for i in range(9)]
        self.parameters = np.array(parameters, dtype=float)
        z, dz, ddz, multipliers = (np.zeros(size[0]) for size in sizes[:4])
        self.state = State(z, dz, ddz, multipliers)
        self._before = self.state.copy()
        self.guides = np.zeros(sizes[5], order="F")
        self.gravity = np.array([0.0, 0.0, -GRAVITY])
        self.wrench = np.zeros(6)
        self.inputs = np.zeros(sizes[8][0])
        arguments = [
            z, dz, ddz, multipliers, self.parameters, self.guides.reshape(-1, order="F"), self.gravity, self.wrench,
            self.inputs, self.h,
        ]  # fmt: skip
        self._step, self._advance, self._refine, self._project, self._settle, self._dynamics, self._outputs = (
            codegen.Kernel(function, arguments) for function in functions
        )

    def step(self) -> None:
        """One step of length `h`. Raises `InputError` where the iteration does not converge; the state stays then."""
        kernel = self._step
        kernel.call()
        self.steps += 1
        self.calls += 1
        if kernel.results[4].item() < self.tolerance:
            self._take(kernel.results)
            return
        self._before.take(self.state)
        self._advance.call()
        self._take(self._advance.results)
        for _ in range(MOST_CALLS):
            self._refine.call()
            self.calls += 1
            self._take(self._refine.results)
            if self._refine.results[4].item() < self.tolerance:
                break
        else:
            self.state.take(self._before)
            raise InputError(
                f"a step of {self.h[0]:g} s does not converge: coordinates still change by "
                f"{self._refine.results[4].item():.2g} after {MOST_CALLS * STEP.corrections} iterations (allowed "
                f"{self.tolerance:g}); use a shorter step, or check masses, stiffnesses and forces"
            )
        self._project.call()
        np.copyto(self.state.dz, self._project.results[0].reshape(-1))
        np.copyto(self.state.ddz, self._project.results[1].reshape(-1))

    @property
    def iterations(self) -> float:
        """Mean number of iterations of a step so far."""
        return STEP.corrections * self.calls / max(self.steps, 1)

    def _take(self, results: list[Array]) -> None:
        state = self.state
        for target, result in zip((state.z, state.dz, state.ddz, state.multipliers), results, strict=False):
            np.copyto(target, result.reshape(-1))

    def dynamics(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """At the present state: mass matrix, generalized forces, Φ, dΦ/dt, d²Φ/dt², Φ_z."""
        self._dynamics.call()
        mass, forces, *constraints, jacobian = self._dynamics.results
        return (mass, forces.reshape(-1), *(c.reshape(-1) for c in constraints), jacobian)  # type: ignore[return-value]

    def outputs(self) -> Array:
        """Outputs of the loads at the present state."""
        self._outputs.call()
        return self._outputs.results[0].reshape(-1)

    def settle(self) -> None:
        """Makes rates, accelerations and multipliers fit coordinates and guides; coordinates must be assembled."""
        self._settle.call()
        state = self.state
        for target, result in zip((state.dz, state.ddz, state.multipliers), self._settle.results, strict=False):
            np.copyto(target, result.reshape(-1))
