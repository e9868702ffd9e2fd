"""What a vehicle file knows of roads from place to place, as the observer comes by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.reading import Map
from vsense_ros.model import road_profile
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import YAW, X, Y
from vsense_ros.model.effects.base import SPACING, Effect, RoadEffect
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import CarFilter

Array = NDArray[np.float64]
Rows = tuple[tuple[float, float, float, float], ...]  # of `RoadEffect.profile`

NEAR = 25.0  # [m] beside the chord of two rows: a lane, an error of GNSS, and what the road bends between them
JOINED = 1.5 * SPACING  # [m] from one row to the next, up to which there is a road between them
LOOK_EVERY = 5.0  # [m]
PLACED = 10.0  # [m] standard deviation of the position, from where on nobody knows which road it is
SAME_WAY = 0.5  # cosine between the car's direction and that of the road it drives on


@dataclass(frozen=True)
class RoadAtCar:
    """The road where the car is."""

    slopes: Array  # (2,) along and across, positive uphill and with the left side higher [rad]
    changes: Array  # (2,) of these along the way [rad/m], as far as profiles have them
    on_profile: Array  # (2,) 1 for each of them that a profile has, 0 where it is as everywhere, or on the way there
    sizes: Mapping[str, float]  # of effects, by dotted name


class RoadMap:
    """The profiles of a vehicle file, on the map of an observer."""

    def __init__(self, vehicle: Vehicle, on_map: Map) -> None:
        self._effects = vehicle.physics.effects.present()
        self._on_map = on_map
        self._profiles: dict[str, Profile] = {}  # by id, once the map has an origin
        names = car_of(vehicle).parameter_names
        # What the observer estimates itself is no longer that of the file.
        self._parameters = {n: i for i, n in enumerate(names) if n not in vehicle.observer.parameters}

    @classmethod
    def of(cls, vehicle: Vehicle, on_map: Map) -> RoadMap | None:
        """The map of a vehicle file that has profiles, and a sensor of the position; None for others."""
        placed = any("position" in sensor.measures for sensor in vehicle.sensors.values())
        return cls(vehicle, on_map) if placed and any(map(_rows, vehicle.physics.effects.present())) else None

    def follow(self, filter: CarFilter) -> None:
        """Give a filter, which knows its heading, the road where its car has come to: as it is everywhere, if nobody
        knows where that is."""
        car = filter.car
        east, north, last_east = car.mean.item(X), car.mean.item(Y), car.surveyed.item(0)
        if hypot(east - last_east, north - car.surveyed.item(1)) < LOOK_EVERY:
            return
        sure = car.covariance.item(X, X) + car.covariance.item(Y, Y) < PLACED**2
        if not (sure or isfinite(last_east)):
            return
        road = self.at(east, north, car.mean.item(YAW)) if sure else self._by_profiles({})
        if road is None:
            return
        car.follow_slopes(road.slopes, road.changes, car.surveyed[2:] * road.on_profile)
        for name, size in road.sizes.items():
            if name in self._parameters:
                car.parameters[self._parameters[name]] = size
        car.surveyed[:2], car.surveyed[2:] = (east, north) if sure else np.inf, road.on_profile
        filter.linearize()

    def at(self, east: float, north: float, heading: float) -> RoadAtCar | None:
        """The road at a place on the map [m], for who drives in a direction [rad]; None before the first fix."""
        if self._on_map.origin is None:
            return None
        if not self._profiles:
            self._profiles = {e.id: Profile(_rows(e), self._on_map) for e in self._effects if _rows(e)}
        return self._by_profiles({id: profile.at(east, north, heading) for id, profile in self._profiles.items()})

    def _by_profiles(self, surveyed: Mapping[str, Surveyed]) -> RoadAtCar:
        """The road by what profiles say of this place, by the id of their effect."""
        slopes, changes, on_profiles, sizes = np.zeros(2), np.zeros(2), np.zeros(2), {}
        for effect in self._effects:
            if isinstance(effect, RoadEffect) and effect.profile:
                deviation, change, on_profile = surveyed.get(effect.id, NOWHERE)
                name = effect.size_name()
                if on_profile:
                    by_size = slope_by_size(effect)
                    on_profiles += by_size != 0.0
                    changes += change * by_size
                effect = effect.model_copy(update={name: getattr(effect, name) + deviation})
                sizes[f"effects.{effect.id}.{name}"] = getattr(effect, name)
            slopes += effect.mean_slope
        return RoadAtCar(slopes, changes, np.minimum(on_profiles, 1.0), sizes)


class Surveyed(NamedTuple):
    """The value of a profile at a place."""

    value: float  # beyond what the size is everywhere
    change: float  # of it along the way [1/m]
    surveyed: bool  # whether the place lies between two rows


NOWHERE = Surveyed(0.0, 0.0, False)


class Profile:
    """What a size is along a road beyond what it is everywhere: between places, which are rows of `RoadEffect.profile`
    in the order in which the road comes to them, without kinks."""

    def __init__(self, rows: Rows, on_map: Map) -> None:
        east, north, self._direction, self._value, self._change = with_changes(rows, on_map).T
        self._at = np.column_stack([east, north])
        length, joined = joined_chords(self._at)
        self._begin, self._length = joined, length[joined]
        self._along = np.diff(self._at, axis=0)[joined] / self._length[:, None]

    def at(self, east: float, north: float, heading: float) -> Surveyed:
        """What it says of a place [m] for who drives in a direction [rad]; beyond the last row the value falls to
        zero, which it is off the road."""
        place, direction = np.array([east, north]), np.array([np.cos(heading), np.sin(heading)])
        offset = place - self._at[self._begin]
        along = np.sum(offset * self._along, axis=1)
        across = np.abs(offset[:, 0] * self._along[:, 1] - offset[:, 1] * self._along[:, 0])
        share = along / self._length
        on = (share >= 0) & (share <= 1) & (across < NEAR) & (self._along @ direction > SAME_WAY)
        if on.any():
            i = int(np.argmin(np.where(on, across, np.inf)))
            pair = slice(self._begin[i], self._begin[i] + 2)
            place_on = share.item(i), self._length.item(i)
            return Surveyed(*road_profile.between(*place_on, self._value[pair], self._change[pair]), True)
        east, north = (place - self._at).T
        ahead, sideways = np.cos(self._direction), np.sin(self._direction)
        along, across = np.abs(east * ahead + north * sideways), np.abs(north * ahead - east * sideways)
        nearby = (along < SPACING) & (across < NEAR) & (np.cos(heading - self._direction) > SAME_WAY)
        if not nearby.any():
            return NOWHERE
        i = int(np.argmin(np.where(nearby, along, np.inf)))
        ending, beginning = share[self._begin == i - 1], share[self._begin == i]
        if np.any(ending > 1) and np.any(beginning < 0):  # outside of a bend, abreast of the row
            return Surveyed(float(self._value[i]), float(self._change[i]), True)
        return Surveyed(float(self._value[i] * (1 - along[i] / SPACING)), 0.0, False)


def with_changes(rows: Rows, on_map: Map) -> Array:
    """Rows of a `RoadEffect.profile` on a map, (n, 5): `places`, and what the value changes by along the road [1/m]."""
    placed_rows = places(rows, on_map)
    length, joined = joined_chords(placed_rows[:, :2])
    ends = np.setdiff1d(np.arange(len(length)), joined) + 1
    distance = np.concatenate([[0.0], np.cumsum(length)])
    stretches = zip(np.split(distance, ends), np.split(placed_rows[:, 3], ends), strict=True)
    return np.column_stack([placed_rows, np.concatenate([road_profile.changes(*stretch) for stretch in stretches])])


def joined_chords(places_of_rows: Array) -> tuple[Array, NDArray[np.int64]]:
    """How far it is from each place (n, 2) to the next [m], (n - 1,), and which of them (k,) are joined by a road."""
    length = np.linalg.norm(np.diff(places_of_rows, axis=0), axis=1)
    return length, np.flatnonzero((length > 0) & (length < JOINED)).astype(np.int64)


def places(rows: Rows, on_map: Map) -> Array:
    """Rows of a `RoadEffect.profile` on a map: east, north [m], direction [rad] and value (n, 4)."""
    fixes = ({"latitude": [row[0]], "longitude": [row[1]], "altitude": [0.0]} for row in rows)
    placed = [on_map.placed({name: np.array(value) for name, value in fix.items()}) for fix in fixes]
    return np.array(
        [[float(place["east"][0]), float(place["north"][0]), *row[2:]] for place, row in zip(placed, rows, strict=True)]
    )


def slope_by_size(effect: RoadEffect) -> Array:
    """What its mean slopes (2,) are for a size of one [rad]."""
    return np.array(effect.model_copy(update={effect.size_name(): 1.0}).mean_slope, dtype=float)


def _rows(effect: Effect) -> Rows:
    return effect.profile if isinstance(effect, RoadEffect) else ()
