"""Tracks of straights, arcs and clothoids: where the middle of the road is, and how it slopes along and across.

A track begins at the map's origin and runs along its x axis. Its curvature changes linearly within a piece, so that the
heading is exact; positions are integrals of it, to the last digits.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackSettings:
    """Discretisation of tracks."""

    spacing: float = 0.25  # [m] at most, between the points that a track is kept as


TRACK = TrackSettings()

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


@dataclass(frozen=True)
class Piece:
    """A part of a track, `length` [m] measured along the road, whose curvature [1/m] (positive: to the left) changes
    linearly from `begin` to `end`.

    `grade` is the slope along (positive uphill), `bank` that across (positive where the left side is higher) [rad].
    """

    length: float
    begin: float = 0.0
    end: float = 0.0
    grade: float = 0.0
    bank: float = 0.0

    @property
    def turning(self) -> float:
        """Change of heading along the piece [rad]."""
        return self.length * (self.begin + self.end) / 2


def straight(length: float, *, grade: float = 0.0, bank: float = 0.0) -> Piece:
    """A straight of `length` [m]."""
    return Piece(length, grade=grade, bank=bank)


def left_turn(radius: float, degrees: float, *, grade: float = 0.0, bank: float = 0.0) -> Piece:
    """An arc of `radius` [m] through an angle [°]; the angle is negative to the right."""
    curvature = np.copysign(1 / radius, degrees)
    return Piece(radius * abs(np.radians(degrees)), curvature, curvature, grade, bank)


def right_turn(radius: float, degrees: float, *, grade: float = 0.0, bank: float = 0.0) -> Piece:
    """Track that turns right by `degrees` on a circle of `radius` [m]."""
    return left_turn(radius, -degrees, grade=grade, bank=bank)


def with_clothoids(pieces: Sequence[Piece], length: float) -> list[Piece]:
    """A track with a clothoid of `length` [m] across each jump of the curvature, half of it before the jump and half
    behind: an arc after a straight asks for a jump of the lateral acceleration, which no driver can follow.

    Length and changes of heading stay what they were; positions move by about `length`² / (24 radius) at each jump.
    Raises `ValueError` where a piece is shorter than its clothoids.
    """
    with_transitions = []
    for i, piece in enumerate(pieces):
        before, after = (pieces[k] if 0 <= k < len(pieces) else piece for k in (i - 1, i + 1))
        into, out_of = ((length / 2 if a.end != b.begin else 0.0) for a, b in ((before, piece), (piece, after)))
        remaining = piece.length - into - out_of
        if remaining < 0 or (piece.begin != piece.end and into + out_of > 0):
            raise ValueError(f"a piece of {piece.length:g} m has no room for clothoids of {length:g} m")
        slopes = (piece.grade, piece.bank)
        if into:
            with_transitions.append(Piece(into, (before.end + piece.begin) / 2, piece.begin, *slopes))
        if remaining:
            with_transitions.append(Piece(remaining, piece.begin, piece.end, *slopes))
        if out_of:
            with_transitions.append(Piece(out_of, piece.end, (piece.end + after.begin) / 2, *slopes))
    return with_transitions


class Track:
    """The middle of a road by its arc length; columns are (n,) each, in SI units."""

    def __init__(self, pieces: Sequence[Piece], *, blend: float = 0.0) -> None:
        """Grade and bank change over `blend` [m] around the ends of pieces, as a cubic with level ends; 0: at once."""
        self.pieces = tuple(pieces)
        self.blend = blend
        ends = np.concatenate([[0.0], np.cumsum([piece.length for piece in pieces])])
        slopes = np.array([(piece.grade, piece.bank) for piece in pieces])
        changes = np.concatenate([[True], np.any(np.diff(slopes, axis=0) != 0, axis=1)])
        self._levels, self._slopes = ends[:-1][changes], slopes[changes]  # where each slope begins, and what it is
        if blend and len(self._levels) > 1 and np.diff([*self._levels, ends[-1]]).min() < blend:
            raise ValueError(f"a slope is shorter than the {blend:g} m over which it shall change")
        if len(self._levels) == 1:
            self.blend = 0.0  # nothing changes
        distance, heading, curvature = [np.zeros(1)], [np.zeros(1)], [np.array([pieces[0].begin])]
        steps = []
        for piece, begin in zip(pieces, ends, strict=False):
            count = max(1, int(np.ceil(piece.length / TRACK.spacing)))
            s = np.linspace(0.0, piece.length, count + 1)
            slope = (piece.end - piece.begin) / piece.length
            start = heading[-1][-1]
            middle, half = (s[1:] + s[:-1]) / 2, np.diff(s) / 2
            nodes = middle[:, None] + half[:, None] * _NODES
            direction = start + piece.begin * nodes + slope * nodes**2 / 2
            steps.append(half[:, None] * np.column_stack([np.cos(direction) @ _WEIGHTS, np.sin(direction) @ _WEIGHTS]))
            distance.append(begin + s[1:])
            heading.append(start + piece.begin * s[1:] + slope * s[1:] ** 2 / 2)
            curvature.append(piece.begin + slope * s[1:])
        self.distance, self.heading = np.concatenate(distance), np.concatenate(heading)
        self.curvature = np.concatenate(curvature)
        self.grade, self.bank = self.slopes(self.distance)
        # On a map only the cosine of a way uphill is seen.
        level = np.cos((self.grade[1:] + self.grade[:-1]) / 2)
        moves = np.vstack(steps) * level[:, None]
        self.x, self.y = (np.concatenate([[0.0], np.cumsum(moves[:, i])]) for i in range(2))
        rise = np.diff(self.distance) * np.sin((self.grade[1:] + self.grade[:-1]) / 2)
        self.z = np.concatenate([[0.0], np.cumsum(rise)])

    @property
    def length(self) -> float:
        """Length of the whole track [m]."""
        return float(self.distance[-1])

    def slopes(self, distance: Array | float) -> tuple[Array, Array]:
        """Grade and bank at arc lengths (m,) [rad]: those of the first and last piece before and beyond them."""
        piece = np.clip(np.searchsorted(self._levels, distance, side="right") - 1, 0, len(self._levels) - 1)
        if not self.blend:
            return self._slopes[piece, 0], self._slopes[piece, 1]
        share = (np.asarray(distance)[..., None] - self._levels[1:]) / self.blend + 0.5
        share = np.clip(share, 0.0, 1.0)
        share = share**2 * (3 - 2 * share)
        grade, bank = (self._slopes[0, i] + share @ np.diff(self._slopes[:, i]) for i in range(2))
        return grade, bank


class Along:
    """How far along a track something is that moves forwards on it: its memory distinguishes crossings and laps.

    Before the beginning and beyond the end the track goes on as it is there.
    """

    def __init__(self, track: Track) -> None:
        self._s, self._x, self._y, self._heading, self._curvature = (
            column.tolist() for column in (track.distance, track.x, track.y, track.heading, track.curvature)
        )
        self._cos, self._sin = np.cos(track.heading).tolist(), np.sin(track.heading).tolist()
        self._i = 0

    def find(self, x: float, y: float) -> tuple[float, float, float]:
        """Arc length [m], offset of the point to the left of the track [m], heading of the track there [rad]."""
        i, last = self._i, len(self._s) - 1
        ahead = self._ahead(i, x, y)
        while i < last and (following := self._ahead(i + 1, x, y)) >= 0:
            i, ahead = i + 1, following
        while i > 0 and ahead < 0:
            i -= 1
            ahead = self._ahead(i, x, y)
        self._i = i
        offset = (y - self._y[i]) * self._cos[i] - (x - self._x[i]) * self._sin[i]
        curvature = self._curvature[i]
        return self._s[i] + ahead, offset - curvature * ahead**2 / 2, self._heading[i] + curvature * ahead

    def curvature(self, distance: float) -> float:
        """Curvature at an arc length [1/m]."""
        return self._curvature[max(bisect_right(self._s, distance) - 1, 0)]

    def _ahead(self, i: int, x: float, y: float) -> float:
        """How far a point is ahead of the track's i-th one, along the track [m]."""
        return (x - self._x[i]) * self._cos[i] + (y - self._y[i]) * self._sin[i]
