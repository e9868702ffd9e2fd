"""Parameters of a car with every effect of the library, of which some may change along the road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import torque_shares
from vsense_ros.mismatch.road import place_of, profile, profile_change
from vsense_ros.model.effects import EVERY, Effect, Effects
from vsense_ros.model.effects.base import bounds
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]
Profiles = Mapping[str, Mapping[float, float]]  # values by abscissa [m], by the name of the size


def with_all_effects(vehicle: Vehicle) -> Vehicle:
    """The vehicle with every effect of the library present, of size zero where the file does not have it."""
    effects = vehicle.physics.effects
    every = {id: getattr(effects, id) or effect() for id, effect in EVERY.items()}
    return vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": Effects(**every)})})


def parameters_of(vehicle: Vehicle) -> ParameterSet:
    """One car on one road: physical parameters by name, effects that the vehicle file does not have with size zero, and
    what is assumed of unknown torques. A search adds by the names of `road.point` what a size is at places along the
    road, beyond what it is everywhere."""
    return ParameterSet({**with_all_effects(vehicle).values(), **torque_shares(vehicle)})


def effect_of(parameter_set: ParameterSet, id: str, varying: Mapping[str, Array] | None = None) -> Effect:
    """An effect with its present parameters, some of which may be `varying`."""
    kind, known = EVERY[id], {**parameter_set.values, **(varying or {})}
    names = {field: f"effects.{id}.{field}" for field in kind.model_fields}
    return kind.model_construct(None, **{f: known[name] for f, name in names.items() if name in known})


def profiles_of(parameter_set: ParameterSet) -> Profiles:
    """What sizes are at places along the road, beyond what they are everywhere."""
    profiles: dict[str, dict[float, float]] = {}
    for name, value in parameter_set.values.items():
        if (at := place_of(name)) is not None:
            profiles.setdefault(at[0], {})[at[1]] = value
    return profiles


def varying_sizes(values: Mapping[str, float], profiles: Sequence[Profiles], place: Array) -> dict[str, Array]:
    """Sizes that are not constant along places with these abscissae [m], by name, where `values` are what they are
    everywhere and each of the `profiles` adds to that."""
    deviations: dict[str, Array] = {}
    for name, points in (pair for one in profiles for pair in one.items()):
        deviations[name] = deviations.get(name, 0.0) + profile(points, place)
    return {name: np.clip(values[name] + v, *_physical(name)) for name, v in deviations.items() if v.any()}


def change_along_road(name: str, profiles: Sequence[Profiles], place: Array) -> Array:
    """What a size changes by per metre at places with these abscissae [m]."""
    return sum((profile_change(one[name], place) for one in profiles if name in one), np.zeros(len(place)))


@cache
def _physical(name: str) -> tuple[float, float]:
    """Least and largest value of a parameter of an effect, by its dotted name."""
    _, id, field = name.split(".")
    return bounds(EVERY[id].model_fields[field])
