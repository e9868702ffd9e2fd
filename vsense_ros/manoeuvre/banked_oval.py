"""A lap of an oval whose turns are banked and whose road is crowned."""

from __future__ import annotations

from functools import partial
from math import atan

from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.leung_tracks import on_track
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.track import Track, left_turn, straight, with_clothoids

SPEED = 20.0  # [m/s]
RADIUS, SIDE = 60.0, 80.0  # [m]
BANK = -atan(0.2)  # in the turns the outer side is the higher one
BLEND, CLOTHOID = 40.0, 40.0  # [m]
CROWN = 0.007  # [1/m]: 2.5 % at 1.8 m beside the middle

PIECES = (straight(SIDE), left_turn(RADIUS, 180, bank=BANK), straight(SIDE), left_turn(RADIUS, 180, bank=BANK))
TRACK = Track(with_clothoids((*PIECES, straight(SIDE)), CLOTHOID), blend=BLEND)

MANOEUVRE = Manoeuvre(
    "banked_oval",
    "A lap of a banked oval",
    f"turns of {RADIUS:g} m with a bank of 20 %, crowned, at 72 km/h",
    (TRACK.length - SIDE / 2) / SPEED,
    SPEED,
    partial(on_track, TRACK, SPEED),
    surface=partial(RoadSurface, TRACK, CROWN),
)
