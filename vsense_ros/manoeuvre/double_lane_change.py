"""ISO 3888-1: out of a lane, 3.5 m to the left past an obstacle, and back."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.driver import PathFollower, SpeedKeeper
from vsense_ros.model.simulation.closed_loop import Array, Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class DoubleLaneChangeSettings:
    """The track of ISO 3888-1."""

    speed: float = 70 / 3.6  # [m/s]
    entry: float = 2.5 * speed  # [m] where the first section begins
    # Sections of the track: beginning and end [m after ENTRY], width per vehicle width (plus 0.25 m), offset of
    # the right edge [m] (Leung 2010, table C.2 has the same track).
    sections: tuple[
        tuple[float, float, float, float], tuple[float, float, float, float], tuple[float, float, float, float]
    ] = ((0.0, 15.0, 1.1, 0.0), (45.0, 70.0, 1.2, 3.5), (95.0, 125.0, 1.3, 0.0))


SETTINGS = DoubleLaneChangeSettings()


def vehicle_width(vehicle: Vehicle) -> float:
    """Over the tyres [m]: the vehicle file knows tracks only, a tyre of the class is 0.17 m wide."""
    return max(vehicle.physics.front.track, vehicle.physics.rear.track) + 0.17


def lanes(vehicle: Vehicle, entry: float = SETTINGS.entry) -> list[tuple[float, float, float, float]]:
    """Beginning, end, right and left edge of each section in the map [m]; the first begins at `entry` and is centred on
    the x axis."""
    width = vehicle_width(vehicle)
    right = -0.5 * (SETTINGS.sections[0][2] * width + 0.25)
    return [
        (entry + begin, entry + end, right + offset, right + offset + factor * width + 0.25)
        for begin, end, factor, offset in SETTINGS.sections
    ]


@dataclass(frozen=True)
class LaneChanges:
    """The middle of the lanes, joined by the curves of least jerk (quintic)."""

    knots: tuple[tuple[float, float, float], ...]  # beginning and end of each straight, and its y [m]

    def offset(self, x: float, y: float) -> float:
        middle = self.knots[0][2]
        for (_, begin, offset_before), (end, _, offset_after) in pairwise(self.knots):
            s = min(max((x - begin) / (end - begin), 0.0), 1.0)
            middle += (offset_after - offset_before) * s**3 * (10 - 15 * s + 6 * s**2)
        return middle - y


def path(vehicle: Vehicle, entry: float = SETTINGS.entry) -> LaneChanges:
    """The line through the lanes that begin at `entry` [m]."""
    # Drivers cut into the sections as far as the width allows, so the transitions are longer than the gaps.
    cut = 7.0  # [m]
    knots = [(begin + cut, end - cut, 0.5 * (right + left)) for begin, end, right, left in lanes(vehicle, entry)]
    return LaneChanges(tuple(knots))


def driver(vehicle: Vehicle) -> Driver:
    hands = PathFollower(vehicle, path(vehicle))
    feet = SpeedKeeper(vehicle, lambda t: SETTINGS.speed)
    return lambda t, q, u: _together(hands(t, q, u), feet(t, u))


def _together(angle: float, torques: Array) -> Array:
    return np.concatenate([[angle], torques])


MANOEUVRE = Manoeuvre(
    "double_lane_change",
    "Double lane change",
    "ISO 3888-1 with a path-following driver, at 70 km/h instead of 80: the plant's road has a grip of 0.8",
    duration=12.0,
    speed=SETTINGS.speed,
    driver=driver,
)
