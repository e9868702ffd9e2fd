"""Suspension kinematics as smooth tables, made from the linkages of the full car.

The linkage is solved for travels and steering angles, and polynomials as short as the tolerance allows are laid through
what it does there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial, chebyshev, polynomial
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.model.car.corner_mechanism import RACK, UPRIGHT, CornerMechanism
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.multibody.assembly import assemble
from vsense_ros.model.multibody.semi_recursive import Motion
from vsense_ros.model.schema.suspension_tables import AxleTable, SuspensionTables
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

COLUMNS = tuple(AxleTable.model_fields)


@dataclass(frozen=True)
class TableSettings:
    """Settings of the fit of suspension tables: decisions of this project."""

    tolerance: float = 1e-5  # [m, rad] between a table and the linkage
    margin: float = 0.8  # [-] of the tolerance at the points of a fit: between them the error is a little larger
    points: int = 14  # in each direction: Chebyshev's, which keep the error between them as small as at them
    digits: int = 9  # behind the point, of the coefficients [m, rad]
    rack_points: int = 33  # of the fit of the steering rack
    rack_degree: int = 13  # of the polynomial of the steering rack


TABLES = TableSettings()

DEGREES = range(9)


@dataclass(frozen=True, eq=False)
class SteeringRack:
    """Displacement of the rack for the mean angle of the front wheels at design height."""

    displacement: Polynomial  # angle [rad] → to the left [m]
    limit: float  # [rad] the rack's end, to either side

    def motion(self, angle: float, rate: float = 0.0, acceleration: float = 0.0) -> Array:
        """Displacement, speed and acceleration (3,) of the rack for a mean angle of the front wheels and its
        derivatives [rad, rad/s, rad/s²]. Raises `InputError` beyond what the rack can do."""
        if not abs(angle) <= self.limit:
            raise InputError(
                f"a mean steering angle of {np.degrees(angle):.4g}° is more than the rack's "
                f"±{np.degrees(self.limit):.4g}°"
            )
        value, slope, curvature = (_value(coefficients, angle) for coefficients in self._coefficients)
        return np.array([value, slope * rate, slope * acceleration + curvature * rate**2])

    @cached_property
    def _coefficients(self) -> tuple[list[float], ...]:
        """Coefficients of the displacement and of its first two derivatives, highest power first."""
        slope = self.displacement.deriv()
        return tuple(p.convert().coef[::-1].tolist() for p in (self.displacement, slope, slope.deriv()))


def _value(coefficients: list[float], x: float) -> float:
    """Value of a polynomial, highest power first, by Horner's rule: numpy's takes ten times as long for one x."""
    value = 0.0
    for coefficient in coefficients:
        value = value * x + coefficient
    return value


def steering_rack(vehicle: Vehicle, rack: float = 0.04) -> SteeringRack:
    """The rack of a vehicle with a `linkage` section, with `rack` [m] of travel to either side.

    Raises `InputError` for a vehicle that cannot be steered, and where the linkage does not reach that far.
    """
    return _steering_rack(_positions(vehicle)[0], vehicle, rack)


def kinematic_tables(
    vehicle: Vehicle, bump: float = 0.06, rebound: float = 0.06, rack: float = 0.04, tolerance: float = TABLES.tolerance
) -> SuspensionTables:
    """Tables of a vehicle with a `linkage` section, for travels from `-rebound` to `bump` and the rack within ±`rack`,
    all in m; `tolerance` is the largest error [m, rad].

    Raises `InputError` where the linkage does not reach that far, or where it moves too wildly for a short polynomial.
    """
    for name, value in (("bump", bump), ("rebound", rebound), ("rack", rack)):
        if not 0 < value < 1:
            raise InputError(f"{name} must be a length between 0 and 1 m, found {value:g}")
    front, rear = _positions(vehicle)
    steering = _steering_rack(front, vehicle, rack)
    largest = np.floor(steering.limit * 10**TABLES.digits) / 10**TABLES.digits
    points = chebyshev.chebpts2(TABLES.points)
    middle, half = (bump - rebound) / 2, (bump + rebound) / 2
    tables = {}
    for axle, position in (("front", front), ("rear", rear)):
        across = points if position.steered else np.zeros(1)
        racks = np.array([steering.motion(largest * float(a))[0] for a in across])
        values, design = position.grid(middle + half * points, racks), position.values(position.design, 0.0)
        columns = {}
        for i, name in enumerate(COLUMNS):
            coefficients = _polynomial(points, across, values[:, :, i], -middle / half, design[i], tolerance)
            if coefficients is None:
                raise InputError(
                    f"{name} of the {axle} suspension cannot be put into a polynomial of degree {DEGREES[-1]} within "
                    f"{tolerance:g} m or rad; ask for less travel or less rack"
                )
            columns[name] = tuple(tuple(round(float(c), TABLES.digits) for c in row) for row in coefficients)
        tables[axle] = AxleTable(**columns)
    return SuspensionTables(travel=(-rebound, bump), steering=float(largest), **tables)


def largest_errors(
    vehicle: Vehicle, tables: SuspensionTables, rack: float = 0.04, points: int = 8
) -> dict[str, dict[str, float]]:
    """Largest differences, by axle and column, between `tables`, made with this `rack`, and the linkage of a vehicle
    [m, rad], in the middles of `points` equal parts of travel and steering."""
    front, rear = _positions(vehicle)
    steering = _steering_rack(front, vehicle, rack)
    low, high = tables.travel
    middles = (np.arange(points) + 0.5) / points
    travels, angles = low + (high - low) * middles, tables.steering * (2 * middles - 1)
    errors_by_axle = {}
    for axle, position in (("front", front), ("rear", rear)):
        steering_angles = angles if position.steered else np.zeros(1)
        expected = position.grid(travels, np.array([steering.motion(float(a))[0] for a in steering_angles]))
        values = np.array(
            [
                [[v[0] for v in tables.columns(axle, s, float(a)).values()] for a in steering_angles]
                for s in travels.tolist()
            ]
        )
        errors_by_axle[axle] = dict(zip(COLUMNS, np.abs(values - expected).max(axis=(0, 1)).tolist(), strict=True))
    return errors_by_axle


def _positions(vehicle: Vehicle) -> tuple[WheelPosition, WheelPosition]:
    """Solvers of the left wheels in front and at the rear."""
    car = FullCar(vehicle)
    numbers = car.corner_parameters(car.parameters(vehicle))
    return WheelPosition(car.corners[0], numbers[0]), WheelPosition(car.corners[1], numbers[2])


def _steering_rack(front: WheelPosition, vehicle: Vehicle, rack: float) -> SteeringRack:
    if not front.steered:
        raise InputError(
            f"vehicle {vehicle.name!r} cannot be steered: set `steered: true` in its section linkage.front"
        )
    racks = rack * chebyshev.chebpts2(TABLES.rack_points)
    toe = front.grid(np.zeros(1), racks)[0, :, COLUMNS.index("toe")]
    angles = (toe - toe[::-1]) / 2  # the right wheel is the mirror image of the left one at the opposite rack
    steps = np.diff(angles)
    if not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError(
            f"the wheels of the front axle do not turn steadily with the rack within ±{1e3 * rack:.4g} mm; make the "
            "tables with a smaller rack travel, or check the hard points of the tie rod"
        )
    limit = float(np.abs(angles).max())
    odd = np.arange(1, TABLES.rack_degree + 1, 2)
    coefficients = np.zeros(TABLES.rack_degree + 1)
    coefficients[odd] = np.linalg.lstsq((angles[:, None] / limit) ** odd, racks, rcond=None)[0] / limit**odd
    return SteeringRack(Polynomial(coefficients), limit)


def _polynomial(
    along: Array, across: Array, values: Array, design_point: float, design: float, tolerance: float
) -> Array | None:
    """The fewest coefficients that come as close as `tolerance` to `values` (n×k) at the points `along` (n,) and
    `across` (k,) from -1 to 1; None where there are none. At `design_point` along and 0 across they give `design`."""
    for powers in _shapes(len(across) > 1):
        terms = np.stack([np.outer(along**i, across**j).reshape(-1) for i, j in powers], axis=1)
        terms -= [design_point**i * (j == 0) for i, j in powers]
        fitted = np.linalg.lstsq(terms, values.reshape(-1) - design, rcond=None)[0]
        if np.abs(terms @ fitted + design - values.reshape(-1)).max() > TABLES.margin * tolerance:
            continue
        coefficients = np.zeros(tuple(np.max(powers, axis=0) + 1))
        coefficients[tuple(np.transpose(powers))] = fitted
        coefficients[0, 0] += design - polynomial.polyval2d(design_point, 0.0, coefficients)
        return coefficients
    return None


def _shapes(steered: bool) -> Iterator[list[tuple[int, int]]]:
    """Powers of travel and steering, fewest first: those below a straight line from the highest of one to that of the
    other."""
    shapes = []
    for n, m in product(DEGREES, DEGREES if steered else (0,)):
        shapes.append([(i, j) for i in range(n + 1) for j in range(m + 1) if i * max(m, 1) + j * n <= n * max(m, 1)])
    yield from sorted(shapes, key=len)


class WheelPosition:
    """Where the linkage of a corner holds its wheel: solves the closures together with the travel."""

    def __init__(self, corner: CornerMechanism, numbers: Array) -> None:
        linkage = corner.linkage
        self._linkage, self._numbers = linkage, numbers
        n, g = len(linkage.coordinate_names), len(linkage.guides)
        z, guides, travel = ca.SX.sym("z", n), ca.SX.sym("guides", g), ca.SX.sym("travel")
        motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), ca.horzcat(guides, ca.SX(g, 2)))
        measured, strut = motion.measure(corner.travel), motion.measure(corner.strut)
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
        centre, side = corner.centre, corner.extra.side
        moved = frame.at(centre) - centre
        axle = frame.rotation[:, 1]
        upward = frame.rotation[:, 2]
        # The upright's own vertical, turned about the axle from the vertical plane through it.
        level = ca.cross(ca.SX([0, 0, 1]), axle)
        level = -level / ca.norm_2(level)  # forwards, horizontal
        caster = ca.asin(-ca.dot(level, upward))
        camber, toe = -side * ca.asin(axle[2]), ca.atan2(-axle[0], axle[1])
        values = ca.vertcat(moved[0], moved[1], camber, toe, caster, strut.value)
        self._values = ca.Function("values", arguments, [ca.densify(values)])
        self._strut = ca.Function("strut", arguments, [strut.value, ca.densify(strut.gradient)])
        self.steered = bool(linkage.guides)
        self.design = assemble(linkage, numbers)
        self._strut_at_design, self._strut_ratio = self._rest()

    def _rest(self) -> tuple[float, float]:
        """Place of the strut in the design position and its movement per travel."""
        place = [self.design, self._guides(0.0), self._numbers]
        value, gradient = (np.asarray(r) for r in self._strut(*place))
        _, jacobian = (np.asarray(r) for r in self._equations(*place, 0.0))
        travelling = np.linalg.lstsq(jacobian, np.eye(len(jacobian))[-1], rcond=1e-10)[0]
        return value.item(), float(gradient[0] @ travelling)

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
        columns = np.asarray(self._values(z, self._guides(rack), self._numbers)).reshape(-1)
        columns[-1] = (columns[-1] - self._strut_at_design) / self._strut_ratio
        return columns

    def grid(self, travels: Array, racks: Array) -> Array:
        """`values` for all travels (n,) and racks (k,), both in order, n×k×6: from the middle outwards, so that each
        point begins near its solution."""
        grid_values = np.empty((len(travels), len(racks), len(COLUMNS)))
        begin, across = int(np.argmin(np.abs(travels))), int(np.argmin(np.abs(racks)))
        for side in (range(across, len(racks)), range(across - 1, -1, -1)):
            middle = self.design
            for k in side:
                middle = self.coordinates(travels[begin], racks[k], middle)
                for direction in (range(begin, len(travels)), range(begin - 1, -1, -1)):
                    z = middle
                    for i in direction:
                        z = self.coordinates(travels[i], racks[k], z)
                        grid_values[i, k] = self.values(z, racks[k])
        return grid_values
