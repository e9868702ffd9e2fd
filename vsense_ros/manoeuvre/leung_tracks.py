"""The tracks of Leung 2010 (appendix C and table 4.12), at constant speed with a driver who cuts corners little.

Names are those of the thesis with the speed in km/h: `double_oval_25`. The speed of the short tracks is 5 m/s, that of
the hill 80 km/h. The length of the plain straight, and radius and angle of the turn on the hill, are not given there.
The figure of eight closes only if both of its arcs have a radius of 41.9 m; the thesis has 42 m and 43 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import atan

import numpy as np

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.double_lane_change import SETTINGS as LANES
from vsense_ros.manoeuvre.double_lane_change import path
from vsense_ros.manoeuvre.driver import PathFollower, SpeedKeeper, TrackFollower
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.track import Track, left_turn, right_turn, straight, with_clothoids
from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class LeungTrackSettings:
    """Lengths and speeds of the tracks of Leung 2010, appendix C, unless a comment says otherwise."""

    speeds_kph: tuple[int, ...] = (15, 20, 25, 35, 45, 50, 55)  # [km/h] of the double oval and the lane change
    slow_speed: float = 5.0  # [m/s] of the short tracks
    hill_speed: float = 80 / 3.6  # [m/s]
    lane_change_entry: float = 400.0  # [m]
    lane_change_end: float = 625.0  # [m]
    plain_straight: float = 300.0  # [m]
    hill_radius: float = 100.0  # [m]
    hill_angle_deg: float = 90.0  # [°]
    hill_blend: float = 40.0  # [m] over which the slope of the hill changes: a car cannot follow a kink
    # [m] of the clothoids across the ends of arcs: the thesis has none, but at 55 km/h no hands turn the wheel
    # at once.
    oval_transition: float = 10.0
    transition: float = 6.0  # [m] likewise, of the other tracks


LEUNG = LeungTrackSettings()


DOUBLE_OVAL = (
    straight(300), left_turn(30, 180), straight(300), left_turn(30, 180),
    right_turn(30, 180), straight(300), right_turn(30, 180),
)  # fmt: skip
RIGHT_TURN = (straight(100), right_turn(5, 90), straight(100))
EIGHT = (straight(145), left_turn(42, 240), straight(145), right_turn(43, 240))
SLALOM = (
    straight(100), left_turn(10, 180), straight(20), right_turn(10, 270), left_turn(5, 90), straight(10),
    left_turn(10, 270), straight(10), right_turn(10, 90), straight(10), left_turn(7.5, 180),
)  # fmt: skip


def hill() -> Track:
    """Up with a growing slope and bank, round a banked turn to the left, and down again (table 4.12).

    In the turn its outer side is the higher one, which the thesis does not say.
    """
    steep, tilted, banked = atan(0.15), -atan(0.05), -atan(0.15)
    up = (
        straight(500), straight(200, grade=atan(0.05)), straight(200, grade=steep),
        straight(200, grade=steep, bank=tilted), straight(200, grade=steep, bank=banked),
        left_turn(LEUNG.hill_radius, LEUNG.hill_angle_deg, grade=steep, bank=banked),
    )  # fmt: skip
    down = (
        left_turn(LEUNG.hill_radius, LEUNG.hill_angle_deg, grade=-steep, bank=banked),
        straight(200, grade=-steep, bank=banked),
        straight(200, grade=-steep, bank=tilted), straight(200, grade=-steep), straight(200, grade=-atan(0.05)),
        straight(500),
    )  # fmt: skip
    return Track(with_clothoids((*up, straight(200), *down), LEUNG.hill_blend), blend=LEUNG.hill_blend)


TRACKS = {
    "double_oval": Track(with_clothoids(DOUBLE_OVAL, LEUNG.oval_transition)),
    "right_turn": Track(with_clothoids(RIGHT_TURN, LEUNG.transition)),
    "eight": Track(with_clothoids(EIGHT, LEUNG.transition)),
    "slalom": Track(with_clothoids(SLALOM, LEUNG.transition)),
    "plain_straight": Track((straight(LEUNG.plain_straight),)),
    "hill": hill(),
}


def on_track(track: Track, speed: float, vehicle: Vehicle) -> Driver:
    """A driver who follows a track at a speed [m/s]."""
    hands, feet = TrackFollower(vehicle, track), SpeedKeeper(vehicle, lambda t: speed)
    return lambda t, q, u: np.array([hands(t, q, u), *feet(t, u)])


def through_lanes(speed: float, vehicle: Vehicle) -> Driver:
    """A driver who changes lanes as in ISO 3888-1, 400 m after the start."""
    hands = PathFollower(vehicle, path(vehicle, LEUNG.lane_change_entry))
    feet = SpeedKeeper(vehicle, lambda t: speed)
    return lambda t, q, u: np.array([hands(t, q, u), *feet(t, u)])


def _manoeuvre(name: str, track: Track, speed: float, title: str, source: str) -> Manoeuvre:
    """On the surface of the track, where it is not level."""
    surface = partial(RoadSurface, track) if track.grade.any() or track.bank.any() else None
    driver = partial(on_track, track, speed)
    return Manoeuvre(name, title, f"Leung 2010, {source}", track.length / speed, speed, driver, surface=surface)


def _lane_change(kph: int) -> Manoeuvre:
    speed = kph / 3.6
    return Manoeuvre(
        f"lane_change_{kph}",
        f"Lane change at {kph} km/h",
        f"Leung 2010, C.2 (ISO 3888-1): {LANES.sections[-1][1]:g} m of lanes after {LEUNG.lane_change_entry:g} m of "
        "straight",
        LEUNG.lane_change_end / speed,
        speed,
        partial(through_lanes, speed),
    )


MANOEUVRES = (
    *(
        _manoeuvre(f"double_oval_{kph}", TRACKS["double_oval"], kph / 3.6, f"Double oval at {kph} km/h", "C.1")
        for kph in LEUNG.speeds_kph
    ),
    *(_lane_change(kph) for kph in LEUNG.speeds_kph),
    _manoeuvre("right_turn", TRACKS["right_turn"], LEUNG.slow_speed, "Right turn of 5 m radius", "C.3"),
    _manoeuvre("eight", TRACKS["eight"], LEUNG.slow_speed, "Figure of eight", "C.4"),
    _manoeuvre("slalom", TRACKS["slalom"], LEUNG.slow_speed, "Slalom of tight turns", "C.5"),
    _manoeuvre("plain_straight", TRACKS["plain_straight"], LEUNG.slow_speed, "Straight", "section 4.4"),
    _manoeuvre("hill", TRACKS["hill"], LEUNG.hill_speed, "Hill with banked turns", "table 4.12"),
)
