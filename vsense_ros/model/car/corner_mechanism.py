"""One corner of the car with all its bodies: links, strut, upright and wheel as a linkage, and its numbers."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.model.car.tyre_load import TyreLoad
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.multibody.assembly import assemble, check
from vsense_ros.model.multibody.joints import (
    X_AXIS,
    Y_AXIS,
    Z_AXIS,
    Guided,
    Prismatic,
    Revolute,
    Spherical,
    Universal,
    Vector,
    column,
)
from vsense_ros.model.multibody.mechanism import (
    BASE,
    Along,
    Between,
    Body,
    Closure,
    Coincide,
    Displacement,
    Effort,
    Linkage,
    Load,
    Measure,
    Point,
    Spring,
)
from vsense_ros.model.multibody.semi_recursive import Forces, Motion
from vsense_ros.model.parameter import Scalar, symbols, vector
from vsense_ros.model.schema.linkage import DoubleWishbone, Suspension
from vsense_ros.model.schema.physics import Axle

Array = NDArray[np.float64]

RACK = "rack"  # displacement of the rack, positive to the left [m]
ROD_RADIUS = 0.01  # [m] gives rods an inertia about their own line
# Torque on the wheel, force on the travel, travel of the other wheel; and of the road where the wheel stands, in road
# axes: by how much its tangent plane passes below the point under `cog` [m], and its slopes along and across [-].
CORNER_INPUTS = ("torque", "travel_force", "opposite_travel", "rise", "slope_x", "slope_y")
UPRIGHT, WHEEL = "upright", "wheel"


def _points(suspension: Suspension) -> dict[str, tuple[float, float, float]]:
    """All hard points by dotted name, from the centre of the left wheel."""
    if isinstance(suspension, DoubleWishbone):
        parts = {"lower": suspension.lower, "upper": suspension.upper}
        points = {
            f"{name}.{end}": getattr(part, end) for name, part in parts.items() for end in ("front", "rear", "outer")
        }
        points |= {f"tie_rod.{end}": getattr(suspension.tie_rod, end) for end in ("inner", "outer")}
    else:
        points = {
            f"link_{i}.{end}": getattr(link, end)
            for i, link in enumerate(suspension.links)
            for end in ("inner", "outer")
        }
    return points | {f"strut.{end}": getattr(suspension.strut, end) for end in ("upper", "lower")}


def _masses(suspension: Suspension, axle: Axle) -> dict[str, float]:
    """Mass of each body but the wheel [kg]: the upright has what the links leave of the hub's."""
    upright = axle.hub_mass - suspension.link_masses()
    if upright <= 0:
        raise InputError(
            f"the links of the {suspension.kind} have {suspension.link_masses():g} kg, but links and upright together "
            f"(hub_mass) only {axle.hub_mass:g} kg; reduce the masses of the links or correct hub_mass"
        )
    if isinstance(suspension, DoubleWishbone):
        return {
            "lower": suspension.lower.mass,
            "upper": suspension.upper.mass,
            "tie_rod": suspension.tie_rod.mass,
            "tube": suspension.strut.tube_mass,
            "rod": suspension.strut.rod_mass,
            UPRIGHT: upright,
        }
    return {f"link_{i}": link.mass for i, link in enumerate(suspension.links)} | {UPRIGHT: upright}


def _rod_inertia(mass: ca.SX, a: ca.SX, b: ca.SX) -> ca.SX:
    """Inertia tensor (3×3) of a rod between two points about its middle."""
    along = b - a
    length2 = ca.dot(along, along)
    return mass / 12 * ((length2 + 3 * ROD_RADIUS**2) * ca.SX.eye(3) - along @ along.T) + mass / 4 * ROD_RADIUS**2 * (
        along @ along.T / length2
    )


def _plate_inertia(mass: ca.SX, corners: list[ca.SX]) -> ca.SX:
    """Inertia tensor (3×3) of a thin triangle about its centre."""
    centre = sum(corners[1:], corners[0]) / 3
    spread = sum(((c - centre) @ (c - centre).T for c in corners), ca.SX(3, 3)) * (mass / 12)
    return ca.trace(spread) * ca.SX.eye(3) - spread


def _across(a: ca.SX, b: ca.SX, reference: Vector) -> tuple[ca.SX, ca.SX]:
    """Two axes at right angles to the line from a to b and to each other."""
    along = b - a
    first = ca.cross(along, column(reference))
    return first, ca.cross(along, first)


@dataclass(frozen=True, slots=True, eq=False)
class _Extra:
    """What a corner has beside its axle's parameters, hard points and masses: symbols or numbers."""

    side: Scalar  # 1 on the left, -1 on the right
    friction: Scalar  # of the road [-]
    stiffness: Scalar  # of the strut's spring [N/m]
    damping: Scalar  # of the strut [N s/m]
    preload: Scalar  # of the strut's spring in the design position [N]
    tie_rod_length: Scalar  # [m]
    gyration: Scalar  # radius of gyration of the upright [m]


_Parts = tuple[list[Body], tuple[Closure, ...], Measure]


class CornerMechanism:
    """One corner as a `Linkage`, and the numbers that belong to its symbols."""

    def __init__(self, name: str, suspension: Suspension, axle: Axle) -> None:
        self._point_names = tuple(_points(suspension))
        self._mass_names = tuple(_masses(suspension, axle))
        data, self._axle = symbols(axle, f"axle_{name}")
        points = ca.SX.sym("points", 3 * len(self._point_names))
        masses = ca.SX.sym("masses", len(self._mass_names))
        extra = ca.SX.sym("extra", len(fields(_Extra)))
        inputs = ca.SX.sym("inputs", len(CORNER_INPUTS))
        torque, travel_force, opposite_travel, *road = ca.vertsplit(inputs)
        self._points = {p: points[3 * i : 3 * i + 3] for i, p in enumerate(self._point_names)}
        self._mass = {m: masses[i] for i, m in enumerate(self._mass_names)}
        self.extra = _Extra(*ca.vertsplit(extra))
        self.centre = ca.SX.sym("centre", 3)
        self.travel = Displacement(Point(UPRIGHT, self.centre), Z_AXIS)
        if isinstance(suspension, DoubleWishbone):
            bodies, closures, strut = self._double_wishbone(suspension)
        else:
            bodies, closures, strut = self._five_link()
        self.strut = strut
        tyre = TyreLoad(self._axle, self.centre, self.extra.side, self.extra.friction, road)
        first = data.numel() + points.numel() + masses.numel()
        self._place_of_extra = slice(first, first + extra.numel())
        a, x = self._axle, self.extra
        self.linkage = Linkage(
            name=name,
            bodies=(*bodies, self._wheel()),
            closures=closures,
            springs=(
                Spring(strut, x.stiffness, x.damping, rest=self._strut_rest(), preload=x.preload),
                Spring(self.travel, a.antiroll_stiffness, rest=opposite_travel),
            ),
            efforts=(Effort(Along(WHEEL), torque), Effort(self.travel, travel_force)),
            loads=(Load(WHEEL, tyre),),
            exports=(self.travel,),
            parameters=ca.vertcat(data, points, masses, extra, self.centre),
            inputs=inputs,
        )

    def _strut_rest(self) -> ca.SX | float:
        if isinstance(self.strut, Along):
            return 0.0
        return ca.norm_2(self._points["strut.upper"] - self._points["strut.lower"])

    def _upright(self, parent: str, ball: ca.SX) -> Body:
        mass = self._mass[UPRIGHT]
        return Body(UPRIGHT, parent, Spherical(ball), mass, self.centre, mass * self.extra.gyration**2 * ca.SX.eye(3))

    def _wheel(self) -> Body:
        a = self._axle
        inertia = ca.diag(ca.vertcat(ca.SX(a.wheel_diametral_inertia), a.wheel_spin_inertia, a.wheel_diametral_inertia))
        joint = Revolute(self.centre, Y_AXIS, follows=False)
        return Body(WHEEL, UPRIGHT, joint, a.wheel_mass, self.centre, inertia)

    def _rod(self, name: str, guided: bool = False) -> Body:
        inner, outer, mass = self._points[f"{name}.inner"], self._points[f"{name}.outer"], self._mass[name]
        swing = Universal(inner, *_across(inner, outer, Z_AXIS))
        joint = (Guided(Prismatic(Y_AXIS), RACK), swing) if guided else (swing,)
        return Body(name, BASE, joint, mass, (inner + outer) / 2, _rod_inertia(mass, inner, outer))

    def _double_wishbone(self, suspension: DoubleWishbone) -> _Parts:
        p, m = self._points, self._mass
        bodies = []
        for name in ("lower", "upper"):
            front, rear, outer = (p[f"{name}.{end}"] for end in ("front", "rear", "outer"))
            centre = (front + rear + outer) / 3
            inertia = _plate_inertia(m[name], [front, rear, outer])
            bodies.append(Body(name, BASE, Revolute(front, front - rear), m[name], centre, inertia))
        top, eye = p["strut.upper"], p["strut.lower"]
        middle = (top + eye) / 2
        bodies += [
            self._upright("lower", p["lower.outer"]),
            self._rod("tie_rod", guided=suspension.steered),
            Body(
                "tube", BASE, Universal(top, *_across(top, eye, X_AXIS)), m["tube"], (top + middle) / 2,
                _rod_inertia(m["tube"], top, middle),
            ),
            Body(
                "rod", "tube", Prismatic(top - eye), m["rod"], (middle + eye) / 2, _rod_inertia(m["rod"], middle, eye)
            ),
        ]  # fmt: skip
        # A rod that is longer than the distance of its points reaches beyond the outer one.
        inner, outer = p["tie_rod.inner"], p["tie_rod.outer"]
        end = inner + (outer - inner) * (self.extra.tie_rod_length / ca.norm_2(outer - inner))
        closures = (
            Coincide("upper ball joint", Point("upper", p["upper.outer"]), Point(UPRIGHT, p["upper.outer"])),
            Coincide("tie rod", Point("tie_rod", end), Point(UPRIGHT, outer)),
            Coincide("strut", Point("rod", eye), Point("lower", eye)),
        )
        return bodies, closures, Along("rod")

    def _five_link(self) -> _Parts:
        p = self._points
        names = [f"link_{i}" for i in range(5)]
        bodies = [self._rod(name) for name in names]
        bodies.append(self._upright(names[0], p[f"{names[0]}.outer"]))
        closures = tuple(
            Coincide(name, Point(name, p[f"{name}.outer"]), Point(UPRIGHT, p[f"{name}.outer"])) for name in names[1:]
        )
        return bodies, closures, Between(Point(UPRIGHT, p["strut.lower"]), Point(BASE, p["strut.upper"]))

    def numbers(self, suspension: Suspension, axle: Axle, side: int, centre: Array, friction: float) -> Array:
        """Values of the linkage's parameters without those of the spring, which `FullCar` finds."""
        mirror = np.array([1.0, side, 1.0])
        points = [centre + mirror * np.array(p) for p in _points(suspension).values()]
        length = 1.0
        if isinstance(suspension, DoubleWishbone):
            rod = suspension.tie_rod
            length = suspension.tie_rod_length or float(np.linalg.norm(np.subtract(rod.outer, rod.inner)))
        extra = _Extra(side, friction, 0.0, 0.0, 0.0, length, suspension.gyration)
        masses = list(_masses(suspension, axle).values())
        return np.concatenate([vector(axle), *points, masses, astuple(extra), centre])

    def with_spring(self, numbers: Array, stiffness: float, damping: float, preload: float) -> Array:
        """A copy with these values of the strut's spring [N/m, N s/m, N]."""
        result = numbers.copy()
        extra = _Extra(*result[self._place_of_extra])
        result[self._place_of_extra] = astuple(replace(extra, stiffness=stiffness, damping=damping, preload=preload))
        return result

    @cached_property
    def placing(self) -> ca.Function:
        """(z, guides, parameters, travel and spin, their rates) → what is missing to them and to the constraints (n),
        the Jacobian of these (n×n), and what is missing to their rates (n) while z stands still."""
        linkage = self.linkage
        n, g = len(linkage.coordinate_names), len(linkage.guides)
        z, guides = ca.SX.sym("z", n), ca.SX.sym("guides", g, 3)
        targets, target_rates = ca.SX.sym("wanted", 2), ca.SX.sym("wanted_rates", 2)
        motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), guides)
        measures = [motion.measure(self.travel), motion.measure(Along(WHEEL))]
        return codegen.function(
            f"placing_{linkage.name}",
            [z, guides, linkage.parameters, targets, target_rates],
            [
                -ca.vertcat(
                    motion.constraint, *(m.value - w for m, w in zip(measures, ca.vertsplit(targets), strict=True))
                ),
                ca.vertcat(motion.constraint_jacobian, *(m.gradient for m in measures)),
                -ca.vertcat(
                    motion.constraint_rate,
                    *(m.rate - w for m, w in zip(measures, ca.vertsplit(target_rates), strict=True)),
                ),
            ],
            ("z", "guides", "parameters", "wanted", "wanted_rates"),
        )

    @cached_property
    def statics(self) -> ca.Function:
        """(z, guides, parameters) → ∂Φ/∂z, gradients of travel and strut, what gravity adds to the residual (n), and
        mass, first moment (3) and inertia about the origin (3×3) of all bodies."""
        linkage = self.linkage
        n, g = len(linkage.coordinate_names), len(linkage.guides)
        z, guides = ca.SX.sym("z", n), ca.SX.sym("guides", g)
        motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), ca.horzcat(guides, ca.SX(g, 2)))
        bare = Linkage(linkage.name, linkage.bodies, linkage.closures)
        still = Motion(bare, z, ca.SX(n, 1), ca.SX(n, 1), ca.horzcat(guides, ca.SX(g, 2)))
        up = ca.SX([0, 0, 0, 0, 0, GRAVITY])
        forces = Forces(still, ca.SX(6, 1), up, ca.SX([0, 0, 1]), ca.SX(0))
        total = forces.tangent(ca.SX(0), ca.SX(0))[3]
        return ca.Function(
            f"statics_{linkage.name}",
            [z, guides, linkage.parameters],
            [
                ca.densify(r)
                for r in (
                    motion.constraint_jacobian,
                    motion.measure(self.travel).gradient,
                    motion.measure(self.strut).gradient,
                    forces.residual,
                    total,
                )
            ],
        )


def with_spring(corner: CornerMechanism, numbers: Array, axle: Axle, load: float) -> tuple[Array, Array]:
    """Numbers of a corner with the spring that carries `load` [N] in the design position and has the rates at the wheel
    that the file gives; and the spatial inertia (6×6) of its bodies."""
    linkage = corner.linkage
    z, guides = assemble(linkage, numbers), np.zeros(len(linkage.guides))
    degrees = check(linkage, numbers, z, guides)
    if degrees != 2:
        raise InputError(
            f"a corner of the {linkage.name} axle has {degrees} degrees of freedom; expected are 2, travel and spin"
        )
    jacobian, travel, strut, gravity, inertia = (np.asarray(r) for r in corner.statics(z, guides, numbers))
    direction = np.linalg.svd(jacobian)[2][-2:]
    direction = direction.T @ (direction @ travel[0])  # within the free directions, the one that lifts the wheel
    if abs(travel[0] @ direction) < 1e-9:
        raise InputError(f"the {linkage.name} suspension does not let its wheel travel; check the hard points")
    direction /= travel[0] @ direction
    ratio = float(strut[0] @ direction)
    if abs(ratio) < 0.05:
        raise InputError(
            f"the strut of the {linkage.name} suspension moves by only {abs(ratio):.3f} of the wheel's travel; "
            "check its points: at least 0.05 is needed"
        )
    preload = (load - float(gravity[:, 0] @ direction)) / ratio
    stiffness, damping = axle.suspension_stiffness / ratio**2, axle.suspension_damping / ratio**2
    return corner.with_spring(numbers, stiffness, damping, preload), inertia
