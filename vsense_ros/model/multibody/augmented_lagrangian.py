"""Time steps of mechanisms with closed loops: index-3 augmented Lagrangian, trapezoidal rule, projections.

One step solves M z̈ + Φ_zᵀ (α Φ + λ) = Q at its end by Newton-Raphson with the trapezoidal rule inserted, updates the
multipliers λ in each iteration, and then projects velocities and accelerations on the constraints' derivatives
orthogonally to the matrix of the iteration (Cuadrado, Dopico, González & Naya 2004; Dopico et al. 2014). The penalty is
given as a mass, `PENALTY_MASS = α h²/4`, which keeps the conditioning the same for every step length.

The system is solved by its structure: each branch is eliminated on its own and leaves a 6×6 matrix at the base, so that
the work grows linearly with the number of branches. The matrix of the iteration is made once a step, with the stiffness
of springs, loads and constraint forces in it, and leaves out what the change of inertia contributes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.model import spatial
from vsense_ros.model.multibody.joints import column
from vsense_ros.model.multibody.mechanism import Linkage, Mechanism
from vsense_ros.model.multibody.semi_recursive import Forces, Motion
from vsense_ros.model.multibody.tree import solve_dominant


@dataclass(frozen=True)
class StepSettings:
    """Numerical settings of time steps of mechanisms."""

    penalty_mass: float = 1e6  # [kg] α h²/4, the penalty of constraints as a mass
    corrections: int = 3  # iterations in one call
    settling: int = 4  # iterations for rates and accelerations that fit given coordinates


STEP = StepSettings()


Array = NDArray[np.float64]

_NAMES = ("z", "dz", "ddz", "multipliers", "parameters", "guides", "gravity", "wrench", "inputs")


@dataclass(frozen=True)
class _Branch:
    """The functions of one linkage: symbols in, numbers out, shared by all branches that are equal."""

    evaluate: ca.Function
    tangent: ca.Function
    factor: ca.Function
    constraints: ca.Function
    equations: ca.Function
    exports: ca.Function
    outputs: ca.Function


class StepOfLinkage:
    """What one linkage adds to the equations of a time step, in symbols.

    `evaluated` are what its coordinates and its base lack, times h²/4, and its constraints; `tangent` are the
    derivatives by its coordinates, by the base, of the base, of the base by the base, and the Jacobian of the
    constraints. `arguments` have the `NAMES`. `inertias` gives spatial inertias of the bodies, as `Forces` takes them.
    """

    NAMES = (
        "z", "dz", "ddz", "guides", "multipliers", "base_velocity", "base_acceleration", "up", "height",
        "parameters", "inputs", "h",
    )  # fmt: skip

    def __init__(self, linkage: Linkage, inertias: Callable[[Motion], dict[str, ca.SX]] | None = None) -> None:
        n, m, g = len(linkage.coordinate_names), len(linkage.equation_names), len(linkage.guides)
        z, dz, ddz = (ca.SX.sym(name, n) for name in ("z", "dz", "ddz"))
        guides, multipliers = ca.SX.sym("guides", g, 3), ca.SX.sym("multipliers", m)
        base_velocity, base_acceleration = ca.SX.sym("base_velocity", 6), ca.SX.sym("base_acceleration", 6)
        up, height, h = ca.SX.sym("up", 3), ca.SX.sym("height"), ca.SX.sym("h")
        self.motion = motion = Motion(linkage, z, dz, ddz, guides)
        given_inertias = None if inertias is None else inertias(motion)
        self.forces = forces = Forces(motion, base_velocity, base_acceleration, up, height, given_inertias)
        weight = h**2 / 4
        jacobian, constraint = motion.constraint_jacobian, motion.constraint
        self.arguments = [
            z, dz, ddz, guides, multipliers, base_velocity, base_acceleration, up, height,
            linkage.parameters, linkage.inputs, h,
        ]  # fmt: skip
        residual = weight * (forces.residual + jacobian.T @ multipliers) + STEP.penalty_mass * (jacobian.T @ constraint)
        tangent, by_base, of_base, at_base = forces.tangent(h / 2, weight)
        matrix = (
            tangent + weight * motion.constraint_curvature(multipliers) + STEP.penalty_mass * (jacobian.T @ jacobian)
        )
        self.evaluated = [residual, weight * forces.base, constraint]
        self.tangent = [matrix, by_base, of_base, at_base, jacobian]


def _branch(linkage: Linkage) -> _Branch:
    step = StepOfLinkage(linkage)
    motion, forces, arguments, names = step.motion, step.forces, step.arguments, step.NAMES

    def function(kind: str, results: Sequence[ca.SX]) -> ca.Function:
        return codegen.function(f"{kind}_{linkage.name}", arguments, results, names)

    # Elimination sees plain elements and not the expressions behind them, which keeps the code short.
    inverse = _inverse(linkage.name, len(linkage.coordinate_names))
    mass, mass_by_base, mass_of_base, mass_both = forces.tangent(ca.SX(0), ca.SX(0))
    shape = function("tangent", step.tangent)
    symbols = [ca.MX.sym(name, *a.shape) for name, a in zip(names, arguments, strict=True)]
    matrix_x, by_base_x, of_base_x, both_x, jacobian_x = shape(*symbols)
    inverse_x = inverse(matrix_x)
    right = inverse_x @ by_base_x
    factor = ca.Function(
        f"factor_{linkage.name}",
        symbols,
        [inverse_x, right, of_base_x @ inverse_x, both_x - of_base_x @ right, jacobian_x],
        list(names),
        ["inverse", "right", "left", "schur", "jacobian"],
    )
    exports = [motion.measure(measure).value for measure in linkage.exports]
    return _Branch(
        evaluate=function("evaluate", step.evaluated),
        tangent=shape,
        factor=factor,
        constraints=function(
            "constraints",
            [motion.constraint, motion.constraint_rate, motion.constraint_acceleration, motion.constraint_jacobian],
        ),
        equations=function("equations", [mass, mass_by_base, mass_of_base, mass_both, forces.residual, forces.base]),
        exports=ca.Function(
            f"exports_{linkage.name}",
            [arguments[0], arguments[3], linkage.parameters],
            [ca.densify(ca.vertcat(ca.SX(0, 1), *exports))],
            ["z", "guides", "parameters"],
            ["exports"],
        ),
        outputs=function("outputs", [ca.vertcat(ca.SX(0, 1), *forces.load_outputs)]),
    )


def _inverse(name: str, n: int) -> ca.Function:
    """Inverse of an n×n matrix with a dominant diagonal, as a function of its elements."""
    a = ca.SX.sym("a", n, n)
    return codegen.function(f"inverse_{name}", [a], [solve_dominant(a, ca.SX.eye(n))], ["a"])


def base_functions(mechanism: Mechanism) -> tuple[ca.Function, ca.Function]:
    """(q, dq, ddq, gravity, wrench, parameters, h) → velocity, acceleration less free fall, up, height, missing force
    by weight, inertia; and (q) → rates of the coordinates by the spatial velocity (6×6)."""
    base = mechanism.base
    gravity, wrench, h = ca.SX.sym("gravity", 3), ca.SX.sym("wrench", 6), ca.SX.sym("h")
    if base is None:
        nothing = ca.SX.sym("q", 0)
        return (
            codegen.function(
                "base_state",
                [nothing, nothing, nothing, gravity, wrench, ca.SX.sym("p", 0), h],
                [ca.SX(6, 1), ca.vertcat(ca.SX(3, 1), -gravity), ca.SX([0, 0, 1]), ca.SX(0), ca.SX(6, 1), ca.SX(6, 6)],
                ("q", "dq", "ddq", "gravity", "wrench", "parameters", "h"),
            ),
            codegen.function("base_rates", [nothing], [ca.SX(0, 6)], ("q",)),
        )
    q, dq, ddq = (ca.SX.sym(name, 6) for name in ("q", "dq", "ddq"))
    attitude = spatial.rotation_rpy(q[3], q[4], q[5])
    s, c = ca.sin(q[3]), ca.cos(q[3])
    # Body rates from the rates of roll, pitch and yaw, and back.
    to_body_rates = ca.vertcat(
        ca.horzcat(1, 0, -ca.sin(q[4])),
        ca.horzcat(0, c, s * ca.cos(q[4])),
        ca.horzcat(0, -s, c * ca.cos(q[4])),
    )
    to_angle_rates = ca.vertcat(
        ca.horzcat(1, s * ca.tan(q[4]), c * ca.tan(q[4])),
        ca.horzcat(0, c, -s),
        ca.horzcat(0, s / ca.cos(q[4]), c / ca.cos(q[4])),
    )
    velocity = ca.vertcat(to_body_rates @ dq[3:6], attitude.T @ dq[0:3])
    acceleration = ca.jtimes(velocity, ca.vertcat(q, dq), ca.vertcat(dq, ddq))
    less_gravity = ca.vertcat(acceleration[:3], acceleration[3:] - attitude.T @ gravity)
    inertia = spatial.rigid_inertia(ca.SX(base.mass), column(base.centre), base.inertia)
    load = wrench if base.load is None else wrench + base.load(velocity)
    missing = inertia @ less_gravity + spatial.cross_force(velocity, inertia @ velocity) - load
    state = codegen.function(
        "base_state",
        [q, dq, ddq, gravity, wrench, base.parameters, h],
        [velocity, less_gravity, attitude[2, :].T, q[2], h**2 / 4 * missing, inertia],
        ("q", "dq", "ddq", "gravity", "wrench", "parameters", "h"),
    )
    rates = ca.vertcat(ca.horzcat(ca.SX(3, 3), attitude), ca.horzcat(to_angle_rates, ca.SX(3, 3)))
    return state, codegen.function("base_rates", [q], [rates], ("q",))


class Equations:
    """The functions of a mechanism, CasADi expressions throughout.

    Common arguments, in this order: coordinates, rates, accelerations (N), multipliers (m), parameters (those of the
    base, then those of each branch), guides (g×3: position, speed, acceleration), acceleration of free fall in ground
    axes (3), a force vector `[n; f]` on the base in its axes (6), inputs (those of each branch) and the step h [s].
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self._shared = {linkage: _branch(linkage) for linkage in mechanism.linkages}
        self._base_state, self._base_rates = base_functions(mechanism)
        base_parameters = mechanism.base.parameters.numel() if mechanism.base else 0
        self._parameter_ends = np.cumsum([base_parameters, *(b.parameters.numel() for b in mechanism.branches)])
        self._input_ends = np.cumsum([0, *(b.inputs.numel() for b in mechanism.branches)])
        sizes = (
            *[(mechanism.coordinates, 1)] * 3, (mechanism.constraints, 1), (int(self._parameter_ends[-1]), 1),
            (len(mechanism.guides), 3), (3, 1), (6, 1), (int(self._input_ends[-1]), 1),
        )  # fmt: skip
        self.symbols = [ca.MX.sym(name, *size) for name, size in zip(_NAMES, sizes, strict=True)]
        self.h = ca.MX.sym("h")

    def _function(self, name: str, results: Sequence[ca.MX], with_step: bool = True) -> ca.Function:
        arguments = [*self.symbols, self.h] if with_step else self.symbols
        names = [*_NAMES, "h"] if with_step else list(_NAMES)
        return ca.Function(
            name, arguments, [ca.densify(r) for r in results], names, [f"r{i}" for i in range(len(results))]
        )

    def _base(self, z: ca.MX, dz: ca.MX, ddz: ca.MX, h: ca.MX | None = None) -> tuple[ca.MX, ...]:
        k = self.mechanism.base_size
        _, _, _, _, parameters, _, gravity, wrench, _ = self.symbols
        of_base = parameters[: int(self._parameter_ends[0])]
        return tuple(
            self._base_state.call([z[:k], dz[:k], ddz[:k], gravity, wrench, of_base, self.h if h is None else h])
        )

    def _branches(
        self,
        name: str,
        z: ca.MX,
        dz: ca.MX,
        ddz: ca.MX,
        multipliers: ca.MX,
        base: tuple[ca.MX, ...],
        h: ca.MX | None = None,
    ) -> list[tuple[ca.MX, ...]]:
        """Results of the function `name` of every branch; `h` stands for the length of the step."""
        mechanism = self.mechanism
        _, _, _, _, parameters, guides, _, _, inputs = self.symbols
        exports: dict[int, ca.MX] = {}

        def part(i: int) -> tuple[ca.MX, ca.MX, ca.MX]:
            linkage = mechanism.branches[i]
            rows = [mechanism.guides.index(guide) for guide in linkage.guides]
            return (
                z[mechanism.offsets[i] : mechanism.offsets[i + 1]],
                guides[rows, :] if rows else ca.MX(0, 3),
                parameters[int(self._parameter_ends[i]) : int(self._parameter_ends[i + 1])],
            )

        for link in mechanism.links:
            if link.source not in exports:
                shared = self._shared[mechanism.branches[link.source]]
                exports[link.source] = shared.exports(*part(link.source))
        results = []
        for i in range(len(mechanism.branches)):
            columns = slice(mechanism.offsets[i], mechanism.offsets[i + 1])
            rows = slice(mechanism.equation_offsets[i], mechanism.equation_offsets[i + 1])
            own_z, own_guides, own_parameters = part(i)
            own_inputs = ca.vertsplit(inputs[int(self._input_ends[i]) : int(self._input_ends[i + 1])])
            for link in mechanism.links:
                if link.to == i:
                    own_inputs[link.entry] = exports[link.source][link.export]
            arguments = [
                own_z, dz[columns], ddz[columns], own_guides, multipliers[rows], *base[:4], own_parameters,
                ca.vertcat(ca.MX(0, 1), *own_inputs), self.h if h is None else h,
            ]  # fmt: skip
            outputs = self._called(i, name, arguments)
            results.append(outputs if isinstance(outputs, tuple) else (outputs,))
        return results

    def function_of(self, i: int, name: str) -> ca.Function:
        """The function of a branch by its name."""
        function: ca.Function = getattr(self._shared[self.mechanism.branches[i]], name)
        return function

    def _called(self, i: int, name: str, arguments: Sequence[ca.MX]) -> ca.MX | tuple[ca.MX, ...]:
        """Results of a function of a branch."""
        outputs: ca.MX | tuple[ca.MX, ...] = self.function_of(i, name)(*arguments)
        return outputs

    def _factor(
        self, z: ca.MX, dz: ca.MX, ddz: ca.MX, multipliers: ca.MX, h: ca.MX | None = None
    ) -> tuple[list[tuple[ca.MX, ...]], ca.MX]:
        """Results of `_Branch.factor` for each branch, and the inverse (6×6) at the base."""
        base = self._base(z, dz, ddz)
        factors = self._branches("factor", z, dz, ddz, multipliers, base, h)
        if self.mechanism.base is None:
            return factors, ca.MX(6, 6)
        total = sum((f[3] for f in factors), base[5])
        return factors, _inverse("base", 6)(total)

    def _solve(
        self, z: ca.MX, factors: list[tuple[ca.MX, ...]], at_base: ca.MX, residuals: list[ca.MX], missing: ca.MX
    ) -> ca.MX:
        """Change of the coordinates (N) that removes the residuals of branches and base to first order."""
        twist = at_base @ (sum((f[2] @ r for f, r in zip(factors, residuals, strict=True)), ca.MX(6, 1)) - missing)
        changes = [-(f[0] @ r + f[1] @ twist) for f, r in zip(factors, residuals, strict=True)]
        return ca.vertcat(self._base_rates(z[: self.mechanism.base_size]) @ twist, *changes)

    def _corrected(
        self, z: ca.MX, dz: ca.MX, ddz: ca.MX, multipliers: ca.MX, count: int
    ) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX, ca.MX]:
        """After `count` iterations with one matrix: z, dz, ddz, multipliers, and the norm of the last change."""
        h, mechanism = self.h, self.mechanism
        factors, at_base = self._factor(z, dz, ddz, multipliers)
        largest = ca.MX(0)
        for _ in range(count):
            base = self._base(z, dz, ddz)
            by_branch = self._branches("evaluate", z, dz, ddz, multipliers, base)
            missing = sum((f[1] for f in by_branch), base[4])
            change = self._solve(z, factors, at_base, [f[0] for f in by_branch], missing)
            z, dz, ddz = z + change, dz + 2 / h * change, ddz + 4 / h**2 * change
            violations = [
                f[2] + factor[4] @ change[mechanism.offsets[i] : mechanism.offsets[i + 1]]
                for i, (f, factor) in enumerate(zip(by_branch, factors, strict=True))
            ]
            multipliers = multipliers + STEP.penalty_mass * 4 / h**2 * ca.vertcat(ca.MX(0, 1), *violations)
            largest = ca.norm_2(change)  # unlike the largest element, it does not hide what is no number
        return z, dz, ddz, multipliers, largest

    def _projected(self, z: ca.MX, dz: ca.MX, ddz: ca.MX, multipliers: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Rates and accelerations that fulfil the constraints' derivatives, and the norm of the violation left in Φ."""
        factors, at_base = self._factor(z, dz, ddz, multipliers)
        nothing = ca.MX(6, 1)
        base = self._base(z, dz, ddz)
        if not self.mechanism.constraints:
            return dz, ddz, ca.MX(0)
        for which in (1, 2):
            # Twice: one projection by a penalty leaves a share of the violation that is the ratio of the masses.
            for _ in range(2):
                by_branch = self._branches("constraints", z, dz, ddz, multipliers, base)
                residuals = [STEP.penalty_mass * (f[3].T @ f[which]) for f in by_branch]
                change = self._solve(z, factors, at_base, residuals, nothing)
                if which == 1:
                    dz = dz + change
                else:
                    ddz = ddz + change
        by_branch = self._branches("constraints", z, dz, ddz, multipliers, base)
        return dz, ddz, ca.norm_2(ca.vertcat(*(f[0] for f in by_branch)))

    def settle_function(self) -> ca.Function:
        """Rates, accelerations and multipliers that fit the coordinates, and the last change of an acceleration.

        Rates change as little as the masses allow; accelerations follow from M z̈ + Φ_zᵀ λ = Q by the augmented
        Lagrangian at the level of accelerations. The coordinates must fulfil the constraints.
        """
        z, dz, _, multipliers = self.symbols[:4]
        mechanism = self.mechanism
        no_step, unit_weight = ca.MX(0), ca.MX(2)  # matrix without stiffness and damping; forces at full weight
        ddz = ca.MX(mechanism.coordinates, 1)
        factors, at_base = self._factor(z, dz, ddz, multipliers, no_step)

        def constraints() -> list[tuple[ca.MX, ...]]:
            return self._branches("constraints", z, dz, ddz, multipliers, self._base(z, dz, ddz))

        for _ in range(STEP.settling):
            residuals = [STEP.penalty_mass * (f[3].T @ f[1]) for f in constraints()]
            dz = dz + self._solve(z, factors, at_base, residuals, ca.MX(6, 1))
        largest = ca.MX(0)
        for _ in range(STEP.settling):
            base = self._base(z, dz, ddz, unit_weight)
            by_branch = self._branches("evaluate", z, dz, ddz, multipliers, base, unit_weight)
            constraints_by_branch = constraints()
            residuals = [
                f[0] + STEP.penalty_mass * (c[3].T @ (c[2] - c[0]))
                for f, c in zip(by_branch, constraints_by_branch, strict=True)
            ]
            change = self._solve(z, factors, at_base, residuals, sum((f[1] for f in by_branch), base[4]))
            ddz = ddz + change
            violations = [
                c[2] + c[3] @ change[mechanism.offsets[i] : mechanism.offsets[i + 1]]
                for i, c in enumerate(constraints_by_branch)
            ]
            multipliers = multipliers + STEP.penalty_mass * ca.vertcat(ca.MX(0, 1), *violations)
            largest = ca.norm_2(change)  # unlike the largest element, it does not hide what is no number
        return self._function("settle", [dz, ddz, multipliers, largest])

    def _predicted(self) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        z, dz, ddz, multipliers = self.symbols[:4]
        return z + self.h * dz + self.h**2 / 2 * ddz, dz + self.h * ddz, ddz, multipliers

    def step_functions(self) -> list[ca.Function]:
        """`step` (predict, correct, project), `advance` (predict, correct), `refine` (correct) and `project`.

        The first three give z, dz, ddz, multipliers and the norm of the last iteration's change, `step` also that
        of the constraints' violation; `project` gives dz, ddz and that violation. Guides, inputs and forces are
        those of the end of the step.
        """
        stepped = self._corrected(*self._predicted(), STEP.corrections)
        *projected, violation = self._projected(*stepped[:4])
        z, dz, ddz, multipliers = self.symbols[:4]
        return [
            self._function("step", [stepped[0], *projected, stepped[3], stepped[4], violation]),
            self._function("advance", stepped),
            self._function("refine", self._corrected(z, dz, ddz, multipliers, STEP.corrections)),
            self._function("project", self._projected(z, dz, ddz, multipliers)),
        ]

    def dynamics_function(self) -> ca.Function:
        """Mass matrix (N×N), generalized forces Q (N, with what depends on the velocities), Φ, dΦ/dt, d²Φ/dt², Φ_z."""
        mechanism = self.mechanism
        z, dz, ddz, multipliers = self.symbols[:4]
        k = mechanism.base_size
        still = ca.MX(mechanism.coordinates, 1)
        base = self._base(z, dz, still)
        by_branch = self._branches("equations", z, dz, still, multipliers, base)
        constraints = self._branches("constraints", z, dz, ddz, multipliers, base)
        mass = ca.diagcat(*(f[0] for f in by_branch))
        forces = ca.vertcat(ca.MX(0, 1), *(-f[4] for f in by_branch))
        jacobian = ca.diagcat(*(c[3] for c in constraints))
        if k:
            rates = self._base_rates(z[:6])
            map_ = ca.solve(rates, ca.MX.eye(6))  # spatial velocity by rates of the coordinates
            by_base = ca.vertcat(*(f[1] for f in by_branch))
            of_base = ca.horzcat(*(f[2] for f in by_branch))
            at_base = sum((f[3] for f in by_branch), base[5])
            mass = ca.blockcat([[map_.T @ at_base @ map_, map_.T @ of_base], [by_base @ map_, mass]])
            total = base[4] * 4 / self.h**2 + sum((f[5] for f in by_branch), ca.MX(6, 1))
            forces = ca.vertcat(-map_.T @ total, forces)
            jacobian = ca.horzcat(ca.MX(mechanism.constraints, 6), jacobian)
        parts = [ca.vertcat(ca.MX(0, 1), *(c[i] for c in constraints)) for i in range(3)]
        return self._function("mechanism_dynamics", [mass, forces, *parts, jacobian])

    def outputs_function(self) -> ca.Function:
        """What the loads of each branch give out, one after the other."""
        z, dz, ddz, multipliers = self.symbols[:4]
        base = self._base(z, dz, ddz)
        by_branch = self._branches("outputs", z, dz, ddz, multipliers, base)
        return self._function("mechanism_outputs", [ca.vertcat(ca.MX(0, 1), *(f[0] for f in by_branch))])
