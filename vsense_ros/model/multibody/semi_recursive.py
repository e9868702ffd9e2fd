"""Motion and forces of one linkage in relative coordinates, from the base to the leaves and back.

All vectors are in the axes of the base and about its origin. There, the velocity of a body is that of its parent plus
one constant column per coordinate, Z = R ż: the semi-recursive form of Cuadrado, Dopico, González & Naya 2004
(J. Mech. Des. 126:602), in which the mass matrix is Rᵀ M̄ R and body matrices M̄ sum from the leaves to the base. The
motion relative to the base is separate from that of the base, so that constraints and their derivatives do not depend
on where the base is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.multibody.joints import Axis, Vector, column, unit
from vsense_ros.model.multibody.mechanism import (
    BASE,
    Along,
    Between,
    Body,
    BodyState,
    Coincide,
    Displacement,
    Distance,
    Linkage,
    Measure,
    Perpendicular,
    Point,
)


@dataclass(frozen=True, eq=False)
class Frame:
    """Where a body is, relative to the base: `at(X) = origin + rotation @ X` for a point X of the design position.

    `velocity` and `acceleration` are spatial (6×1); `chain` are the coordinates that move the body.
    """

    rotation: ca.SX
    origin: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    chain: tuple[int, ...]

    def at(self, point: ca.SX) -> ca.SX:
        return self.origin + self.rotation @ point


@dataclass(frozen=True, eq=False)
class Value:
    """A scalar that depends on the coordinates, its first two derivatives in time, and its gradient (1×n)."""

    value: ca.SX
    rate: ca.SX
    acceleration: ca.SX
    gradient: ca.SX


@dataclass(frozen=True, eq=False)
class _Place:
    """A point of a body: position, velocity, acceleration (3×1) relative to the base, Jacobian (3×n)."""

    position: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    jacobian: ca.SX
    chain: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Held:
    """Two points that a closure's forces act on, and which of the multipliers are its own."""

    closure: Coincide | Distance
    rows: slice
    a: _Place
    b: _Place


class Motion:
    """A linkage at coordinates `z`, rates `dz`, accelerations `ddz` (n×1) and guides (3 columns: as these three)."""

    def __init__(self, linkage: Linkage, z: ca.SX, dz: ca.SX, ddz: ca.SX, guides: ca.SX) -> None:
        self.linkage = linkage
        self.size = len(linkage.coordinate_names)
        self.columns: list[ca.SX] = []  # of R: what each rate adds to the velocities of the bodies it moves
        self.frames: dict[str, Frame] = {
            BASE: Frame(ca.SX.eye(3), ca.SX(3, 1), ca.SX(6, 1), ca.SX(6, 1), ()),
        }
        self.own: dict[str, tuple[int, ...]] = {}  # coordinates of each body's own joint
        self._z, self._dz = z, dz
        for body in linkage.bodies:
            frame = self.frames[body.parent]
            first = len(self.columns)
            for axis in body.axes:
                if axis.guide is None:
                    i = len(self.columns)
                    frame = self._moved(frame, axis, z[i], dz[i], ddz[i], i)
                else:
                    g = linkage.guides.index(axis.guide)
                    frame = self._moved(frame, axis, guides[g, 0], guides[g, 1], guides[g, 2], None)
            self.frames[body.name] = frame
            self.own[body.name] = tuple(range(first, len(self.columns)))

    def _moved(self, frame: Frame, axis: Axis, z: ca.SX, dz: ca.SX, ddz: ca.SX, index: int | None) -> Frame:
        direction = frame.rotation @ axis.direction
        rotation = frame.rotation
        if axis.turns:
            pivot = frame.at(axis.point)
            motion = ca.vertcat(direction, ca.cross(pivot, direction))
            if axis.follows:
                rotation = frame.rotation @ turn(axis.direction, z)
            origin = pivot - rotation @ axis.point
        else:
            motion = ca.vertcat(ca.SX(3, 1), direction)
            origin = frame.origin + direction * z
        if index is not None:
            self.columns.append(motion)
        velocity = frame.velocity + motion * dz
        acceleration = frame.acceleration + motion * ddz + spatial.cross_motion(frame.velocity, motion * dz)
        chain = frame.chain if index is None else (*frame.chain, index)
        return Frame(rotation, origin, velocity, acceleration, chain)

    def _place(self, point: Point) -> _Place:
        frame = self.frames[point.body]
        position = frame.at(column(point.at))
        turn_rate, turn_acceleration = frame.velocity[:3], frame.acceleration[:3]
        velocity = frame.velocity[3:] + ca.cross(turn_rate, position)
        acceleration = frame.acceleration[3:] + ca.cross(turn_acceleration, position) + ca.cross(turn_rate, velocity)
        jacobian = ca.SX(3, self.size)
        for k in frame.chain:
            jacobian[:, k] = self.columns[k][3:] + ca.cross(self.columns[k][:3], position)
        return _Place(position, velocity, acceleration, jacobian, frame.chain)

    def _curvature(self, place: _Place, force: ca.SX) -> ca.SX:
        """Derivative of `place.jacobian.T @ force` by the coordinates for a constant force (3×1), n×n."""
        result = ca.SX(self.size, self.size)
        for i, k in enumerate(place.chain):
            turned = ca.cross(force, self.columns[k][:3])
            for j in place.chain[i:]:
                entry = turned.T @ place.jacobian[:, j]
                result[k, j] = entry
                result[j, k] = entry
        return result

    def _direction(self, body: str, direction: Vector) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """A unit vector fixed in a body, its first two derivatives in time (3×1) and its Jacobian (3×n)."""
        frame = self.frames[body]
        n = frame.rotation @ unit(direction)
        rate = ca.cross(frame.velocity[:3], n)
        acceleration = ca.cross(frame.acceleration[:3], n) + ca.cross(frame.velocity[:3], rate)
        jacobian = ca.SX(3, self.size)
        for k in frame.chain:
            jacobian[:, k] = ca.cross(self.columns[k][:3], n)
        return n, rate, acceleration, jacobian

    @cached_property
    def _constraints(self) -> tuple[list[Value], list[_Held]]:
        """The scalar constraints, and the closures whose multipliers are forces at points."""
        values: list[Value] = []
        point_closures: list[_Held] = []
        for closure in self.linkage.closures:
            start = len(values)
            if isinstance(closure, Coincide):
                a, b = self._place(closure.a), self._place(closure.b)
                directions = ca.SX.eye(3)
                if closure.directions is not None:
                    directions = ca.vertcat(*(unit(d).T for d in closure.directions))
                parts = [
                    directions @ d
                    for d in (
                        a.position - b.position,
                        a.velocity - b.velocity,
                        a.acceleration - b.acceleration,
                        a.jacobian - b.jacobian,
                    )
                ]
                values += [Value(*(part[i, :] for part in parts)) for i in range(directions.shape[0])]
            elif isinstance(closure, Distance):
                a, b = self._place(closure.a), self._place(closure.b)
                length = ca.SX(closure.length)
                gap, rate = a.position - b.position, a.velocity - b.velocity
                values.append(
                    Value(
                        # Halved squares: as good as lengths near the solution, and smooth.
                        (ca.dot(gap, gap) / length - length) / 2,
                        ca.dot(gap, rate) / length,
                        (ca.dot(gap, a.acceleration - b.acceleration) + ca.dot(rate, rate)) / length,
                        gap.T @ (a.jacobian - b.jacobian) / length,
                    )
                )
            else:
                n, dn, ddn, jn = self._direction(closure.body_a, closure.direction_a)
                m, dm, ddm, jm = self._direction(closure.body_b, closure.direction_b)
                values.append(
                    Value(
                        ca.dot(n, m),
                        ca.dot(dn, m) + ca.dot(n, dm),
                        ca.dot(ddn, m) + 2 * ca.dot(dn, dm) + ca.dot(n, ddm),
                        m.T @ jn + n.T @ jm,
                    )
                )
            if not isinstance(closure, Perpendicular):
                point_closures.append(_Held(closure, slice(start, len(values)), a, b))
        return values, point_closures

    @cached_property
    def constraint(self) -> ca.SX:
        """Constraints Φ (m×1) [m, or 1 for right angles]."""
        return ca.vertcat(ca.SX(0, 1), *(v.value for v in self._constraints[0]))

    @cached_property
    def constraint_rate(self) -> ca.SX:
        """dΦ/dt (m×1)."""
        return ca.vertcat(ca.SX(0, 1), *(v.rate for v in self._constraints[0]))

    @cached_property
    def constraint_acceleration(self) -> ca.SX:
        """d²Φ/dt² (m×1)."""
        return ca.vertcat(ca.SX(0, 1), *(v.acceleration for v in self._constraints[0]))

    @cached_property
    def constraint_jacobian(self) -> ca.SX:
        """∂Φ/∂z (m×n)."""
        return ca.vertcat(ca.SX(0, self.size), *(v.gradient for v in self._constraints[0]))

    def constraint_curvature(self, multipliers: ca.SX) -> ca.SX:
        """Derivative of Φ_zᵀ · multipliers by the coordinates (n×n); that of right angles is left out."""
        result = ca.SX(self.size, self.size)
        for closure_rows in self._constraints[1]:
            force = multipliers[closure_rows.rows]
            if isinstance(closure_rows.closure, Distance):
                tension = force[0] / ca.SX(closure_rows.closure.length)
                gap_jacobian = closure_rows.a.jacobian - closure_rows.b.jacobian
                result += tension * (gap_jacobian.T @ gap_jacobian)
                force = tension * (closure_rows.a.position - closure_rows.b.position)
            elif closure_rows.closure.directions is not None:
                force = ca.horzcat(*(unit(d) for d in closure_rows.closure.directions)) @ force
            result += self._curvature(closure_rows.a, force) - self._curvature(closure_rows.b, force)
        return result

    def measure(self, measure: Measure) -> Value:
        """A length or angle with its derivatives."""
        if isinstance(measure, Along):
            (index,) = self.own[measure.body]
            gradient = ca.SX(1, self.size)
            gradient[0, index] = 1
            return Value(self._z[index], self._dz[index], ca.SX(0), gradient)
        if isinstance(measure, Displacement):
            place, direction = self._place(measure.point), unit(measure.direction)
            moved = place.position - column(measure.point.at)
            return Value(
                ca.dot(direction, moved),
                ca.dot(direction, place.velocity),
                ca.dot(direction, place.acceleration),
                direction.T @ place.jacobian,
            )
        return self._between(measure)

    def _between(self, measure: Between) -> Value:
        a, b = self._place(measure.a), self._place(measure.b)
        gap = a.position - b.position
        length = ca.norm_2(gap)
        along = gap / length
        rate = a.velocity - b.velocity
        change = ca.dot(along, rate)
        acceleration = ca.dot(along, a.acceleration - b.acceleration) + (ca.dot(rate, rate) - change**2) / length
        return Value(length, change, acceleration, along.T @ (a.jacobian - b.jacobian))


class Forces:
    """What the bodies of a linkage need to move as `motion` says on a base that moves too.

    `base_velocity` (6×1) is the base's spatial velocity, `base_acceleration` its spatial acceleration minus that of
    free fall, `up` and `height` as in `BodyState`. Spatial inertias of the bodies (6×6, about the base's origin and in
    its axes) may be given by name.
    """

    def __init__(
        self,
        motion: Motion,
        base_velocity: ca.SX,
        base_acceleration: ca.SX,
        up: ca.SX,
        height: ca.SX,
        inertias: dict[str, ca.SX] | None = None,
    ) -> None:
        self.motion = motion
        self._base_velocity, self._base_acceleration, self._up, self._height = (
            base_velocity, base_acceleration, up, height,
        )  # fmt: skip
        self._inertia = inertias or {
            body.name: _inertia_in_base(body, motion.frames[body.name]) for body in motion.linkage.bodies
        }
        self.load_outputs: list[ca.SX] = []
        self._loads: list[tuple[str, ca.SX, ca.SX, ca.SX]] = []
        for load in motion.linkage.loads:
            frame = motion.frames[load.body]
            rate = ca.vertcat(*(motion._dz[k] for k in motion.own[load.body]))
            state = BodyState(
                frame.rotation, frame.origin, base_velocity + frame.velocity, rate, up, height
            )  # fmt: skip
            wrench, by_velocity, by_place, outputs = load.wrench(state)
            self._loads.append((load.body, wrench, by_velocity, by_place))
            self.load_outputs.append(outputs)

    @cached_property
    def _wrenches(self) -> dict[str, ca.SX]:
        """Force vector that each body needs beyond what its loads give (6×1)."""
        result: dict[str, ca.SX] = {}
        for name, inertia in self._inertia.items():
            frame = self.motion.frames[name]
            velocity = self._base_velocity + frame.velocity
            acceleration = (
                self._base_acceleration + frame.acceleration + spatial.cross_motion(self._base_velocity, frame.velocity)
            )
            result[name] = inertia @ acceleration + spatial.cross_force(velocity, inertia @ velocity)
        for name, wrench, _, _ in self._loads:
            result[name] = result[name] - wrench
        return result

    @cached_property
    def base(self) -> ca.SX:
        """Force vector that the base must give to the linkage and its loads (6×1)."""
        return sum(self._wrenches.values(), ca.SX(6, 1))

    @cached_property
    def residual(self) -> ca.SX:
        """M z̈ - Q without constraints: generalized forces that are missing at each coordinate (n×1)."""
        motion = self.motion
        total = dict(self._wrenches)
        result = ca.SX(motion.size, 1)
        for body in reversed(motion.linkage.bodies):
            wrench = total[body.name]
            for k in motion.own[body.name]:
                result[k] += motion.columns[k].T @ wrench
            if body.parent != BASE:
                total[body.parent] = total[body.parent] + wrench
        for spring in motion.linkage.springs:
            value = motion.measure(spring.measure)
            pull = spring.preload + spring.stiffness * (value.value - spring.rest) + spring.damping * value.rate
            result += value.gradient.T * pull
        for effort in motion.linkage.efforts:
            result -= motion.measure(effort.measure).gradient.T * effort.value
        return result

    def tangent(self, rate_weight: ca.SX, place_weight: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Derivatives of the residual by accelerations, plus `rate_weight` times those by rates and `place_weight`
        times those by coordinates: by coordinates (n×n), by the base's (n×6), of the base's force vector by
        coordinates (6×n) and by the base's (6×6).

        The change of inertia with the coordinates is left out: it is smaller by the square of the step length.
        """
        motion = self.motion
        matrices = dict(self._inertia)
        for name, _, by_velocity, by_place in self._loads:
            matrices[name] = matrices[name] - rate_weight * by_velocity - place_weight * by_place
        size = motion.size
        result, by_base, of_base = ca.SX(size, size), ca.SX(size, 6), ca.SX(6, size)
        at_base = ca.SX(6, 6)
        for body in reversed(motion.linkage.bodies):
            matrix = matrices[body.name]
            chain = motion.frames[body.name].chain
            own_columns = motion.own[body.name]
            for k in reversed(own_columns):
                right = matrix @ motion.columns[k]
                left = motion.columns[k].T @ matrix
                of_base[:, k] = right
                by_base[k, :] = left
                for j in chain:
                    if j < k:
                        result[j, k] = motion.columns[j].T @ right
                        result[k, j] = left @ motion.columns[j]
                result[k, k] = motion.columns[k].T @ right
            if body.parent == BASE:
                at_base = at_base + matrix
            else:
                matrices[body.parent] = matrices[body.parent] + matrix
        for spring in motion.linkage.springs:
            gradient = motion.measure(spring.measure).gradient
            weight = rate_weight * spring.damping + place_weight * spring.stiffness
            result += weight * (gradient.T @ gradient)
        return result, by_base, of_base, at_base

    @cached_property
    def mass_matrix(self) -> ca.SX:
        """Rᵀ M̄ R of the linkage on a base at rest (n×n)."""
        size = self.motion.size
        matrix = ca.SX(size, size)
        for name, inertia in self._inertia.items():
            chain = list(self.motion.frames[name].chain)
            columns = ca.horzcat(ca.SX(6, 0), *(self.motion.columns[k] for k in chain))
            matrix[chain, chain] += columns.T @ inertia @ columns
        return matrix


def _inertia_in_base(body: Body, frame: Frame) -> ca.SX:
    """Spatial inertia (6×6) about the base's origin, in its axes."""
    turned = frame.rotation @ body.inertia @ frame.rotation.T
    return spatial.rigid_inertia(ca.SX(body.mass), frame.at(column(body.centre)), turned)


def turn(axis: ca.SX, angle: ca.SX) -> ca.SX:
    """Rotation matrix about a unit vector (Rodrigues), 3×3."""
    c, s = ca.cos(angle), ca.sin(angle)
    return c * ca.SX.eye(3) + s * spatial.skew(axis) + (1 - c) * (axis @ axis.T)
