"""A mechanism as data: bodies on joints, loop closures, springs, and what acts from outside.

A `Linkage` hangs from a base: the ground or one floating body. A `Mechanism` is a base with any number of branches,
each a linkage with its own values of the linkage's parameters. Branches touch only through the base, so that the work
grows linearly with their number, and equal branches (the left and right corner of a car) share one piece of code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca

from vsense_ros.errors import InputError
from vsense_ros.model.multibody.joints import Axis, Joint, Vector

BASE = "base"


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body on `joint` (or a sequence of joints) to its `parent`, a body before it or `BASE`.

    `centre` is its centre of gravity [m] and `inertia` its inertia tensor (3×3) [kg m²] about it, in the axes of the
    base, both in the design position; `mass` in kg.
    """

    name: str
    parent: str
    joint: Joint | tuple[Joint, ...]
    mass: ca.SX | float
    centre: Vector
    inertia: ca.SX

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Elementary movements from the parent to the body."""
        joints = self.joint if isinstance(self.joint, tuple) else (self.joint,)
        return tuple(axis for joint in joints for axis in joint.axes)


@dataclass(frozen=True, eq=False)
class Point:
    """A point fixed in a body, by its place in the design position [m]."""

    body: str
    at: Vector


@dataclass(frozen=True, eq=False)
class Coincide:
    """Two points stay together: three equations, or one for each of `directions` (fixed in the base) if given."""

    name: str
    a: Point
    b: Point
    directions: tuple[Vector, ...] | None = None


@dataclass(frozen=True, eq=False)
class Distance:
    """Two points keep the distance `length` [m], as by a rod without mass: one equation."""

    name: str
    a: Point
    b: Point
    length: ca.SX | float


@dataclass(frozen=True, eq=False)
class Perpendicular:
    """A direction fixed in a body stays at right angles to one fixed in another: one equation.

    A revolute joint that closes a loop is a `Coincide` and two of these.
    """

    name: str
    body_a: str
    direction_a: Vector
    body_b: str
    direction_b: Vector


Closure = Coincide | Distance | Perpendicular


@dataclass(frozen=True, eq=False)
class Along:
    """The only coordinate of a body's joint."""

    body: str


@dataclass(frozen=True, eq=False)
class Between:
    """The distance of two points."""

    a: Point
    b: Point


@dataclass(frozen=True, eq=False)
class Displacement:
    """How far a point has moved along `direction`, seen from the base."""

    point: Point
    direction: Vector


Measure = Along | Between | Displacement


@dataclass(frozen=True, eq=False)
class Spring:
    """A spring and damper that pull `measure` (s) down with `preload + stiffness·(s - rest) + damping·ds/dt`."""

    measure: Measure
    stiffness: ca.SX | float
    damping: ca.SX | float = 0.0
    rest: ca.SX | float = 0.0
    preload: ca.SX | float = 0.0


@dataclass(frozen=True, eq=False)
class Effort:
    """A given generalized force that pushes `measure` up [N or N m]."""

    measure: Measure
    value: ca.SX


@dataclass(frozen=True, eq=False)
class BodyState:
    """Symbols of one instant that a load may depend on, in the axes of the base.

    `rotation` (3×3) and `origin` (3×1) carry a point of the design position to where it is; `velocity` is the absolute
    spatial velocity `[ω; v]` (6×1) about the base's origin; `rate` (k×1) the rates of its own joint; `up` (3×1) the
    road's normal and `height` that of the base's origin above the road.
    """

    rotation: ca.SX
    origin: ca.SX
    velocity: ca.SX
    rate: ca.SX
    up: ca.SX
    height: ca.SX


@dataclass(frozen=True, eq=False)
class Load:
    """A force that acts on `body` from outside the mechanism.

    `wrench` turns a `BodyState` into a force vector `[n; f]` (6×1) about the base's origin and its derivatives (6×6) by
    the body's velocity and by a small displacement `[rotation; translation]`, as far as they matter for convergence.
    `outputs` names further expressions that it returns (k×1).
    """

    body: str
    wrench: Callable[[BodyState], tuple[ca.SX, ca.SX, ca.SX, ca.SX]]


def _nothing() -> ca.SX:
    return ca.SX(0, 1)


@dataclass(frozen=True, eq=False)
class Linkage:
    """Bodies with everything between them. `parameters` and `inputs` (k×1) are the symbols its data are written with.

    `exports` are measures that other branches may have as inputs.
    """

    name: str
    bodies: tuple[Body, ...]
    closures: tuple[Closure, ...] = ()
    springs: tuple[Spring, ...] = ()
    efforts: tuple[Effort, ...] = ()
    loads: tuple[Load, ...] = ()
    exports: tuple[Measure, ...] = ()
    parameters: ca.SX = field(default_factory=_nothing)
    inputs: ca.SX = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        names = {BASE}
        for body in self.bodies:
            if body.parent not in names:
                raise InputError(
                    f"linkage {self.name!r}: body {body.name!r} hangs from {body.parent!r}, which is no body before "
                    f"it; known there: {', '.join(sorted(names))}"
                )
            if body.name in names:
                raise InputError(f"linkage {self.name!r}: there are two bodies named {body.name!r}")
            names.add(body.name)
        for name in self._mentioned():
            if name not in names:
                raise InputError(f"linkage {self.name!r} mentions body {name!r}; it has {', '.join(sorted(names))}")

    def _mentioned(self) -> list[str]:
        names = [load.body for load in self.loads]
        for closure in self.closures:
            if isinstance(closure, Perpendicular):
                names += [closure.body_a, closure.body_b]
            else:
                names += [closure.a.body, closure.b.body]
        for measure in (*(s.measure for s in self.springs), *(e.measure for e in self.efforts), *self.exports):
            if isinstance(measure, Along):
                names.append(measure.body)
            elif isinstance(measure, Between):
                names += [measure.a.body, measure.b.body]
            else:
                names.append(measure.point.body)
        return names

    @cached_property
    def guides(self) -> tuple[str, ...]:
        """Names of the prescribed motions, in order of first mention."""
        return tuple(dict.fromkeys(axis.guide for body in self.bodies for axis in body.axes if axis.guide))

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """One per coordinate: the body, with a number where its joint has several."""
        names: list[str] = []
        for body in self.bodies:
            free = sum(axis.guide is None for axis in body.axes)
            names += [body.name] if free == 1 else [f"{body.name}.{i}" for i in range(free)]
        return tuple(names)

    @cached_property
    def equation_names(self) -> tuple[str, ...]:
        """The closure that each scalar constraint belongs to."""
        names: list[str] = []
        for closure in self.closures:
            count = 1
            if isinstance(closure, Coincide):
                count = 3 if closure.directions is None else len(closure.directions)
            names += [closure.name] * count
        return tuple(names)


@dataclass(frozen=True, eq=False)
class Base:
    """A floating body that everything hangs from: `mass` [kg], `centre` [m], `inertia` (3×3) [kg m²] about it.

    `load` turns its spatial velocity (6×1) into a force vector on it (6×1, body axes). `parameters` are the symbols
    these are written with.
    """

    mass: ca.SX | float
    centre: Vector
    inertia: ca.SX
    load: Callable[[ca.SX], ca.SX] | None = None
    parameters: ca.SX = field(default_factory=_nothing)


@dataclass(frozen=True)
class Link:
    """Input number `entry` of branch `to` is export number `export` of branch `source`."""

    to: int
    entry: int
    source: int
    export: int


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A base (None: the ground) and the linkages on it; equal `Linkage` objects share their code.

    Coordinates: of a floating base its position [m] and roll, pitch, yaw [rad] (6), then those of each branch.
    """

    base: Base | None
    branches: tuple[Linkage, ...]
    links: tuple[Link, ...] = ()

    @property
    def base_size(self) -> int:
        """Coordinates of the base: 6 or 0."""
        return 6 if self.base else 0

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Where the coordinates of each branch begin, and the number of all."""
        ends = [self.base_size]
        for branch in self.branches:
            ends.append(ends[-1] + len(branch.coordinate_names))
        return tuple(ends)

    @cached_property
    def equation_offsets(self) -> tuple[int, ...]:
        """Where the constraints of each branch begin, and the number of all."""
        ends = [0]
        for branch in self.branches:
            ends.append(ends[-1] + len(branch.equation_names))
        return tuple(ends)

    @property
    def coordinates(self) -> int:
        """Number of coordinates."""
        return self.offsets[-1]

    @property
    def constraints(self) -> int:
        """Number of scalar constraints."""
        return self.equation_offsets[-1]

    @property
    def bodies(self) -> int:
        """Number of bodies with mass, the base among them."""
        return sum(len(branch.bodies) for branch in self.branches) + (self.base is not None)

    @cached_property
    def linkages(self) -> tuple[Linkage, ...]:
        """The different linkages among the branches."""
        return tuple(dict.fromkeys(self.branches))

    @cached_property
    def guides(self) -> tuple[str, ...]:
        """Names of the prescribed motions of all branches; branches that mention the same one move together."""
        return tuple(dict.fromkeys(guide for branch in self.branches for guide in branch.guides))
