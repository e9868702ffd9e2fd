"""The car with all its bodies: real linkages, struts and wheels on a floating chassis, steered by a guided rack.

With a double wishbone in front and five links at the rear it has 29 bodies and 56 coordinates, 42 constraints and so 14
degrees of freedom. Of each front corner: two wishbones, upright, tie rod, both halves of the strut, wheel (7 bodies, 11
coordinates with the wheel's spin, 9 constraints). Of each rear corner: five rods, upright, wheel (7 bodies, 14
coordinates, 12 constraints). Both corners of an axle share their code; the right one has mirrored hard points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.model import spatial
from vsense_ros.model.car.corner_mechanism import CORNER_INPUTS, WHEEL, CornerMechanism, with_spring
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import COORDINATES, POSE, RATES, SPIN, TRAVEL, VELOCITY, WHEELS, Z
from vsense_ros.model.multibody.assembly import assemble, check
from vsense_ros.model.multibody.augmented_lagrangian import base_functions
from vsense_ros.model.multibody.integrator import Integrator
from vsense_ros.model.multibody.mechanism import (
    Base,
    Link,
    Mechanism,
)
from vsense_ros.model.multibody.outside import Outside, OutsideIntegrator
from vsense_ros.model.multibody.semi_recursive import Motion
from vsense_ros.model.schema.linkage import Linkages
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

PLACING = 4  # iterations that put a linkage to a given travel
# Numbers of the chassis: what air and inertia make of it, centre and inertia tensor in its own axes.
CHASSIS = ("drag_area", "mass", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")


@dataclass(frozen=True)
class Counts:
    """Numbers of bodies, coordinates and constraints of a full car."""

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
            CornerMechanism("front", linkages.front, physics.front),
            CornerMechanism("rear", linkages.rear, physics.rear),
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
            opposite_arm = (chassis.cog_to_rear_axle, chassis.cog_to_front_axle)[axle]
            load = weight * opposite_arm / wheelbase / 2
            along = (chassis.cog_to_front_axle, -chassis.cog_to_rear_axle)[axle]
            for side in (1, -1):
                height = data.unloaded_radius - load / data.tyre_stiffness - chassis.cog_height
                centre = np.array([along, side * data.track / 2, height])
                bare = corner.numbers(suspension, data, side, centre, physics.road.friction)
                numbers, inertia = with_spring(corner, bare, data, load)
                corners.append(numbers)
                total += inertia
        of_whole_car = np.zeros((6, 6))
        of_whole_car[:3, :3] = np.diag([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        of_whole_car[3:, 3:] = chassis.mass * np.eye(3)
        of_chassis = of_whole_car - total  # the file describes the whole car; the chassis is what its corners leave
        mass = of_chassis[5, 5]
        # The upper right block is m·skew(c).
        centre = np.array([of_chassis[2, 4], of_chassis[0, 5], of_chassis[1, 3]]) / mass
        about_own_centre = of_chassis[:3, :3] + mass * _skew(centre) @ _skew(centre)
        if mass <= 0 or np.linalg.eigvalsh(about_own_centre)[0] <= 0:
            raise InputError(
                f"the linkages and wheels of {vehicle.name!r} leave the chassis {mass:.4g} kg and principal moments of "
                f"inertia {np.linalg.eigvalsh(about_own_centre).round(1).tolist()} kg m²; both must be positive. Mass "
                "and inertia in the file are those of the whole car"
            )
        products = about_own_centre[[0, 0, 1], [1, 2, 2]]
        base = np.concatenate([[physics.aerodynamics.drag_area, mass], centre, np.diag(about_own_centre), products])
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
        arguments = (self.mechanism, self.parameters(vehicle), h, tolerance, "full_car")
        integrator = Integrator(*arguments) if outside is None else OutsideIntegrator(*arguments, outside=outside)
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
            rows_of_branch = slice(mechanism.offsets[i], mechanism.offsets[i + 1])
            rows = [mechanism.guides.index(guide) for guide in linkage.guides]
            coordinates = (z[rows_of_branch], dz[rows_of_branch], ddz[rows_of_branch])
            motion = Motion(linkage, *coordinates, guides[rows, :] if rows else ca.SX(0, 3))
            travel = motion.measure(self.corners[i // 2].travel)
            values = ca.vertcat(travel.value, travel.rate, travel.acceleration)
            numbers = ca.Function("travel", [*coordinates, guides, linkage.parameters], [values])
            travels.append(numbers(*coordinates, guides, parameters[int(ends[i]) : int(ends[i + 1])]))
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
            coordinates = z[mechanism.offsets[i] : mechanism.offsets[i + 1]]
            rows = [mechanism.guides.index(guide) for guide in linkage.guides]
            moved = guides[rows, :] if rows else ca.MX(0, 3)
            numbers = parameters[int(ends[i]) : int(ends[i + 1])]
            targets, target_rates = (ca.vertcat(moving[TRAVEL][i], moving[SPIN][i]) for moving in (q, u))
            for _ in range(PLACING):
                gap, matrix, _ = equations[linkage](coordinates, moved, numbers, targets, target_rates)
                coordinates = coordinates + ca.solve(matrix, gap, "qr")
                missing = ca.norm_2(gap)
            violation += missing
            _, matrix, gap = equations[linkage](coordinates, moved, numbers, targets, target_rates)
            places.append(coordinates)
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
