"""Joints as data: what each lets move, given by hard points and axes in the design position.

There are no local frames to define: in the design position (all coordinates zero) the frames of all bodies coincide
with that of the base, so that points and axes are simply read off a drawing of the car.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca

Vector = ca.SX | ca.DM | Sequence[float]

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Axis:
    """One elementary movement: all joints are sequences of these.

    `direction` is a unit vector. Where `follows` is False the body's frame does not turn with the coordinate, which is
    right for bodies of revolution about this axis and keeps the angle of a wheel out of all equations. `guide` names
    the prescribed motion of an axis that is no coordinate.
    """

    turns: bool
    direction: ca.SX
    point: ca.SX
    follows: bool = True
    guide: str | None = None


@dataclass(frozen=True, eq=False)
class Revolute:
    """Turns about an axis through `point`; with `follows=False` for a body of revolution, a wheel."""

    point: Vector
    axis: Vector
    follows: bool = True

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (_turn(self.axis, self.point, self.follows),)


@dataclass(frozen=True, eq=False)
class Prismatic:
    """A joint that slides along an axis."""

    axis: Vector

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (_slide(self.axis),)


@dataclass(frozen=True, eq=False)
class Universal:
    """Turns about `first`, then about `second`, both through `point`; singular where they become parallel."""

    point: Vector
    first: Vector
    second: Vector

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (_turn(self.first, self.point), _turn(self.second, self.point))


@dataclass(frozen=True, eq=False)
class Spherical:
    """Turns about `point` by three angles about z, y, x of the moved body; singular where the second reaches 90°."""

    point: Vector

    @property
    def axes(self) -> tuple[Axis, ...]:
        return tuple(_turn(axis, self.point) for axis in (Z_AXIS, Y_AXIS, X_AXIS))


@dataclass(frozen=True, eq=False)
class Floating:
    """Moves freely: translation of `point` along x, y, z of the parent, then yaw, pitch, roll about it."""

    point: Vector = (0.0, 0.0, 0.0)

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (*(_slide(axis) for axis in (X_AXIS, Y_AXIS, Z_AXIS)), *Spherical(self.point).axes)


@dataclass(frozen=True, eq=False)
class Guided:
    """A revolute or prismatic `joint` whose motion is prescribed: `name` is that of the guide that moves it.

    It is no coordinate. Its position, speed and acceleration are inputs.
    """

    joint: Revolute | Prismatic
    name: str

    @property
    def axes(self) -> tuple[Axis, ...]:
        return tuple(replace(axis, guide=self.name) for axis in self.joint.axes)


Joint = Revolute | Prismatic | Universal | Spherical | Floating | Guided


def column(vector: Vector) -> ca.SX:
    """A 3×1 expression from whatever describes a point or an axis."""
    return ca.SX(vector) if isinstance(vector, ca.SX | ca.DM) else ca.vertcat(*(ca.SX(v) for v in vector))


def unit(vector: Vector) -> ca.SX:
    """The direction of a vector, 3×1; structural zeros stay."""
    v = column(vector)
    return v / ca.norm_2(v)


def _turn(axis: Vector, point: Vector, follows: bool = True) -> Axis:
    return Axis(True, unit(axis), column(point), follows)


def _slide(axis: Vector) -> Axis:
    return Axis(False, unit(axis), ca.SX(3, 1))
