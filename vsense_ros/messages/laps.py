"""Laps of a recording, found by where the car has been."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]

FIX = "gps/fix"
METRES = 111_200.0  # per degree of latitude


@dataclass(frozen=True)
class LapSettings:
    """How laps are recognised in positions: decisions of this project."""

    step: float = 2.0  # [m] between the places that are looked at
    moved: float = 20.0  # [m] from the first fix to where a lap begins, so that the car has a direction
    near: float = 15.0  # [m] beside the place where a lap begins
    shortest: float = 150.0  # [m] of a lap
    least: float = 0.7  # [-] of the longest lap, below which the last one is not complete


SETTINGS = LapSettings()

SAME_WAY = np.cos(0.6)  # of the directions there


def laps(recording: Recording) -> list[Recording]:
    """The laps of a recording, from one pass of the place where it sets out to the next; what is behind the
    last is none, unless it is most of a lap. The recording itself where there are no two."""
    channel = recording.channels.get(FIX)
    if channel is None or len(channel) < 10:
        return [recording]
    latitude, longitude = (channel.columns[name][:, 0] for name in ("latitude", "longitude"))
    good = np.isfinite(latitude) & np.isfinite(longitude)
    if good.sum() < 10:
        return [recording]
    seconds = (channel.stamp[good] - recording.first_stamp) * 1e-9
    east = np.radians(longitude[good] - longitude[good][0]) * np.cos(np.radians(latitude[good][0]))
    north = latitude[good] - latitude[good][0]
    place = METRES * np.column_stack([np.degrees(east), north])
    t, x, y = _by_way(np.asarray(seconds, dtype=np.float64), np.asarray(place, dtype=np.float64))
    begins = _passes(x, y)
    if len(begins) < 2:
        return [recording]
    limits = [float(t[i]) for i in begins]
    lengths = np.diff([*limits, float(t[-1])])
    count = len(limits) if lengths[-1] > SETTINGS.least * lengths[:-1].max() else len(limits) - 1
    ends = [*limits[1:], float(t[-1])]
    return [
        replace(recording.between(begin, end), name=f"{recording.name} lap {number}")
        for number, (begin, end) in enumerate(zip(limits[:count], ends, strict=False), start=1)
    ]


def _by_way(seconds: Array, place: Array) -> tuple[Array, Array, Array]:
    """Times and places (n, 2) every `SETTINGS.step` of the way, from its smoothed course."""
    moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place, axis=0).T))])
    moving = np.concatenate([[True], np.diff(moved) > 1e-6])
    distance = np.arange(0.0, moved[-1], SETTINGS.step)
    return tuple(np.interp(distance, moved[moving], v[moving]) for v in (seconds, place[:, 0], place[:, 1]))  # type: ignore[return-value]


def _passes(x: Array, y: Array) -> list[int]:
    """Where the car comes by the place of the beginning, each time at its nearest."""
    first, ahead = round(SETTINGS.moved / SETTINGS.step), round(10.0 / SETTINGS.step)
    if len(x) < first + ahead + round(SETTINGS.shortest / SETTINGS.step):
        return []
    course = np.arctan2(np.gradient(y, 5.0), np.gradient(x, 5.0))
    first_direction = np.array([x[first + ahead] - x[first], y[first + ahead] - y[first]])
    along = np.cos(course - np.arctan2(first_direction[1], first_direction[0]))
    distance_from_begin = np.hypot(x - x[first], y - y[first])
    at_begin = (distance_from_begin < SETTINGS.near) & (along > SAME_WAY)
    passes = [first]
    while True:
        later = np.flatnonzero(at_begin[passes[-1] + round(SETTINGS.shortest / SETTINGS.step) :])
        if not len(later):
            return passes
        begin = passes[-1] + round(SETTINGS.shortest / SETTINGS.step) + int(later[0])
        end = begin + round(2 * SETTINGS.near / SETTINGS.step)
        passes.append(begin + int(np.argmin(distance_from_begin[begin:end])))
