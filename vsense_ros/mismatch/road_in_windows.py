"""The road that a car meets in each window: its slopes, and the sizes of effects that change along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import size_of
from vsense_ros.mismatch.effect_parameters import Profiles, change_along_road, effect_of, profiles_of, varying_sizes
from vsense_ros.mismatch.prediction_settings import middle_of_steps
from vsense_ros.mismatch.road import bending, curvature
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.coordinates import BANK, BANK_CHANGE, DISTURBANCES, GRADE, GRADE_CHANGE
from vsense_ros.model.effects import BY_ID, Effect
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

_FIX = ("latitude", "longitude", "altitude")
_SLOPING = tuple(id for id, effect in BY_ID.items() if effect.slope is not Effect.slope)


@dataclass(frozen=True)
class RoadInWindow:
    """The road that a car meets in a window; its arrays are shared and not to be changed."""

    key: int  # the same where all of it is
    around: Array  # (n, 7) as model.coordinates.DISTURBANCES
    felt: Mapping[str, Array]  # (n,) by name, of parameters of the motion that change along it


class RoadsInWindows:
    """The roads of a data set for a vehicle with all effects. `start` are the parameters of its file, and `moving` the
    names of parameters that the motion depends on. The roads of the last `kept` sets of parameters are kept."""

    def __init__(
        self, vehicle: Vehicle, dataset: Dataset, start: ParameterSet, moving: frozenset[str], kept: int
    ) -> None:
        self.vehicle, self.dataset, self.start = vehicle, dataset, start
        self._moving, self._kept = moving, kept
        self._met: dict[tuple, list[RoadInWindow]] = {}

    def roads(self, parameter_set: ParameterSet) -> list[RoadInWindow]:
        """The road that the car meets in each window; those that it met last are known."""
        profiles = [self.profiles_of_file, profiles_of(parameter_set)]
        values = parameter_set.values
        points = tuple((name, values[name], *at.items()) for one in profiles for name, at in one.items())
        key = *(values[name] for name in self._sizes_of_slopes), points
        if key not in self._met:
            if len(self._met) >= self._kept:
                self._met.pop(next(iter(self._met)))
            windows = range(len(self.dataset.windows))
            self._met[key] = [self._road(index, parameter_set, profiles) for index in windows]
        return self._met[key]

    @cached_property
    def _sizes_of_slopes(self) -> list[str]:
        """Names of all that slopes depend on, but for what they are at places."""
        return [
            f"effects.{id}.{n}"
            for id in _SLOPING
            for n in BY_ID[id].model_fields
            if f"effects.{id}.{n}" in self.start.values
        ]

    def _road(self, index: int, parameter_set: ParameterSet, profiles: Sequence[Profiles]) -> RoadInWindow:
        turned, place = self.way[index]
        varying = varying_sizes(parameter_set.values, profiles, place)
        around = np.zeros((len(place), len(DISTURBANCES)))
        for id in _SLOPING:
            effect = effect_of(parameter_set, id, varying)
            along, across = effect.slope(turned)
            around[:, GRADE] += along
            around[:, BANK] += across
            if not np.any([along, across]):
                continue
            change = {size_of(id): change_along_road(size_of(id), profiles, place)}
            changes = effect_of(parameter_set, id, change).slope(turned)
            bend, twist = bending(effect.slope, changes, turned, self._curvature[index])
            around[:, GRADE_CHANGE] += bend
            around[:, BANK_CHANGE] += twist
        felt = {n: v for n, v in varying.items() if n in self._moving}
        key = hash((around.tobytes(), *((name, values.tobytes()) for name, values in felt.items())))
        return RoadInWindow(key, around, felt)

    @cached_property
    def way(self) -> list[tuple[Array, Array]]:
        """By how much the car has turned [rad], and abscissa [m], in the middle of each step, by window."""
        return [
            tuple(np.interp(middle_of_steps(w), known.t, known.value[:, 0]) for known in (w.turned, w.place))  # type: ignore[misc]
            for w in self.dataset.windows
        ]

    @cached_property
    def _curvature(self) -> list[Array]:
        """Curvature of the road in the middle of each step [1/m], by window."""
        return [curvature(place, turned) for turned, place in self.way]

    @cached_property
    def profiles_of_file(self) -> Profiles:
        """The profiles of the vehicle file, on the road of the data."""
        profiles: dict[str, dict[float, float]] = {}
        for id in BY_ID:
            rows = getattr(getattr(self.vehicle.physics.effects, id), "profile", ())
            for row, abscissa in zip(rows, abscissae(rows, self.dataset), strict=True):
                if abscissa is not None:
                    profiles.setdefault(size_of(id), {})[abscissa] = row[-1]
        return profiles


def abscissae(rows: Sequence[tuple[float, float, float, float]], dataset: Dataset) -> list[float | None]:
    """Where on the road of the recordings the rows of a `RoadEffect.profile` are [m]; None where nobody has been."""
    places = []
    for latitude, longitude, heading, _ in rows:
        fix = {k: np.array([v]) for k, v in zip(_FIX, (latitude, longitude, 0.0), strict=True)}
        at = dataset.on_map.placed(fix)
        places.append(dataset.road.abscissa_of(float(at["east"][0]), float(at["north"][0]), heading))
    return places
