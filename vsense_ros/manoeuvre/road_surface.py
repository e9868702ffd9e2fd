"""The surface of a road along a track, with its slopes and a crown: what cars are driven on in simulations."""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import numpy as np
from numpy.typing import NDArray

from vsense_ros.manoeuvre.track import Track
from vsense_ros.model.simulation.surface import Surface

Array = NDArray[np.float64]

_STRAIGHT = 1e-7  # [1/m] curvature below which an arc is a line


class RoadSurface(Surface):
    """Over the map around a track, whose slopes it has in its middle.

    `crown` is how far the road falls to either side with the square of the distance from its middle [1/m]: 0.007 is a
    slope of 5 % at 3.5 m. Before the beginning and beyond the end the road goes straight on. A place is looked for near
    the last one, so that a road may cross itself; whoever drives on it has a surface of his own.
    """

    def __init__(self, track: Track, crown: float = 0.0) -> None:
        from scipy.interpolate import CubicSpline  # which takes long to load, and whoever does not simulate need not

        level = np.cos((track.grade[1:] + track.grade[:-1]) / 2)
        distance = np.concatenate([[0.0], np.cumsum(np.diff(track.distance) * level)])  # on the map [m]
        heading = np.diff(track.heading)
        self._crown = crown
        self._way, self._x, self._y = distance.tolist(), track.x.tolist(), track.y.tolist()
        self._heading = track.heading.tolist()
        self._curvature = [*(heading / np.diff(distance)).tolist(), 0.0]
        change = np.gradient(np.array(self._curvature), distance)
        self._curvature_change = change.tolist()
        rise = CubicSpline(distance, np.tan(track.grade))
        middle = rise.antiderivative().c.T[:, ::-1]
        tilt = _tilt(track.grade, track.bank)
        across = CubicSpline(distance, tilt).c.T[:, ::-1]
        end = float(rise.antiderivative()(distance[-1])), float(np.tan(track.grade[-1])), 0.0, 0.0, 0.0
        self._middle = [*map(tuple, middle.tolist()), end]
        self._across = [*map(tuple, across.tolist()), (float(tilt[-1]), 0.0, 0.0, 0.0)]
        self._i = 0

    def shape(self, x: float, y: float) -> tuple[float, Array, Array]:
        i, ahead, left = self._find(x, y)
        curvature = self._curvature[i] if i >= 0 else 0.0
        if i < 0:  # before the beginning, as straight as it begins
            z0, z1, *_ = self._middle[0]
            b = self._across[0][0]
            height, along, second, tilt, tilting, twisting = z0 + z1 * ahead, z1, 0.0, b, 0.0, 0.0
            change = 0.0
        else:
            a = ahead
            z0, z1, z2, z3, z4 = self._middle[i]
            b0, b1, b2, b3 = self._across[i]
            height = z0 + a * (z1 + a * (z2 + a * (z3 + a * z4)))
            along = z1 + a * (2 * z2 + a * (3 * z3 + 4 * a * z4))
            second = 2 * z2 + a * (6 * z3 + 12 * a * z4)
            tilt = b0 + a * (b1 + a * (b2 + a * b3))
            tilting = b1 + a * (2 * b2 + 3 * a * b3)
            twisting = 2 * b2 + 6 * a * b3
            change = self._curvature_change[i]
        # Derivatives by the way along the middle (s) and the distance to its left (n).
        h_s, h_n = along + left * tilting, tilt - 2 * self._crown * left
        h_ss, h_sn, h_nn = second + left * twisting, tilting, -2 * self._crown
        height += left * tilt - self._crown * left * left
        # In axes along and across the road: lines beside the middle are shorter or longer than it by `scale`.
        scale = 1 - curvature * left
        of_way = h_s / scale
        tt = (h_ss / scale + h_s * change * left / scale**2 - curvature * h_n) / scale
        tn = (h_sn + curvature * of_way) / scale
        heading = self._heading[max(i, 0)] + curvature * ahead * (i >= 0)
        c, s = cos(heading), sin(heading)
        gradient = np.array([c * of_way - s * h_n, s * of_way + c * h_n])
        turn = np.array([[c, -s], [s, c]])
        return height, gradient, turn @ np.array([[tt, tn], [tn, h_nn]]) @ turn.T

    def _find(self, x: float, y: float) -> tuple[int, float, float]:
        """The piece of the middle beside a place (-1: before the first), how far along it [m], and the distance to its
        left [m]."""
        i, last = max(self._i, 0), len(self._way) - 1
        ahead, left = self._beside(i, x, y)
        while i < last and ahead >= self._way[i + 1] - self._way[i]:
            i += 1
            ahead, left = self._beside(i, x, y)
        while i > 0 and ahead < 0:
            i -= 1
            ahead, left = self._beside(i, x, y)
        self._i = i
        if i == 0 and ahead < 0:
            c, s = cos(self._heading[0]), sin(self._heading[0])
            u, v = x - self._x[0], y - self._y[0]
            return -1, c * u + s * v, c * v - s * u
        return i, ahead, left

    def _beside(self, i: int, x: float, y: float) -> tuple[float, float]:
        """Position beside the arc that begins at the i-th point: the way along the arc to the foot of a place, and the
        place's distance to its left [m]."""
        c, s, curvature = cos(self._heading[i]), sin(self._heading[i]), self._curvature[i]
        dx, dy = x - self._x[i], y - self._y[i]
        u, v = c * dx + s * dy, c * dy - s * dx
        if abs(curvature) < _STRAIGHT:
            return u, v
        sideways, ahead = curvature * u, 1 - curvature * v  # from the arc's centre, in radii
        return atan2(sideways, ahead) / curvature, (1 - hypot(sideways, ahead)) / curvature


def _tilt(grade: Array, bank: Array) -> Array:
    """Height over distance to the left on the map, where an axis across a road that climbs by `grade` [rad] is `bank`
    above the level."""
    sine, square = np.sin(bank), 1 / np.cos(grade) ** 2
    return np.asarray(sine * square / np.sqrt(1 - sine**2 * square))
