"""Open kinematic trees in relative coordinates: bodies as data, dynamics without iteration.

A tree has one floating root (six velocities) and one-degree-of-freedom joints. Its equations are the recursive ones of
Featherstone 2008 (articulated bodies, table 7.1; Newton-Euler, table 5.1), O(n) in the number of bodies. Everything is
a CasADi expression, so that Jacobians and code come from the same text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

from vsense_ros.model.spatial import cross_force, cross_motion, motion_transform


@dataclass(frozen=True)
class Body:
    """A body on a one-degree-of-freedom joint.

    `rotation` (3×3) and `position` (3×1) place the body's frame in its parent's *at the present joint coordinate*;
    `axis` (6×1) is the joint's motion vector in the body's frame; `inertia` is the spatial inertia (6×6).
    `parent` is an index into the tree's bodies, or -1 for the floating root. `axis_rate` (6×1) is the derivative of the
    axis by time as seen from the body, of a joint whose motion vector changes with its coordinate.

    A frame moves with its body but may be turned in it as is convenient: only what it is at this instant counts.
    """

    name: str
    parent: int
    axis: ca.SX
    rotation: ca.SX
    position: ca.SX
    inertia: ca.SX
    axis_rate: ca.SX = field(default_factory=lambda: ca.SX(6, 1))


@dataclass(frozen=True)
class Tree:
    """A floating root of spatial inertia `root_inertia` (6×6) and its bodies, parents before children.

    Without an inertia the root is held: its acceleration is zero, whatever acts on it.
    """

    root_inertia: ca.SX | None
    bodies: tuple[Body, ...]

    def velocities(self, root_velocity: ca.SX, rates: ca.SX) -> list[ca.SX]:
        """Spatial velocity of every body in its own frame; `root_velocity` is `[ω; v]` 6×1, `rates` n×1."""
        result: list[ca.SX] = []
        for i, body in enumerate(self.bodies):
            parent = root_velocity if body.parent < 0 else result[body.parent]
            result.append(motion_transform(body.rotation, body.position) @ parent + body.axis * rates[i])
        return result

    def forward_dynamics(
        self, root_velocity: ca.SX, rates: ca.SX, efforts: ca.SX, root_force: ca.SX, forces: Sequence[ca.SX]
    ) -> tuple[ca.SX, ca.SX]:
        """Spatial acceleration of the root (6×1, body frame) and joint accelerations (n×1).

        `efforts` are the joint forces (n×1), `root_force` and `forces` the external force vectors (6×1) on the root and
        on each body in its own frame; gravity is among them. The root's acceleration is the spatial one: its linear
        part is v̇ as seen in the body frame, the classical acceleration is that plus ω × v.
        """
        count = len(self.bodies)
        transforms = [motion_transform(b.rotation, b.position) for b in self.bodies]
        velocity = self.velocities(root_velocity, rates)
        articulated = [b.inertia for b in self.bodies]
        bias = [cross_force(velocity[i], self.bodies[i].inertia @ velocity[i]) - forces[i] for i in range(count)]
        coriolis = [
            (cross_motion(velocity[i], body.axis) + body.axis_rate) * rates[i] for i, body in enumerate(self.bodies)
        ]
        root_inertia = ca.SX(6, 6) if self.root_inertia is None else self.root_inertia
        root_articulated = root_inertia
        root_bias = cross_force(root_velocity, root_inertia @ root_velocity) - root_force

        column: list[ca.SX] = [ca.SX()] * count
        pivot: list[ca.SX] = [ca.SX()] * count
        drive: list[ca.SX] = [ca.SX()] * count
        for i in reversed(range(count)):
            axis = self.bodies[i].axis
            column[i] = articulated[i] @ axis
            pivot[i] = axis.T @ column[i]
            drive[i] = efforts[i] - axis.T @ bias[i]
            inertia = symmetric(articulated[i] - column[i] @ column[i].T / pivot[i])
            force = bias[i] + inertia @ coriolis[i] + column[i] * (drive[i] / pivot[i])
            inertia = symmetric(transforms[i].T @ inertia @ transforms[i])
            force = transforms[i].T @ force
            if self.bodies[i].parent < 0:
                root_articulated = root_articulated + inertia
                root_bias = root_bias + force
            else:
                articulated[self.bodies[i].parent] = articulated[self.bodies[i].parent] + inertia
                bias[self.bodies[i].parent] = bias[self.bodies[i].parent] + force

        root_is_held = self.root_inertia is None
        root_acceleration = ca.SX(6, 1) if root_is_held else solve_spd(root_articulated, -root_bias)
        acceleration: list[ca.SX] = []
        joint: list[ca.SX] = []
        for i, body in enumerate(self.bodies):
            parent = root_acceleration if body.parent < 0 else acceleration[body.parent]
            carried = transforms[i] @ parent + coriolis[i]
            joint.append((drive[i] - column[i].T @ carried) / pivot[i])
            acceleration.append(carried + body.axis * joint[i])
        return root_acceleration, ca.vertcat(*joint)

    def inverse_dynamics(
        self,
        root_velocity: ca.SX,
        rates: ca.SX,
        root_acceleration: ca.SX,
        joint_acceleration: ca.SX,
        root_force: ca.SX,
        forces: Sequence[ca.SX],
    ) -> tuple[ca.SX, ca.SX]:
        """Force on the root (6×1) and joint efforts (n×1) that accelerations need beyond the external forces, by
        Newton-Euler; arguments and conventions as in `forward_dynamics`."""
        velocity = self.velocities(root_velocity, rates)
        acceleration: list[ca.SX] = []
        required: list[ca.SX] = []
        for i, body in enumerate(self.bodies):
            parent = root_acceleration if body.parent < 0 else acceleration[body.parent]
            coriolis = (cross_motion(velocity[i], body.axis) + body.axis_rate) * rates[i]
            carried = motion_transform(body.rotation, body.position) @ parent
            acceleration.append(carried + coriolis + body.axis * joint_acceleration[i])
            gyroscopic = cross_force(velocity[i], body.inertia @ velocity[i])
            required.append(body.inertia @ acceleration[i] + gyroscopic - forces[i])
        root = -root_force
        if self.root_inertia is not None:
            root = root + self.root_inertia @ root_acceleration
            root = root + cross_force(root_velocity, self.root_inertia @ root_velocity)
        joint: list[ca.SX] = [ca.SX()] * len(self.bodies)
        for i in reversed(range(len(self.bodies))):
            body = self.bodies[i]
            joint[i] = body.axis.T @ required[i]
            carried = motion_transform(body.rotation, body.position).T @ required[i]
            if body.parent < 0:
                root = root + carried
            else:
                required[body.parent] = required[body.parent] + carried
        return root, ca.vertcat(*joint)

    def inertia_times(self, root_acceleration: ca.SX, joint_acceleration: ca.SX) -> ca.SX:
        """Mass matrix times accelerations, `[root 6; joints n]`: what they need at rest (no matrix is formed)."""
        zero, count = ca.SX(6, 1), len(self.bodies)
        return ca.vertcat(
            *self.inverse_dynamics(zero, ca.SX(count, 1), root_acceleration, joint_acceleration, zero, [zero] * count)
        )


def symmetric(matrix: ca.SX) -> ca.SX:
    """A symmetric matrix whose upper triangle is taken from the lower one, so that it is not computed twice."""
    return ca.tril2symm(ca.tril(matrix))


def solve_spd(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of a small symmetric positive definite system by L D Lᵀ, without square roots or pivoting.

    Written out instead of calling `casadi.solve`, whose symbolic QR makes several times the number of operations.
    """
    n = matrix.shape[0]
    low = ca.SX.eye(n)
    diagonal: list[ca.SX] = []
    for j in range(n):
        d = matrix[j, j] - sum((low[j, k] * low[j, k] * diagonal[k] for k in range(j)), ca.SX(0))
        diagonal.append(d)
        for i in range(j + 1, n):
            low[i, j] = (matrix[i, j] - sum((low[i, k] * low[j, k] * diagonal[k] for k in range(j)), ca.SX(0))) / d
    y = ca.SX(right)
    for i in range(n):
        for k in range(i):
            y[i, :] -= low[i, k] * y[k, :]
    for i in range(n):
        y[i, :] /= diagonal[i]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            y[i, :] -= low[k, i] * y[k, :]
    return y


def inverse_spd(matrix: ca.SX) -> ca.SX:
    """Inverse of a small symmetric positive definite matrix; cheapest where its first rows are nearly empty."""
    return symmetric(solve_spd(matrix, ca.SX.eye(matrix.shape[0])))


def solve_dominant(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of a small system by elimination without pivoting, for matrices with dominant diagonals."""
    n = matrix.shape[0]
    a, y = ca.SX(matrix), ca.SX(right)
    for k in range(n):
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            a[i, k + 1 :] -= factor * a[k, k + 1 :]
            y[i, :] -= factor * y[k, :]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            y[i, :] -= a[i, k] * y[k, :]
        y[i, :] /= a[i, i]
    return y
