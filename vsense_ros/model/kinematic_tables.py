"""Suspension kinematics as smooth tables, made from the linkage of the full car.

A table gives, for the left wheel of an axle, the place of its centre and the direction of its axle against travel and
rack: cubic splines through positions that the linkage was solved for. The right wheel is the mirror image: the same
table at the negative rack, with y, camber's and toe's sense mirrored by `Table.right`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.model.full_car import RACK, UPRIGHT, Corner, FullCar
from vsense_ros.model.multibody.assembly import assemble
from vsense_ros.model.multibody.semi_recursive import Motion
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

COLUMNS = ("x", "y", "z", "camber", "toe", "caster")
TRAVELS, RACKS = 25, 25  # grid points


@dataclass(frozen=True, eq=False)
class Table:
    """Wheel kinematics of the left wheel of one axle.

    `travel` (n,) [m] is the height of the wheel centre over its design position, seen from the chassis, positive in
    bump; `rack` (k,) [m] the displacement of the rack to the left, one zero for an axle that is not steered; `values`
    (n×k×6) are `COLUMNS`: the wheel centre's place from its design position in the axes of the vehicle [m]; camber, the
    angle by which the wheel's top leans outwards; toe, the angle by which its front points to the left; caster, the
    angle by which the upright has turned about the axle since the design position, its top rearwards [rad].
    """

    axle: str
    travel: Array
    rack: Array
    values: Array

    @cached_property
    def function(self) -> ca.Function:
        """(travel, rack) → values (6×1) by cubic splines; beyond the grid it continues as a polynomial, so ask
        `within` first."""
        travel, rack = ca.MX.sym("travel"), ca.MX.sym("rack")
        results = []
        for i, name in enumerate(COLUMNS):
            flat = self.values[:, :, i].ravel(order="F")
            if len(self.rack) == 1:
                spline = ca.interpolant(name, "bspline", [self.travel.tolist()], flat.tolist())
                results.append(spline(travel))
            else:
                spline = ca.interpolant(name, "bspline", [self.travel.tolist(), self.rack.tolist()], flat.tolist())
                results.append(spline(ca.vertcat(travel, rack)))
        return ca.Function(
            f"kinematics_{self.axle}", [travel, rack], [ca.vertcat(*results)], ["travel", "rack"], ["values"]
        )

    def within(self, travel: float, rack: float = 0.0) -> None:
        """Raises `InputError` for a place outside the table: beyond the stops of the suspension or the rack."""
        checks = [("travel", travel, self.travel)]
        if len(self.rack) > 1:
            checks.append(("rack", rack, self.rack))
        for name, value, grid in checks:
            if not grid[0] <= value <= grid[-1]:
                raise InputError(
                    f"{name} {1e3 * value:.4g} mm is outside the table of the {self.axle} axle, which reaches from "
                    f"{1e3 * grid[0]:.4g} to {1e3 * grid[-1]:.4g} mm (its stops); make the table with wider limits"
                )

    def left(self, travel: float, rack: float = 0.0) -> Array:
        """Values (6,) of the left wheel. Raises `InputError` outside the table."""
        self.within(travel, rack)
        return np.asarray(self.function(travel, rack)).reshape(-1)

    def right(self, travel: float, rack: float = 0.0) -> Array:
        """Values (6,) of the right wheel, in the axes of the vehicle; camber is outwards there too."""
        self.within(travel, -rack)
        return np.asarray(self.function(travel, -rack)).reshape(-1) * np.array([1, -1, 1, 1, -1, 1])


@dataclass(frozen=True, eq=False)
class Tables:
    """Tables of both axles."""

    front: Table
    rear: Table

    @cached_property
    def _steering(self) -> tuple[ca.Function, float]:
        """(angle, rate, acceleration) → the rack's (3×1), and the largest angle; at the design height of the wheels."""
        table = self.front
        angles = [float(self.mean_angle(rack)) for rack in table.rack]
        order = np.argsort(angles)
        if len(angles) < 2 or np.any(np.diff(np.array(angles)[order]) <= 0) or not np.all(np.abs(np.diff(order)) == 1):
            raise InputError(
                f"the wheels of the {table.axle} axle do not turn steadily with the rack within the table; make it "
                "with a smaller rack travel, or check the hard points of the tie rod"
            )
        # Newton on the table itself, from a straight line: smooth, and exact where the table is.
        angle, rate, acceleration = (ca.MX.sym(name) for name in ("angle", "rate", "acceleration"))
        x = ca.MX.sym("x")
        mean = self._mean(x)
        slope = ca.jacobian(mean, x)
        curve = ca.Function("curve", [x], [mean, slope, ca.jacobian(slope, x)])
        rack = angle * (table.rack[-1] - table.rack[0]) / (angles[-1] - angles[0])
        for _ in range(6):
            found, steepness, _ = curve(rack)
            rack = rack - (found - angle) / steepness
        _, steepness, bend = curve(rack)
        speed = rate / steepness
        motion = ca.vertcat(rack, speed, (acceleration - bend * speed**2) / steepness)
        limit = min(abs(angles[0]), abs(angles[-1]))
        return ca.Function(
            "rack", [angle, rate, acceleration], [motion], ["angle", "rate", "acceleration"], ["rack"]
        ), limit

    def _mean(self, rack: ca.MX) -> ca.MX:
        toe = COLUMNS.index("toe")
        return (self.front.function(0, rack)[toe] - self.front.function(0, -rack)[toe]) / 2

    def mean_angle(self, rack: float) -> float:
        """Mean steering angle of both front wheels at design height [rad], positive to the left."""
        return float(self.front.left(0.0, rack)[4] + self.front.right(0.0, rack)[4]) / 2

    def rack_motion(self, angle: float, rate: float = 0.0, acceleration: float = 0.0) -> Array:
        """Displacement, speed and acceleration (3,) of the rack for a mean steering angle of the front wheels at design
        height and its derivatives [rad, rad/s, rad/s²]. Raises `InputError` beyond what the rack can do."""
        function, limit = self._steering
        if not abs(angle) <= limit:
            raise InputError(
                f"a mean steering angle of {np.degrees(angle):.4g}° is more than the rack's ±{np.degrees(limit):.4g}°"
            )
        return np.asarray(function(angle, rate, acceleration)).reshape(-1)


def kinematic_tables(
    vehicle: Vehicle,
    bump: float = 0.06,
    rebound: float = 0.06,
    rack: float = 0.04,
    grid: tuple[int, int] = (TRAVELS, RACKS),
) -> Tables:
    """Tables of a vehicle with a `linkage` section, for travels from `-rebound` to `bump` and the rack within ±`rack`,
    all in m. Raises `InputError` where the linkage does not reach that far."""
    for name, value in (("bump", bump), ("rebound", rebound), ("rack", rack)):
        if not 0 < value < 1:
            raise InputError(f"{name} must be a length between 0 and 1 m, found {value:g}")
    car = FullCar(vehicle)
    numbers = car.corner_parameters(car.parameters(vehicle))
    travels = np.linspace(-rebound, bump, grid[0])
    racks = np.linspace(-rack, rack, grid[1] | 1)
    tables = []
    for corner, own in zip(car.corners, (numbers[0], numbers[2]), strict=True):
        steered = bool(corner.linkage.guides)
        tables.append(_table(corner, own, travels, racks if steered else np.zeros(1)))
    return Tables(*tables)


def _table(corner: Corner, numbers: Array, travels: Array, racks: Array) -> Table:
    linkage = corner.linkage
    solve = WheelPosition(corner, numbers)
    values = np.empty((len(travels), len(racks), len(COLUMNS)))
    start = int(np.argmin(np.abs(travels)))
    design = assemble(linkage, numbers)
    across = int(np.argmin(np.abs(racks)))
    for side in (range(across, len(racks)), range(across - 1, -1, -1)):
        middle = design
        for k in side:
            middle = solve.coordinates(travels[start], racks[k], middle)
            for direction in (range(start, len(travels)), range(start - 1, -1, -1)):
                z = middle
                for i in direction:
                    z = solve.coordinates(travels[i], racks[k], z)
                    values[i, k] = solve.values(z, racks[k])
    return Table(linkage.name, travels, racks, values)


class WheelPosition:
    """Where the linkage of a corner holds its wheel: solves the closures together with the travel."""

    def __init__(self, corner: Corner, numbers: Array) -> None:
        linkage = corner.linkage
        self._linkage, self._numbers = linkage, numbers
        n, g = len(linkage.coordinate_names), len(linkage.guides)
        z, guides, travel = ca.SX.sym("z", n), ca.SX.sym("guides", g), ca.SX.sym("travel")
        motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), ca.horzcat(guides, ca.SX(g, 2)))
        measured = motion.measure(corner.travel)
        arguments = [z, guides, linkage.parameters]
        self._equations = ca.Function(
            "equations",
            [*arguments, travel],
            [
                ca.densify(ca.vertcat(motion.constraint, measured.value - travel)),
                ca.densify(ca.vertcat(motion.constraint_jacobian, measured.gradient)),
            ],
        )
        frame = motion.frames[UPRIGHT]
        centre = linkage.parameters[-3:]
        moved = frame.at(centre) - centre
        axle = frame.rotation[:, 1]
        upward = frame.rotation[:, 2]
        side = linkage.parameters[-10]
        # The upright's own vertical, turned about the axle from the vertical plane through it.
        level = ca.cross(ca.SX([0, 0, 1]), axle)
        level = -level / ca.norm_2(level)  # forwards, horizontal
        caster = ca.asin(-ca.dot(level, upward))
        values = ca.vertcat(moved, -side * ca.asin(axle[2]), ca.atan2(-axle[0], axle[1]), caster)
        self._values = ca.Function("values", arguments, [ca.densify(values)])

    def _guides(self, rack: float) -> Array:
        return np.array([rack if guide == RACK else 0.0 for guide in self._linkage.guides])

    def coordinates(self, travel: float, rack: float, start: Array | None = None) -> Array:
        """Coordinates (n,) of the linkage, nearest to `start` or the design position. Raises `InputError` where it
        cannot get there."""
        z = np.zeros(len(self._linkage.coordinate_names)) if start is None else start.copy()
        guides = self._guides(rack)
        for _ in range(30):
            gap, jacobian = (np.asarray(r) for r in self._equations(z, guides, self._numbers, travel))
            if np.abs(gap).max() < 1e-12:
                return z
            z = z - np.linalg.lstsq(jacobian, gap[:, 0], rcond=1e-10)[0]
            if not np.abs(z).max() < np.pi:
                break
        raise InputError(
            f"the linkage of the {self._linkage.name} axle does not reach travel {1e3 * travel:.4g} mm with the rack "
            f"at {1e3 * rack:.4g} mm: it does not close there. Ask for less, or check the hard points"
        )

    def values(self, z: Array, rack: float) -> Array:
        """`COLUMNS` (6,) at these coordinates."""
        return np.asarray(self._values(z, self._guides(rack), self._numbers)).reshape(-1)
