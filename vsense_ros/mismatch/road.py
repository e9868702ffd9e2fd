"""Where on the road a car is: one abscissa for all recordings, the same for the same place on every lap, and what of a
road may change along it.

Distance is what the wheels have rolled; positions only say when a car comes to where a car has been before. So noise of
GNSS shifts a lap by metres and bends nothing. Without positions every recording has a road of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from vsense_ros.model.effects.base import SPACING

Array = NDArray[np.float64]

POINT = 5.0  # [m] from one point of a path to the next
NEAR = 12.0  # [m] between two passes of one place: lanes, and errors of GNSS
ALONG = 30.0  # [m] of disagreement about the abscissa that is taken for an error of GNSS
TURNED = 0.6  # [rad] between directions of one road
SURE = 6  # points in a row that begin or end a stretch that was driven before
STEADY = 20  # points over which the shift between two passes is averaged
AGAIN = 60.0  # [m] after which a car may come to a place again
STANDING = 1e-3  # [m] from one instant to the next, below which a slope has no change per metre
TURNING = 100  # instants over which a course is averaged before it is differentiated
STRETCH = 1e6  # [m] of abscissa for each stretch of road by itself, which begins in the middle of them


@dataclass
class Road:
    """Paths of all that was driven: points with their abscissa."""

    east: list[float] = field(default_factory=list)  # [m]
    north: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)  # [rad], counter-clockwise from east
    abscissa: list[float] = field(default_factory=list)  # [m]
    stretches: int = 0

    def begin(self) -> float:
        """The abscissa at which a new stretch begins."""
        self.stretches += 1
        return (self.stretches - 0.5) * STRETCH

    def follow(self, travelled: Array, east: Array, north: Array) -> tuple[Array, Array]:
        """Distance (m,) and abscissa (m,) [m] of points along a path that is given by the distance `travelled` (n,)
        and positions; where nobody has been yet, the path joins the road."""
        at = np.arange(travelled[0], travelled[-1], POINT)
        if len(at) < 2:
            return at[:0], at[:0]
        x, y = (_smooth(np.interp(at, travelled, values)) for values in (east, north))
        course = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
        known = len(self.abscissa)
        own: list[int] = []  # points of `at` that were added, by the index in the road less `known`
        abscissa = np.zeros(len(at))
        shifts: deque[float] = deque(maxlen=STEADY)
        shift = self.begin() - travelled[0]
        passing, in_a_row = False, 0
        candidates: deque[float] = deque(maxlen=SURE)
        for i in range(len(at)):
            expected = at[i] + shift if passing else None
            met = self._met(x[i], y[i], course[i], known + int(np.searchsorted(at[own], at[i] - AGAIN)), expected)
            if passing:
                in_a_row = 0 if met is not None else in_a_row + 1
                if met is not None:
                    shifts.append(met - at[i])
                    shift = float(np.median(shifts))
                abscissa[i] = at[i] + shift
                if in_a_row == SURE:
                    passing, in_a_row = False, 0
                    stretch = abscissa[i] // STRETCH
                    if max(s for s in self.abscissa if s // STRETCH == stretch) > abscissa[i - SURE]:
                        shift = self.begin() - at[i - SURE + 1]
                    for j in range(i - SURE + 1, i + 1):
                        self._add(x[j], y[j], course[j], at[j] + shift)
                        own.append(j)
                        abscissa[j] = at[j] + shift
            else:
                abscissa[i] = at[i] + shift
                self._add(x[i], y[i], course[i], abscissa[i])
                own.append(i)
                if met is None:
                    in_a_row = 0
                    candidates.clear()
                    continue
                in_a_row += 1
                candidates.append(met - at[i])
                if in_a_row >= SURE and np.ptp(candidates) < ALONG:
                    passing, in_a_row, shifts = True, 0, deque(candidates, maxlen=STEADY)
                    shift = float(np.median(shifts))
                    for j in range(i, i - SURE, -1):
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
        if until == 0:
            return None
        dx, dy = x - np.array(self.east[:until]), y - np.array(self.north[:until])
        heading = np.array(self.heading[:until])
        along, across = np.cos(heading) * dx + np.sin(heading) * dy, np.cos(heading) * dy - np.sin(heading) * dx
        place = np.array(self.abscissa[:until]) + along
        near = (np.abs(along) < POINT) & (np.abs(across) < NEAR) & (np.cos(course - heading) > np.cos(TURNED))
        if expected is not None:
            near &= np.abs(place - expected) < ALONG
        if not near.any():
            return None
        return float(place[near][np.argmin(np.abs(across[near]))])

    def _add(self, x: float, y: float, course: float, abscissa: float) -> None:
        for values, value in zip(self._columns, (x, y, course, abscissa), strict=True):
            values.append(float(value))

    def _remove(self) -> None:
        for values in self._columns:
            values.pop()

    @property
    def _columns(self) -> tuple[list[float], ...]:
        return self.east, self.north, self.heading, self.abscissa


def _smooth(values: Array) -> Array:
    """Means over five points."""
    if len(values) < 5:
        return values
    padded = np.pad(values, 2, mode="reflect", reflect_type="odd")
    return np.convolve(padded, np.ones(5) / 5, mode="valid")


def bending(along: Array, across: Array, place: Array, turned: Array) -> tuple[Array, Array]:
    """What grade and bank of a surface change by along the way [rad/m], as `GRADE_CHANGE` and `BANK_CHANGE`, (n,) each,
    from the slopes (n,) [rad] along and across a car at abscissae `place` (n,) [m] that has `turned` [rad].

    The axes in which the slopes are told turn with the car (a Darboux frame on the surface): what they change by on a
    plane that the car turns on is no bend of it, and a bend of constant bank is a cone, which is bent. Zero where the
    abscissa jumps from one stretch of road to another, and where the car hardly moves.
    """
    if len(place) < 2:
        return np.zeros(len(place)), np.zeros(len(place))
    moved = np.gradient(place)
    on_one_road = (np.abs(moved) < POINT) & (np.abs(moved) > STANDING)
    per_metre = np.where(on_one_road, 1 / np.where(on_one_road, moved, 1.0), 0.0)
    # The course comes from GNSS, whose noise between neighbours is no turn.
    turning = np.gradient(uniform_filter1d(turned, min(TURNING, len(turned)), mode="nearest"))
    return (
        (np.gradient(along) - across * turning) * per_metre,
        (np.gradient(across) + along * turning) * per_metre,
    )


def point(size: str, abscissa: float) -> str:
    """The name of what a size of an effect is, beyond what it is everywhere, at a place [m]."""
    return f"{size}@{abscissa:.0f}"


def place_of(name: str) -> tuple[str, float] | None:
    """Size and abscissa [m] of a name that `point` made; nothing for others."""
    size, at, abscissa = name.partition("@")
    return (size, float(abscissa)) if at else None


def profile(points: Mapping[float, float], place: Array) -> Array:
    """Values at places, linearly between the points, falling to zero within `SPACING` beyond the ends of a stretch."""
    at = np.array(sorted(points))
    value = np.array([points[abscissa] for abscissa in at])
    ends = np.flatnonzero(np.diff(at) > 2 * SPACING)
    zeros = np.concatenate([[at[0] - SPACING], at[ends] + SPACING, at[ends + 1] - SPACING, [at[-1] + SPACING]])
    everywhere = np.concatenate([at, zeros])
    order = np.argsort(everywhere, kind="stable")
    return np.interp(place, everywhere[order], np.concatenate([value, np.zeros(len(zeros))])[order])


def points(places: Sequence[Array]) -> list[float]:
    """Abscissae of the points that a profile needs along these places, at least half a `SPACING` of road each."""
    driven = np.unique(np.floor(np.concatenate([*places, np.zeros(0)]) / POINT))
    number = (driven * POINT + POINT / 2) / SPACING
    numbers, counts = np.unique(np.round(number), return_counts=True)
    return [float(n * SPACING) for n in numbers[counts >= SPACING / POINT / 2]]
