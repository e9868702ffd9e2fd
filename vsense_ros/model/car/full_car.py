"""The car with all its bodies: real linkages, struts and wheels on a floating chassis, steered by a guided rack.

With a double wishbone in front and five links at the rear it has 29 bodies and 56 coordinates, 42 constraints and so 14
degrees of freedom. Of each front corner: two wishbones, upright, tie rod, both halves of the strut, wheel (7 bodies, 11
coordinates with the wheel's spin, 9 constraints). Of each rear corner: five rods, upright, wheel (7 bodies, 14
coordinates, 12 constraints). Both corners of an axle share their code; the right one has mirrored hard points.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, replace
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.model import spatial
from vsense_ros.model.car.tyre_contacts import wheel_outputs
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.contact import Contact, contact
from vsense_ros.model.coordinates import COORDINATES, POSE, RATES, SPIN, TRAVEL, VELOCITY, WHEELS, Z
from vsense_ros.model.multibody.assembly import assemble, check
from vsense_ros.model.multibody.augmented_lagrangian import Integrator, base_functions
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
    Base,
    Between,
    Body,
    BodyState,
    Closure,
    Coincide,
    Displacement,
    Effort,
    Link,
    Linkage,
    Load,
    Measure,
    Mechanism,
    Point,
    Spring,
)
from vsense_ros.model.multibody.outside import Outside, OutsideIntegrator
from vsense_ros.model.multibody.semi_recursive import Forces, Motion
from vsense_ros.model.parameter import Scalar, symbols, vector
from vsense_ros.model.schema.linkage import DoubleWishbone, Linkages, Suspension
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.tyres import TyreForces, TyreInput
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

RACK = "rack"  # displacement of the rack, positive to the left [m]
ROD_RADIUS = 0.01  # [m] gives rods an inertia about their own line
PLACING = 4  # iterations that put a linkage to a given travel
# Numbers of the chassis: what air and inertia make of it, centre and inertia tensor in its own axes.
CHASSIS = ("drag_area", "mass", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")
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


class Corner:
    """One corner as a `Linkage`, and the numbers that belong to its symbols."""

    def __init__(self, name: str, suspension: Suspension, axle: Axle) -> None:
        self.suspension_type = type(suspension)
        self._point_names = tuple(_points(suspension))
        self._mass_names = tuple(_masses(suspension, axle))
        data, self._axle = symbols(axle, f"axle_{name}")
        points = ca.SX.sym("points", 3 * len(self._point_names))
        masses = ca.SX.sym("masses", len(self._mass_names))
        extra = ca.SX.sym("extra", len(fields(_Extra)))
        inputs = ca.SX.sym("inputs", len(CORNER_INPUTS))
        torque, travel_force, opposite_travel, *self._road = ca.vertsplit(inputs)
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
            loads=(Load(WHEEL, self._tyre_load),),
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

    def _tyre_load(self, state: BodyState) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Tyre on the tangent plane of the road below it: force vector, its main derivatives, `WHEEL_OUTPUTS`."""
        a = self._axle
        normal, height = self._road_under(state.up, state.height)
        centre = state.origin + state.rotation @ self.centre
        axle = state.rotation[:, 1]
        spin = ca.vertcat(axle, ca.cross(centre, axle))
        carrier = state.velocity - spin * state.rate
        touch = contact(
            a,
            a.unloaded_radius,
            centre,
            axle,
            normal,
            height,
            lambda point: carrier[3:] + ca.cross(carrier[:3], point),
        )
        slips = ca.SX.sym("slips", 4)  # load, speed x, speed y, rolling speed
        camber = ca.SX.sym("camber")
        found = a.tyre.forces(
            TyreInput(
                load=slips[0],
                speed_x=slips[1],
                speed_y=slips[2] * a.cornering_scale,
                rolling_speed=slips[3] + (a.longitudinal_scale - 1) * (slips[3] - slips[1]),
                friction=self.extra.friction * a.grip_scale,
                camber=camber,
                side=self.extra.side,
            )
        )
        result = ca.vertcat(*found)
        parameters = ca.vertcat(*(s for s in ca.symvar(result) if not ca.depends_on(ca.vertcat(slips, camber), s)))
        tyre = ca.Function("tyre", [slips, camber, parameters], [result, ca.jacobian(result[:3], slips)])
        rolling = touch.effective_radius * state.rate
        here = ca.vertcat(touch.load, touch.speed_x, touch.speed_y, rolling)
        values, slopes = tyre(here, touch.inclination, parameters)
        forces = TyreForces(*ca.vertsplit(values))
        force = forces.longitudinal * touch.ahead + forces.lateral * touch.sideways + touch.load * touch.normal
        moment = forces.aligning_moment * touch.normal + touch.rolling_resistance(a, rolling) * axle
        wrench = spatial.force_at(touch.point, force, moment)
        by_velocity, by_place = _tangents(a, touch, centre, axle, slopes)
        return wrench, by_velocity, by_place, wheel_outputs(forces, touch)

    def _road_under(self, up: ca.SX, height: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Normal of the road below the wheel (3), in the axes of the chassis, in which `up` is that below `cog`, and
        how high `cog` is over the tangent plane there [m]."""
        rise, slope_x, slope_y = self._road
        level = ca.sqrt(1 - up[0] ** 2)
        ahead = ca.vertcat(level, -up[0] * up[1] / level, -up[0] * up[2] / level)
        steepness = ca.sqrt(1 + slope_x**2 + slope_y**2)
        normal = (up - slope_x * ahead - slope_y * ca.cross(up, ahead)) / steepness
        return normal, (height + rise) / steepness

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
        wanted, wanted_rates = ca.SX.sym("wanted", 2), ca.SX.sym("wanted_rates", 2)
        motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), guides)
        measures = [motion.measure(self.travel), motion.measure(Along(WHEEL))]
        return codegen.function(
            f"placing_{linkage.name}",
            [z, guides, linkage.parameters, wanted, wanted_rates],
            [
                -ca.vertcat(
                    motion.constraint, *(m.value - w for m, w in zip(measures, ca.vertsplit(wanted), strict=True))
                ),
                ca.vertcat(motion.constraint_jacobian, *(m.gradient for m in measures)),
                -ca.vertcat(
                    motion.constraint_rate,
                    *(m.rate - w for m, w in zip(measures, ca.vertsplit(wanted_rates), strict=True)),
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


def _tangents(a: Axle, touch: Contact, centre: ca.SX, axle: ca.SX, slopes: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Derivatives (6×6) of a tyre's force vector by the velocity and by a small displacement of its wheel."""

    def row(direction: ca.SX) -> ca.SX:
        """Velocity of the contact point in a direction, per velocity of the wheel without its spin (1×6)."""
        spin = ca.dot(direction, ca.cross(axle, touch.point - centre))
        return ca.horzcat(ca.cross(touch.point, direction).T - spin * axle.T, direction.T)

    lifting = row(touch.normal)
    rolling = ca.horzcat(touch.effective_radius * axle.T, ca.SX(1, 3))
    pressed = ca.if_else(touch.load > 0, 1, 0)
    by_speeds = ca.vertcat(-pressed * a.tyre_damping * lifting, row(touch.ahead), row(touch.sideways), rolling)
    by_lift = -pressed * a.tyre_stiffness * lifting
    forces = ca.horzcat(
        spatial.force_at(touch.point, touch.ahead, ca.SX(3, 1)),
        spatial.force_at(touch.point, touch.sideways, ca.SX(3, 1)),
        ca.vertcat(touch.normal, ca.SX(3, 1)),
    )
    normal = spatial.force_at(touch.point, touch.normal, ca.SX(3, 1))
    by_velocity = forces @ (slopes @ by_speeds) + normal @ by_speeds[0, :]
    by_place = forces @ (slopes[:, 0] @ by_lift) + normal @ by_lift
    return by_velocity, by_place


@dataclass(frozen=True)
class Counts:
    """Size of a full car."""

    bodies: int
    coordinates: int
    constraints: int
    degrees_of_freedom: int


class FullCar:
    """The full car of a vehicle that has a `linkage` section.

    `mechanism` is its description, with corners fl, fr, rl, rr; `parameters(vehicle)` the numbers that belong to it,
    also for other vehicles of the same structure.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        linkages = _linkages(vehicle)
        physics = vehicle.physics
        self.corners = (
            Corner("front", linkages.front, physics.front),
            Corner("rear", linkages.rear, physics.rear),
        )
        p = ca.SX.sym("chassis", len(CHASSIS))
        drag_area, mass, x, y, z, xx, yy, zz, xy, xz, yz = ca.vertsplit(p)
        inertia = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
        drag = 0.5 * AIR_DENSITY * drag_area

        def air(velocity: ca.SX) -> ca.SX:
            speed = velocity[spatial.LINEAR][0]
            return ca.vertcat(ca.SX(3, 1), -drag * speed * ca.fabs(speed), ca.SX(2, 1))

        front, rear = (corner.linkage for corner in self.corners)
        opposite = CORNER_INPUTS.index("opposite_travel")
        self.mechanism = Mechanism(
            base=Base(mass, ca.vertcat(x, y, z), inertia, air, p),
            branches=(front, front, rear, rear),
            links=tuple(Link(i, opposite, i + 1 - 2 * (i % 2), 0) for i in range(4)),
        )

    def parameters(self, vehicle: Vehicle) -> Array:
        """Numbers of the chassis, then of each corner. Raises `InputError` where a linkage does not close, or where
        something of it cannot be."""
        physics, linkages = vehicle.physics, _linkages(vehicle)
        chassis = physics.chassis
        weight = chassis.mass * GRAVITY
        wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
        corners = []
        total = np.zeros((6, 6))
        for axle in range(2):
            corner = self.corners[axle]
            suspension = (linkages.front, linkages.rear)[axle]
            data = (physics.front, physics.rear)[axle]
            other = (chassis.cog_to_rear_axle, chassis.cog_to_front_axle)[axle]
            load = weight * other / wheelbase / 2
            along = (chassis.cog_to_front_axle, -chassis.cog_to_rear_axle)[axle]
            for side in (1, -1):
                height = data.unloaded_radius - load / data.tyre_stiffness - chassis.cog_height
                centre = np.array([along, side * data.track / 2, height])
                bare = corner.numbers(suspension, data, side, centre, physics.road.friction)
                numbers, inertia = _with_spring(corner, bare, data, load)
                corners.append(numbers)
                total += inertia
        whole = np.zeros((6, 6))
        whole[:3, :3] = np.diag([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        whole[3:, 3:] = chassis.mass * np.eye(3)
        left = whole - total  # the file describes the whole car; the chassis is what its corners leave
        mass = left[5, 5]
        centre = np.array([left[2, 4], left[0, 5], left[1, 3]]) / mass  # of m·skew(c), upper right block
        own = left[:3, :3] + mass * _skew(centre) @ _skew(centre)
        if mass <= 0 or np.linalg.eigvalsh(own)[0] <= 0:
            raise InputError(
                f"the linkages and wheels of {vehicle.name!r} leave the chassis {mass:.4g} kg and principal moments of "
                f"inertia {np.linalg.eigvalsh(own).round(1).tolist()} kg m²; both must be positive. Mass and inertia "
                "in the file are those of the whole car"
            )
        products = own[[0, 0, 1], [1, 2, 2]]
        base = np.concatenate([[physics.aerodynamics.drag_area, mass], centre, np.diag(own), products])
        return np.concatenate([base, *corners])

    def corner_parameters(self, parameters: Array) -> list[Array]:
        """The part of `parameters` that belongs to each corner."""
        ends = np.cumsum([len(CHASSIS), *(b.parameters.numel() for b in self.mechanism.branches)])
        return [parameters[a:b] for a, b in pairwise(ends)]

    def counts(self, parameters: Array, rack: float = 0.0) -> Counts:
        """Bodies, coordinates, constraints, and degrees of freedom by the rank of the constraints."""
        free = self.mechanism.base_size
        for linkage, numbers in zip(self.mechanism.branches, self.corner_parameters(parameters), strict=True):
            guides = np.full(len(linkage.guides), rack)
            free += check(linkage, numbers, assemble(linkage, numbers, guides=guides), guides)
        mechanism = self.mechanism
        return Counts(mechanism.bodies, mechanism.coordinates, mechanism.constraints, free)

    def integrator(
        self, vehicle: Vehicle, h: float, tolerance: float = 1e-9, outside: Outside | None = None
    ) -> Integrator:
        """The car at rest in its design position, wheels on level ground, ready to step by `h` [s]; its systems are
        solved `outside`, if there is something."""
        made = (self.mechanism, self.parameters(vehicle), h, tolerance, "full_car")
        integrator = Integrator(*made) if outside is None else OutsideIntegrator(*made, outside=outside)
        parameters = integrator.parameters
        z = integrator.state.z
        z[Z] = vehicle.physics.chassis.cog_height
        offsets = self.mechanism.offsets
        corners = self.corner_parameters(parameters)
        for i, (linkage, numbers) in enumerate(zip(self.mechanism.branches, corners, strict=True)):
            z[offsets[i] : offsets[i + 1]] = assemble(linkage, numbers)
        integrator.settle()
        return integrator

    def motion_function(self) -> ca.Function:
        """(z, dz, ddz, guides, parameters) → q, u and the derivatives of u (14 each), as those of the simplified car.

        Its suspension compression is here the height of the wheel centre over its design position on the chassis.
        """
        mechanism = self.mechanism
        n = mechanism.coordinates
        z, dz, ddz = (ca.SX.sym(name, n) for name in ("z", "dz", "ddz"))
        guides = ca.SX.sym("guides", len(mechanism.guides), 3)
        ends = np.cumsum([len(CHASSIS), *(b.parameters.numel() for b in mechanism.branches)])
        parameters = ca.SX.sym("parameters", int(ends[-1]))
        state, _ = base_functions(mechanism)
        nothing = ca.SX(3, 1)
        velocity, acceleration, *_ = state(
            z[POSE], dz[POSE], ddz[POSE], nothing, ca.SX(6, 1), parameters[: len(CHASSIS)], 1.0
        )
        travels, spins = [], []
        for i, linkage in enumerate(mechanism.branches):
            here = slice(mechanism.offsets[i], mechanism.offsets[i + 1])
            rows = [mechanism.guides.index(guide) for guide in linkage.guides]
            own = (z[here], dz[here], ddz[here])
            motion = Motion(linkage, *own, guides[rows, :] if rows else ca.SX(0, 3))
            travel = motion.measure(self.corners[i // 2].travel)
            values = ca.vertcat(travel.value, travel.rate, travel.acceleration)
            numbers = ca.Function("travel", [*own, guides, linkage.parameters], [values])
            travels.append(numbers(*own, guides, parameters[int(ends[i]) : int(ends[i + 1])]))
            k = self.spin_index(WHEELS[i])
            spins.append(ca.vertcat(z[k], dz[k], ddz[k]))
        travel_x, spin_x = ca.horzcat(*travels), ca.horzcat(*spins)
        results = [
            ca.vertcat(first, travel_x[i, :].T, spin_x[i, :].T)
            for i, first in enumerate((z[POSE], _as_velocity(velocity), _as_velocity(acceleration)))
        ]
        return codegen.function(
            "full_car_motion", [z, dz, ddz, guides, parameters], results, ("z", "dz", "ddz", "guides", "parameters")
        )

    def placing_function(self) -> ca.Function:
        """(z, guides, parameters, q, u) → z, dz of the full car that has the 14 coordinates and velocities q and u of
        the simplified one, from a z nearby; and how much was missing before the last iteration."""
        mechanism = self.mechanism
        ends = np.cumsum([len(CHASSIS), *(b.parameters.numel() for b in mechanism.branches)])
        z, q, u = ca.MX.sym("z", mechanism.coordinates), ca.MX.sym("q", COORDINATES), ca.MX.sym("u", COORDINATES)
        guides = ca.MX.sym("guides", len(mechanism.guides), 3)
        parameters = ca.MX.sym("parameters", int(ends[-1]))
        equations = {corner.linkage: corner.placing for corner in self.corners}
        _, base_rates = base_functions(mechanism)
        places, rates = [q[POSE]], [base_rates(q[POSE]) @ ca.vertcat(u[RATES], u[VELOCITY])]
        violation = ca.MX(0)
        for i, linkage in enumerate(mechanism.branches):
            own = z[mechanism.offsets[i] : mechanism.offsets[i + 1]]
            rows = [mechanism.guides.index(guide) for guide in linkage.guides]
            moved = guides[rows, :] if rows else ca.MX(0, 3)
            numbers = parameters[int(ends[i]) : int(ends[i + 1])]
            wanted, wanted_rates = (ca.vertcat(moving[TRAVEL][i], moving[SPIN][i]) for moving in (q, u))
            for _ in range(PLACING):
                gap, matrix, _ = equations[linkage](own, moved, numbers, wanted, wanted_rates)
                own = own + ca.solve(matrix, gap, "qr")
                missing = ca.norm_2(gap)
            violation += missing
            _, matrix, gap = equations[linkage](own, moved, numbers, wanted, wanted_rates)
            places.append(own)
            rates.append(ca.solve(matrix, gap, "qr"))
        return ca.Function(
            "full_car_place",
            [z, guides, parameters, q, u],
            [ca.vertcat(*places), ca.vertcat(*rates), violation],
            ["z", "guides", "parameters", "q", "u"],
            ["z_placed", "dz", "violation"],
        )

    def input_index(self, wheel: str, name: str) -> int:
        """Where an input of a corner stands in `Integrator.inputs`; names are those of `CORNER_INPUTS`."""
        return WHEELS.index(wheel) * len(CORNER_INPUTS) + CORNER_INPUTS.index(name)

    def spin_index(self, wheel: str) -> int:
        """The coordinate of a wheel's spin."""
        i = WHEELS.index(wheel)
        return self.mechanism.offsets[i] + self.mechanism.branches[i].coordinate_names.index(WHEEL)


def _with_spring(corner: Corner, numbers: Array, axle: Axle, load: float) -> tuple[Array, Array]:
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


def _linkages(vehicle: Vehicle) -> Linkages:
    if vehicle.linkage is None:
        raise InputError(
            f"vehicle {vehicle.name!r} has no section `linkage`, which the full car is made from: give hard points for "
            "`linkage.front` and `linkage.rear`"
        )
    return vehicle.linkage


def _as_velocity(spatial_vector: ca.SX) -> ca.SX:
    """Linear before angular (6), as the velocities of the simplified car have it."""
    return ca.vertcat(spatial_vector[spatial.LINEAR], spatial_vector[spatial.ANGULAR])


def _skew(r: Array) -> Array:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
