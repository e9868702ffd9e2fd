"""Kinematics of suspensions as polynomials in the wheel's travel and the steering angle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from vsense_ros.model.parameter import Part, parameter


@dataclass(frozen=True)
class TableLimits:
    """Limits of suspension tables."""

    highest_degree: int = 12  # of a polynomial
    rounding: float = 1e-6  # [m] that a table may differ by from the design position where it must go through it


LIMITS = TableLimits()


Polynomial = tuple[tuple[float, ...], ...]
Coefficients = dict[str, Sequence[Sequence[ca.SX | float]]]  # of an axle's columns, by name
Columns = dict[str, tuple[ca.SX, ca.SX, ca.SX]]  # of an axle's columns three values each, by name


def _column(unit: str, description: str) -> Polynomial:
    result: Polynomial = parameter(unit, description)
    return result


class AxleTable(Part):
    """Kinematics of the left wheel of an axle; the right one is its mirror image, at the opposite steering.

    Each quantity is a polynomial in travel and steering. Row i holds the coefficients of ξⁱ, and of these column j that
    of ηʲ: ξ goes from -1 to 1 over the travel of the tables, η = steering / `steering` likewise.
    """

    x: Polynomial = _column("m", "wheel centre forward of its design position")
    y: Polynomial = _column("m", "wheel centre to the left of its design position")
    camber: Polynomial = _column("rad", "camber: angle by which the top of the wheel leans outwards")
    toe: Polynomial = _column("rad", "toe: angle by which the front of the wheel points to the left")
    caster: Polynomial = _column(
        "rad", "turn of the hub about the wheel's axle since the design position, top rearwards"
    )
    spring: Polynomial = _column("m", "compression of the spring over the ratio it has in the design position")

    @model_validator(mode="after")
    def _is_rectangular(self) -> AxleTable:
        for name in type(self).model_fields:
            rows = getattr(self, name)
            widths = {len(row) for row in rows}
            if len(widths) != 1 or 0 in widths or max(len(rows), *widths) > LIMITS.highest_degree + 1:
                raise ValueError(
                    f"{name} must have rows of one length, up to {LIMITS.highest_degree + 1} coefficients each way, "
                    f"found rows of {', '.join(str(len(row)) for row in rows) or 'none'}"
                )
        return self


class SuspensionTables(Part):
    """Kinematics of both axles as tables. `vsense suspension` makes them from the linkages.

    Beyond the travel that they cover the hub goes on straight, in the direction that it has at the end of the table;
    no stop holds it. Steering ends at `steering`, where the rack does.
    """

    travel: tuple[float, float] = parameter(
        "m", "lowest and highest wheel centre that the tables cover, from its design position"
    )
    steering: float = parameter("rad", "largest mean angle of the front wheels, at the end of the rack", gt=0, lt=1.2)
    front: AxleTable
    rear: AxleTable

    @model_validator(mode="after")
    def _goes_through_the_design_position(self) -> SuspensionTables:
        low, high = self.travel
        if not -1 < low < 0 < high < 1:
            raise ValueError(f"travel must reach from below to above 0, within 1 m, found {low:g} to {high:g}")
        for axle in ("front", "rear"):
            place = self.columns(axle, 0.0, 0.0)
            for name in ("x", "y", "spring"):
                if abs(place[name][0]) > LIMITS.rounding:
                    raise ValueError(
                        f"{axle}.{name} is {place[name][0]:g} m in the design position, where it must be 0"
                    )
            if abs(place["spring"][1] - 1) > 0.01:
                raise ValueError(
                    f"{axle}.spring moves by {place['spring'][1]:.3g} of the wheel's travel in the design position, "
                    "where it is measured by that: 1 is expected"
                )
            for travel in np.linspace(low, high, 9):
                slope = self.columns(axle, float(travel), 0.0)["spring"][1]
                if not slope > 0.05:
                    raise ValueError(
                        f"{axle}.spring moves by {slope:.3g} of the wheel's travel at {1e3 * travel:.3g} mm; at least "
                        "0.05 is needed"
                    )
        return self

    def columns(self, axle: str, travel: float, steering: float) -> dict[str, NDArray[np.float64]]:
        """Value, first and second derivative by the travel (3,) of each column of an axle's table, for its left wheel
        at `travel` [m] and a mean angle of the front wheels [rad]; beyond the table as the class says."""
        columns = np.asarray(_function(self, axle)(travel, steering))
        return dict(zip(AxleTable.model_fields, columns, strict=True))


def coefficients(tables: SuspensionTables, axle: str) -> Coefficients:
    """Coefficients of an axle's columns, by name."""
    return {name: getattr(getattr(tables, axle), name) for name in AxleTable.model_fields}


def coefficients_in_one_form(tables: SuspensionTables, symbol: Callable[[float], ca.SX]) -> dict[str, Coefficients]:
    """Those of both axles, "front" and "rear", as polynomials with the same terms: filled up with zeros, and with a
    `symbol` for each number where not both axles have a zero."""
    by_axle: dict[str, Coefficients] = {"front": {}, "rear": {}}
    filled = {name: _filled(getattr(tables.front, name), getattr(tables.rear, name)) for name in AxleTable.model_fields}
    for axle, of_axle in enumerate(by_axle.values()):
        for name, pair in filled.items():
            non_zero = np.any(pair, axis=0)
            of_axle[name] = [
                [symbol(pair[axle, i, j]) if non_zero[i, j] else 0.0 for j in range(non_zero.shape[1])]
                for i in range(non_zero.shape[0])
            ]
    return by_axle


def _filled(*polynomials: Polynomial) -> NDArray[np.float64]:
    """Polynomials filled up with zeros to one shape."""
    tables = [np.array(polynomial) for polynomial in polynomials]
    rows, columns = (max(table.shape[axis] for table in tables) for axis in (0, 1))
    return np.array([np.pad(t, [(0, rows - t.shape[0]), (0, columns - t.shape[1])]) for t in tables])


@cache
def _function(tables: SuspensionTables, axle: str) -> ca.Function:
    """(travel, steering) → rows of `SuspensionTables.columns`."""
    travel, steering = ca.SX.sym("travel"), ca.SX.sym("steering")
    columns = _evaluate(tables, coefficients(tables, axle), travel, steering)
    return ca.Function(axle, [travel, steering], [ca.vertcat(*(ca.horzcat(*values) for values in columns.values()))])


@dataclass(frozen=True, eq=False)
class TablePlace:
    """Where in the tables a wheel is: its travel ξ, `within` the tables and `along` beyond them; its steering η; and
    half the travel that they cover [m]."""

    along: ca.SX
    within: ca.SX
    across: ca.SX
    half: float


def place_in_tables(tables: SuspensionTables, travel: ca.SX, steering: ca.SX) -> TablePlace:
    """The place of a left wheel; of a right one for the opposite steering."""
    low, high = tables.travel
    half = (high - low) / 2
    along = (travel - (low + high) / 2) / half
    inside_table = ca.fmin(ca.fmax(along, -1), 1)
    across = ca.fmin(ca.fmax(steering / tables.steering, -1), 1)
    return TablePlace(along, inside_table, across, half)


def columns_within(table: Coefficients, place: TablePlace) -> Columns:
    """Value, slope and half the curvature by ξ of each column of an axle's tables."""
    return {
        name: _horner([_horner(row, place.across)[0] for row in rows], place.within) for name, rows in table.items()
    }


def columns_beyond(columns: Columns, place: TablePlace) -> Columns:
    """Value, first and second derivative by the travel of each column, beyond the tables too."""
    inside = place.within == place.along
    return {
        name: (
            value + slope * (place.along - place.within),
            slope / place.half,
            ca.if_else(inside, 2 * half_curvature / place.half**2, 0),
        )
        for name, (value, slope, half_curvature) in columns.items()
    }


def _evaluate(tables: SuspensionTables, table: Coefficients, travel: ca.SX, steering: ca.SX) -> Columns:
    """Value, first and second derivative by the travel of each column."""
    place = place_in_tables(tables, travel, steering)
    return columns_beyond(columns_within(table, place), place)


def _horner(coefficients: Sequence[ca.SX | float], x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Value, slope and half the curvature of a polynomial, by Horner's scheme."""
    value, slope, half_curvature = ca.SX(coefficients[-1]), ca.SX(0), ca.SX(0)
    for coefficient in reversed(coefficients[:-1]):
        half_curvature = half_curvature * x + slope
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope, half_curvature
