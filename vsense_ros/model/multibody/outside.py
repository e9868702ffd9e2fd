"""Time steps of a mechanism whose systems are solved, and whose bodies' matrices are computed, outside: by an
accelerator.

The equations are those of `augmented_lagrangian`, with one dense system for all coordinates in place of elimination by
branches, as Rodríguez 2020 has it, and an iteration that ends as soon as the tolerance is met.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.model import spatial
from vsense_ros.model.multibody.augmented_lagrangian import STEP, Equations, StepOfLinkage
from vsense_ros.model.multibody.integrator import MOST_CALLS, Integrator
from vsense_ros.model.multibody.joints import column
from vsense_ros.model.multibody.mechanism import Linkage, Mechanism
from vsense_ros.model.multibody.semi_recursive import Motion

Array = NDArray[np.float64]
Solve = Callable[[Array, Array], Array]
Turn = Callable[[Array], Array]

TURNED = 9  # numbers that are computed for a body


def turned(bodies: Array) -> Array:
    """Matrices of bodies in turned axes, (k, 9): R J Rᵀ as xx xy xz yy yz zz and m R s, from bodies (k, 19) with R by
    rows, J as xx yy zz xy xz yz, s and m."""
    r, (xx, yy, zz, xy, xz, yz) = bodies[:, :9].reshape(-1, 3, 3), bodies[:, 9:15].T
    j = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    matrix = r @ j @ r.transpose(0, 2, 1)
    moment = bodies[:, 18:] * (r @ bodies[:, 15:18, None])[:, :, 0]
    return np.hstack([matrix[:, 0], matrix[:, 1, 1:], matrix[:, 2, 2:], moment])


@dataclass(frozen=True)
class Outside:
    """What is computed outside: solutions of systems, and the matrices of bodies, as `turned`; None: by the model. `at`
    is given the seconds since the start before each step."""

    solve: Solve
    turn: Turn | None = None
    at: Callable[[float], None] | None = None


@dataclass(frozen=True)
class _BranchOfParts:
    """A branch whose bodies' matrices are given."""

    evaluate: ca.Function
    tangent: ca.Function
    bodies: ca.Function


def _in_parts(linkage: Linkage) -> _BranchOfParts:
    """As `_branch`, with the results of `turned` for its bodies as one more argument (9×k); and what `turned` needs."""
    turned_inertias = ca.SX.sym("given", TURNED, len(linkage.bodies))
    bodies = []

    def inertias(motion: Motion) -> dict[str, ca.SX]:
        inertia_by_body = {}
        for i, body in enumerate(linkage.bodies):
            frame, mass, j = motion.frames[body.name], ca.SX(body.mass), body.inertia
            xx, xy, xz, yy, yz, zz = ca.vertsplit(turned_inertias[:6, i])
            matrix = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
            inertia_by_body[body.name] = spatial.rigid_inertia(
                mass, frame.origin + turned_inertias[6:, i] / mass, matrix
            )
            moments = [j[0, 0], j[1, 1], j[2, 2], j[0, 1], j[0, 2], j[1, 2]]
            bodies.append(ca.vertcat(ca.vec(frame.rotation.T), *moments, column(body.centre), mass))
        return inertia_by_body

    step = StepOfLinkage(linkage, inertias)
    arguments, names = [*step.arguments, turned_inertias], [*step.NAMES, "given"]
    return _BranchOfParts(
        codegen.function(f"evaluate_parts_{linkage.name}", arguments, step.evaluated, names),
        codegen.function(f"tangent_parts_{linkage.name}", arguments, step.tangent, names),
        codegen.function(f"bodies_{linkage.name}", step.arguments, [ca.horzcat(*bodies)], step.NAMES),
    )


class _Equations(Equations):
    """With one system for all coordinates; with matrices of bodies as an argument, if these are given."""

    def __init__(self, mechanism: Mechanism, in_parts: bool) -> None:
        super().__init__(mechanism)
        self._parts = {linkage: _in_parts(linkage) for linkage in mechanism.linkages} if in_parts else {}
        counts = [len(linkage.bodies) for linkage in mechanism.branches]
        self._ends = np.cumsum([0, *counts]).tolist()
        self.given = ca.MX.sym("given", TURNED, self._ends[-1] if in_parts else 0)

    def function_of(self, i: int, name: str) -> ca.Function:
        parts = self._parts.get(self.mechanism.branches[i])
        function: ca.Function | None = getattr(parts, name, None)
        return super().function_of(i, name) if function is None else function

    def _called(self, i: int, name: str, arguments: Sequence[ca.MX]) -> ca.MX | tuple[ca.MX, ...]:
        takes = self._parts and name in ("evaluate", "tangent")
        of_branch = [self.given[:, self._ends[i] : self._ends[i + 1]]] if takes else []
        return super()._called(i, name, [*arguments, *of_branch])

    def functions(self) -> list[ca.Function]:
        """(…, h, given) → matrix of the system, and Φ_z; the same → what is missing, Φ, rates of the base's coordinates
        by its velocity; and of bodies in parts (…, h) → what `turned` needs."""
        z, dz, ddz, multipliers = self.symbols[:4]
        base = self._base(z, dz, ddz)
        tangents = self._branches("tangent", z, dz, ddz, multipliers, base)
        by_branch = self._branches("evaluate", z, dz, ddz, multipliers, base)
        at_base = sum((f[3] for f in tangents), base[5])
        of_base, by_base = ca.horzcat(*(f[2] for f in tangents)), ca.vertcat(*(f[1] for f in tangents))
        matrix = ca.blockcat([[at_base, of_base], [by_base, ca.diagcat(*(f[0] for f in tangents))]])
        jacobian = ca.diagcat(*(f[4] for f in tangents))
        missing = ca.vertcat(sum((f[1] for f in by_branch), base[4]), *(f[0] for f in by_branch))
        gaps, rates = ca.vertcat(*(f[2] for f in by_branch)), self._base_rates(z[: self.mechanism.base_size])
        arguments = [*self.symbols, self.h, self.given]
        functions = [
            codegen.function(name, arguments, results, [f"a{i}" for i in range(len(arguments))])
            for name, results in (("system", [matrix, jacobian]), ("missing", [missing, gaps, rates]))
        ]
        if self._parts:
            bodies = [branch[0] for branch in self._branches("bodies", z, dz, ddz, multipliers, base)]
            names = [f"a{i}" for i in range(len(arguments) - 1)]
            functions.append(codegen.function("bodies", arguments[:-1], [ca.horzcat(*bodies)], names))
        return functions


class OutsideIntegrator(Integrator):
    """As `Integrator`, of a mechanism with a base, with `outside` for its iterations."""

    def __init__(
        self,
        mechanism: Mechanism,
        parameters: Array,
        h: float,
        tolerance: float = 1e-9,
        name: str = "mechanism",
        *,
        outside: Outside,
    ) -> None:
        super().__init__(mechanism, parameters, h, tolerance, name)
        self._outside = outside
        self._elapsed = 0.0
        functions = codegen.compiled(f"{name}_outside", _Equations(mechanism, outside.turn is not None).functions())
        state = self.state
        arguments = [
            state.z, state.dz, state.ddz, state.multipliers, self.parameters, self.guides.reshape(-1, order="F"),
            self.gravity, self.wrench, self.inputs, self.h,
        ]  # fmt: skip
        self._given = np.zeros(functions[0].nnz_in(10))
        self._system, self._missing = (Kernel(f, [*arguments, self._given]) for f in functions[:2])
        self._bodies = Kernel(functions[2], arguments) if outside.turn is not None else None

    def step(self) -> None:
        self._before.take(self.state)
        state, h = self.state, float(self.h[0])
        state.z += h * state.dz + h * h / 2 * state.ddz
        state.dz += h * state.ddz
        self.steps += 1
        self._elapsed += h
        if self._outside.at is not None:
            self._outside.at(self._elapsed)
        try:
            self._iterate(h)
        except (InputError, FloatingPointError):
            state.take(self._before)
            raise
        self._project.call()
        np.copyto(state.dz, self._project.results[0].reshape(-1))
        np.copyto(state.ddz, self._project.results[1].reshape(-1))

    def _iterate(self, h: float) -> None:
        state, base = self.state, self.mechanism.base_size
        self._turn()
        self._system.call()
        matrix, jacobian = self._system.results
        size = np.inf
        for _ in range(STEP.corrections * MOST_CALLS):
            self._missing.call()
            missing, gaps, rates = self._missing.results
            solution = self._outside.solve(matrix, -missing[:, 0])
            self.calls += 1
            change = np.concatenate([rates @ solution[:base], solution[base:]])
            state.z += change
            state.dz += 2 / h * change
            state.ddz += 4 / h**2 * change
            state.multipliers += STEP.penalty_mass * 4 / h**2 * (gaps[:, 0] + jacobian @ solution[base:])
            size = float(np.linalg.norm(change))
            if size < self.tolerance:
                return
            if not np.isfinite(size):
                break
            self._turn()
        raise InputError(
            f"a step of {h:g} s does not converge: coordinates still change by {size:.2g} after {self.calls} "
            f"iterations in all (allowed {self.tolerance:g}); use a shorter step, or check masses and forces"
        )

    def _turn(self) -> None:
        """The matrices of the bodies at the present coordinates."""
        if self._bodies is not None and self._outside.turn is not None:
            self._bodies.call()
            self._given[:] = self._outside.turn(self._bodies.results[0].T).reshape(-1)

    @property
    def iterations(self) -> float:
        return self.calls / max(self.steps, 1)
