"""Where on the road a car is: one abscissa for all recordings, the same for the same place on every lap, and what of a
road may change along it.

Distance is what the wheels have rolled; positions only say when a car comes to where a car has been before. So noise of
GNSS shifts a lap by metres and bends nothing. Without positions every recording has a road of its own.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model import road_profile
from vsense_ros.model.effects.base import SPACING

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RoadSettings:
    """How passes of one road are recognised: decisions of this project."""

    spacing: float = 5.0  # [m] from one point of a path to the next
    near: float = 12.0  # [m] between two passes of one place: lanes, and errors of GNSS
    along: float = 30.0  # [m] of disagreement about the abscissa that is taken for an error of GNSS
    turned: float = 0.6  # [rad] between directions of one road
    sure_points: int = 6  # points in a row that begin or end a stretch that was driven before
    averaged_points: int = 20  # points over which the shift between two passes is averaged
    again: float = 60.0  # [m] after which a car may come to a place again
    difference: float = 1e-4  # [rad] for derivatives by the angle that a car has turned
    bend: float = 20.0  # [m] before and behind a place, over which a car that weaves on a straight road has turned back
    stretch: float = 1e6  # [m] of abscissa for each stretch of road by itself, which begins in the middle of them


ROAD_SETTINGS = RoadSettings()


@dataclass
class Road:
    """Paths of all that was driven: points with their abscissa."""

    east: list[float] = field(default_factory=list)  # [m]
    north: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)  # [rad], counter-clockwise from east
    abscissa: list[float] = field(default_factory=list)  # [m]
    stretches: int = 0
    _cells: dict[tuple[int, int], list[int]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for index, (x, y) in enumerate(zip(self.east, self.north, strict=True)):
            self._cells.setdefault(_cell(x, y), []).append(index)

    def begin(self) -> float:
        """The abscissa at which a new stretch begins."""
        self.stretches += 1
        return (self.stretches - 0.5) * ROAD_SETTINGS.stretch

    def follow(self, travelled: Array, east: Array, north: Array) -> tuple[Array, Array]:
        """Distance (m,) and abscissa (m,) [m] of points along a path that is given by the distance `travelled` (n,)
        and positions; where nobody has been yet, the path joins the road."""
        at = np.arange(travelled[0], travelled[-1], ROAD_SETTINGS.spacing)
        if len(at) < 2:
            return at[:0], at[:0]
        x, y = (_smooth(np.interp(at, travelled, values)) for values in (east, north))
        course = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
        known = len(self.abscissa)
        own: list[float] = []  # `at` of the points that were added, by the index in the road less `known`
        abscissa = np.zeros(len(at))
        shifts: deque[float] = deque(maxlen=ROAD_SETTINGS.averaged_points)
        shift = self.begin() - travelled[0]
        passing, in_a_row = False, 0
        candidates: deque[float] = deque(maxlen=ROAD_SETTINGS.sure_points)
        for i in range(len(at)):
            expected = at[i] + shift if passing else None
            met = self._met(x[i], y[i], course[i], known + bisect_left(own, at[i] - ROAD_SETTINGS.again), expected)
            if passing:
                in_a_row = 0 if met is not None else in_a_row + 1
                if met is not None:
                    shifts.append(met - at[i])
                    shift = float(np.median(shifts))
                abscissa[i] = at[i] + shift
                if in_a_row == ROAD_SETTINGS.sure_points:
                    passing, in_a_row = False, 0
                    stretch = abscissa[i] // ROAD_SETTINGS.stretch
                    if (
                        max(s for s in self.abscissa if s // ROAD_SETTINGS.stretch == stretch)
                        > abscissa[i - ROAD_SETTINGS.sure_points]
                    ):
                        shift = self.begin() - at[i - ROAD_SETTINGS.sure_points + 1]
                    for j in range(i - ROAD_SETTINGS.sure_points + 1, i + 1):
                        self._add(x[j], y[j], course[j], at[j] + shift)
                        own.append(at[j])
                        abscissa[j] = at[j] + shift
            else:
                abscissa[i] = at[i] + shift
                self._add(x[i], y[i], course[i], abscissa[i])
                own.append(at[i])
                if met is None:
                    in_a_row = 0
                    candidates.clear()
                    continue
                in_a_row += 1
                candidates.append(met - at[i])
                if in_a_row >= ROAD_SETTINGS.sure_points and np.ptp(candidates) < ROAD_SETTINGS.along:
                    passing, in_a_row, shifts = True, 0, deque(candidates, maxlen=ROAD_SETTINGS.averaged_points)
                    shift = float(np.median(shifts))
                    for j in range(i, i - ROAD_SETTINGS.sure_points, -1):
                        self._remove()
                        own.pop()
                        abscissa[j] = at[j] + shift
        return at, abscissa

    def place(self, abscissa: float) -> tuple[float, float, float] | None:
        """East, north [m] and direction [rad] of the road, where its positions are known."""
        at = np.array(self.abscissa)
        if not len(at) or abs(at[(nearest := int(np.argmin(np.abs(at - abscissa))))] - abscissa) > SPACING:
            return None
        return self.east[nearest], self.north[nearest], self.heading[nearest]

    def abscissa_of(self, east: float, north: float, heading: float) -> float | None:
        """Abscissa of a place [m], where somebody has been there."""
        return self._met(east, north, heading, len(self.abscissa), None)

    def _met(self, x: float, y: float, course: float, until: int, expected: float | None) -> float | None:
        """The abscissa of a place among the first points, if it is one of them."""
        column, row = _cell(x, y)
        around = [self._cells.get((column + i, row + j), ()) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        points = sorted(index for of_cell in around for index in of_cell if index < until)
        if not points:
            return None
        east, north, heading, abscissa = (np.array([values[k] for k in points]) for values in self._columns)
        dx, dy = x - east, y - north
        along, across = np.cos(heading) * dx + np.sin(heading) * dy, np.cos(heading) * dy - np.sin(heading) * dx
        place = abscissa + along
        near = (
            (np.abs(along) < ROAD_SETTINGS.spacing)
            & (np.abs(across) < ROAD_SETTINGS.near)
            & (np.cos(course - heading) > np.cos(ROAD_SETTINGS.turned))
        )
        if expected is not None:
            near &= np.abs(place - expected) < ROAD_SETTINGS.along
        if not near.any():
            return None
        return float(place[near][np.argmin(np.abs(across[near]))])

    def _add(self, x: float, y: float, course: float, abscissa: float) -> None:
        self._cells.setdefault(_cell(x, y), []).append(len(self.abscissa))
        for values, value in zip(self._columns, (x, y, course, abscissa), strict=True):
            values.append(float(value))

    def _remove(self) -> None:
        self._cells[_cell(self.east[-1], self.north[-1])].pop()
        for values in self._columns:
            values.pop()

    @property
    def _columns(self) -> tuple[list[float], ...]:
        return self.east, self.north, self.heading, self.abscissa


def _cell(x: float, y: float) -> tuple[int, int]:
    """Where a point is on a grid [m] whose cells are as wide as points of one place are apart at most: those near a
    point are in its cell or in one beside it, however long the road."""
    width = float(np.hypot(ROAD_SETTINGS.spacing, ROAD_SETTINGS.near))
    return int(x // width), int(y // width)


def _smooth(values: Array) -> Array:
    """Means over five points."""
    if len(values) < 5:
        return values
    padded = np.pad(values, 2, mode="reflect", reflect_type="odd")
    return np.convolve(padded, np.ones(5) / 5, mode="valid")


Slopes = tuple[Array | float, Array | float]


def bending(
    slopes: Callable[[Array], Slopes], changes: Slopes, turned: Array, curvature: Array
) -> tuple[Array | float, Array | float]:
    """What grade and bank of a surface change by along the way [rad/m], as `GRADE_CHANGE` and `BANK_CHANGE`, (n,) each.

    `slopes` are those along and across a car [rad] that has `turned` so far (n,) [rad], `changes` what these change by
    from place to place [rad/m]; `curvature` (n,) is that of the road [1/m]. The axes in which slopes are given turn
    with the road (a Darboux frame on the surface): what they change by on a plane is no bend of it, and a bend of
    constant bank is a cone, which is bent.
    """
    along, across = slopes(turned)
    left, right = (slopes(turned + by) for by in (ROAD_SETTINGS.difference, -ROAD_SETTINGS.difference))
    by_turn = [(one - other) / (2 * ROAD_SETTINGS.difference) for one, other in zip(left, right, strict=True)]
    bend, twist = changes
    return bend + (by_turn[0] - across) * curvature, twist + (by_turn[1] + along) * curvature


def curvature(place: Array, turned: Array) -> Array:
    """How much the road turns per metre (n,) [1/m], from the abscissae (n,) of a car on it and what it has turned (n,)
    [rad]: over a length in which a car that weaves on a straight road has turned back, and which a tight bend has. Zero
    where the abscissa jumps to another stretch of road."""
    curvatures = np.zeros(len(place))
    jumps = np.flatnonzero(np.abs(np.diff(place)) > ROAD_SETTINGS.spacing) + 1
    for rows in np.split(np.arange(len(place)), jumps):
        s = np.maximum.accumulate(place[rows])
        first, last = (np.clip(s + by, s[0], s[-1]) for by in (-ROAD_SETTINGS.bend, ROAD_SETTINGS.bend))
        turn = np.interp(last, s, turned[rows]) - np.interp(first, s, turned[rows])
        curvatures[rows] = np.where(
            last - first > ROAD_SETTINGS.spacing, turn / np.maximum(last - first, ROAD_SETTINGS.spacing), 0.0
        )
    return curvatures


def point(size: str, abscissa: float) -> str:
    """The name of what a size of an effect is, beyond what it is everywhere, at a place [m]."""
    return f"{size}@{abscissa:.0f}"


def place_of(name: str) -> tuple[str, float] | None:
    """Size and abscissa [m] of a name that `point` made; nothing for others."""
    size, at, abscissa = name.partition("@")
    return (size, float(abscissa)) if at else None


def profile(points: Mapping[float, float], place: Array) -> Array:
    """Values at places, without kinks between the points, falling to zero within `SPACING` beyond the ends of a
    stretch."""
    heights = np.zeros(len(place))
    for at, value in _stretches(points):
        beyond = np.maximum(np.maximum(at[0] - place, place - at[-1]), 0) / SPACING
        near = beyond < 1
        inside = np.clip(place[near], at[0], at[-1])
        heights[near] += (1 - beyond[near]) * (road_profile.spline(at, value)(inside) if len(at) > 1 else value[0])
    return heights


def profile_change(points: Mapping[float, float], place: Array) -> Array:
    """What the values change by per metre. Beyond the ends of a stretch, of which nothing is known, as at them; zero
    farther away, and where a stretch has one point."""
    slopes = np.zeros(len(place))
    for at, value in _stretches(points):
        near = (place > at[0] - SPACING) & (place < at[-1] + SPACING)
        if len(at) > 1:
            slopes[near] += road_profile.spline(at, value)(np.clip(place[near], at[0], at[-1]), 1)
    return slopes


def _stretches(points: Mapping[float, float]) -> list[tuple[Array, Array]]:
    """Places and values of the points of each stretch, in order."""
    at = np.array(sorted(points))
    value = np.array([points[abscissa] for abscissa in at])
    apart = np.flatnonzero(np.diff(at) > 2 * SPACING) + 1
    return list(zip(np.split(at, apart), np.split(value, apart), strict=True))


def points(places: Sequence[Array]) -> list[float]:
    """Abscissae of the points that a profile needs along these places, at least half a `SPACING` of road each."""
    driven = np.unique(np.floor(np.concatenate([*places, np.zeros(0)]) / ROAD_SETTINGS.spacing))
    number = (driven * ROAD_SETTINGS.spacing + ROAD_SETTINGS.spacing / 2) / SPACING
    numbers, counts = np.unique(np.round(number), return_counts=True)
    return [float(n * SPACING) for n in numbers[counts >= SPACING / ROAD_SETTINGS.spacing / 2]]
