"""A lap of an oval whose turns are banked and whose road is crowned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import atan

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.leung_tracks import on_track
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.track import Track, left_turn, straight, with_clothoids


@dataclass(frozen=True)
class BankedOvalSettings:
    """Shape of the track: a decision of this project."""

    speed: float = 20.0  # [m/s]
    radius: float = 60.0  # [m] of the turns
    side: float = 80.0  # [m] length of each straight
    bank: float = -atan(0.2)  # [rad] in the turns, whose outer side is the higher one
    blend: float = 40.0  # [m] over which the bank changes
    clothoid: float = 40.0  # [m] between straights and turns
    crown: float = 0.007  # [1/m] curvature across the road: 2.5 % at 1.8 m beside the middle


SETTINGS = BankedOvalSettings()


PIECES = (
    straight(SETTINGS.side),
    left_turn(SETTINGS.radius, 180, bank=SETTINGS.bank),
    straight(SETTINGS.side),
    left_turn(SETTINGS.radius, 180, bank=SETTINGS.bank),
)
TRACK = Track(with_clothoids((*PIECES, straight(SETTINGS.side)), SETTINGS.clothoid), blend=SETTINGS.blend)

MANOEUVRE = Manoeuvre(
    "banked_oval",
    "A lap of a banked oval",
    f"turns of {SETTINGS.radius:g} m with a bank of 20 %, crowned, at 72 km/h",
    (TRACK.length - SETTINGS.side / 2) / SETTINGS.speed,
    SETTINGS.speed,
    partial(on_track, TRACK, SETTINGS.speed),
    surface=partial(RoadSurface, TRACK, SETTINGS.crown),
)
