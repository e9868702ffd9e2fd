"""Attitudes as unit quaternions in CasADi expressions, for ⊞ and ⊟ of state spaces (Solà 2017, sections 1 and 2).

A quaternion (4,) has its scalar part first (Hamilton) and turns vectors of the body into the frame of reference. Errors
are rotations (3,) [rad] about the axes of the body: q ⊞ δ = q ⊗ exp(δ / 2).
"""

from __future__ import annotations

import casadi as ca

_SMALL = 1e-16  # square of an angle [rad²] so small that it makes no difference


def product(p: ca.SX, q: ca.SX) -> ca.SX:
    """p ⊗ q (4,), the rotation q followed, in the frame of reference, by p."""
    return ca.vertcat(
        p[0] * q[0] - ca.dot(p[1:], q[1:]),
        p[0] * q[1:] + q[0] * p[1:] + ca.cross(p[1:], q[1:]),
    )


def inverse(q: ca.SX) -> ca.SX:
    """Inverse of a unit quaternion (4,)."""
    return ca.vertcat(q[0], -q[1:])


def rotation(angles: ca.SX) -> ca.SX:
    """Quaternion (4,) of a rotation by `angles` (3,) [rad] about the axis of that vector; smooth at zero."""
    half = 0.5 * ca.sqrt(ca.dot(angles, angles) + _SMALL)
    return ca.vertcat(ca.cos(half), 0.5 * angles * ca.sin(half) / half)


def angles(q: ca.SX) -> ca.SX:
    """Rotation vector (3,) [rad] of a unit quaternion, the shorter way round; smooth at no rotation."""
    sign = ca.if_else(q[0] < 0, -1.0, 1.0)
    sine = ca.sqrt(ca.dot(q[1:], q[1:]) + _SMALL)
    return 2 * sign * ca.atan2(sine, sign * q[0]) / sine * q[1:]


def turned(q: ca.SX, vector: ca.SX) -> ca.SX:
    """A vector (3,) of the body in the frame of reference."""
    across = 2 * ca.cross(q[1:], vector)
    return vector + q[0] * across + ca.cross(q[1:], across)


def retract(q: ca.SX, delta: ca.SX) -> ca.SX:
    """q ⊞ δ (4,), of unit length whatever rounding did to `q`."""
    turned = product(q, rotation(delta))
    return turned / ca.norm_2(turned)


def difference(p: ca.SX, q: ca.SX) -> ca.SX:
    """p ⊟ q (3,) [rad]."""
    return angles(product(inverse(q), p))
