"""Spatial vector algebra on CasADi expressions.

Motion vectors are `[ω; v]` and force vectors `[n; f]`, 6×1, both about and in the axes of a body's own frame
(Featherstone 2008, chapter 2). Expressions with structural zeros keep them, which is what makes the generated code
short.
"""

from __future__ import annotations

import casadi as ca

ANGULAR, LINEAR = slice(0, 3), slice(3, 6)  # parts of a spatial vector


def skew(r: ca.SX) -> ca.SX:
    """Matrix of the cross product, `skew(r) @ w == cross(r, w)`, 3×3."""
    return ca.vertcat(
        ca.horzcat(0, -r[2], r[1]),
        ca.horzcat(r[2], 0, -r[0]),
        ca.horzcat(-r[1], r[0], 0),
    )


def rotation_x(angle: ca.SX) -> ca.SX:
    """Turns the components of a vector in the turned frame into those in the fixed frame, 3×3."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, c, -s), ca.horzcat(0, s, c))


def rotation_y(angle: ca.SX) -> ca.SX:
    """As `rotation_x`, about y."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def rotation_z(angle: ca.SX) -> ca.SX:
    """As `rotation_x`, about z."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def rotation_rpy(roll: ca.SX, pitch: ca.SX, yaw: ca.SX) -> ca.SX:
    """Body to fixed frame for intrinsic z-y-x angles (ISO 8855: yaw, pitch, roll), 3×3."""
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def motion_transform(rotation: ca.SX, position: ca.SX) -> ca.SX:
    """Parent's motion vectors to the child's frame, 6×6.

    `rotation` (3×3) turns child components into the parent's, `position` (3×1) is the child's origin in the parent.
    Its transpose carries forces from the child to the parent.
    """
    to_child = rotation.T
    return ca.vertcat(
        ca.horzcat(to_child, ca.SX(3, 3)),
        ca.horzcat(-to_child @ skew(position), to_child),
    )


def cross_motion(v: ca.SX, m: ca.SX) -> ca.SX:
    """Rate of change of a motion vector `m` fixed in a frame that moves with `v`, 6×1."""
    return ca.vertcat(ca.cross(v[:3], m[:3]), ca.cross(v[3:], m[:3]) + ca.cross(v[:3], m[3:]))


def cross_force(v: ca.SX, f: ca.SX) -> ca.SX:
    """Rate of change of a force vector `f` fixed in a frame that moves with `v`, 6×1."""
    return ca.vertcat(ca.cross(v[:3], f[:3]) + ca.cross(v[3:], f[3:]), ca.cross(v[:3], f[3:]))


def rigid_inertia(mass: ca.SX | float, centre: ca.SX, inertia: ca.SX) -> ca.SX:
    """Spatial inertia 6×6 of a body of `mass` [kg] with centre of gravity at `centre` (3×1) [m] and the inertia
    tensor `inertia` (3×3) [kg m²] about that centre."""
    c = skew(centre)
    return ca.vertcat(
        ca.horzcat(inertia - mass * (c @ c), mass * c),
        ca.horzcat(-mass * c, mass * ca.SX.eye(3)),
    )


def force_at(point: ca.SX, force: ca.SX, moment: ca.SX | float = 0) -> ca.SX:
    """Force vector about the origin of a `force` (3×1) that acts at `point` (3×1), plus a free `moment` (3×1)."""
    return ca.vertcat(ca.cross(point, force) + moment, force)
