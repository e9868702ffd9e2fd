"""The vehicle file with what was fitted to recordings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.road import place_of, profile
from vsense_ros.mismatch.road_in_windows import abscissae
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.effects import EVERY
from vsense_ros.model.vehicle import Vehicle


def extended(vehicle: Vehicle, dataset: Dataset, parameter_set: ParameterSet) -> Vehicle:
    """The vehicle with what was fitted: base parameters, and the effects that have a size."""
    effects: dict[str, dict[str, Any]] = {}
    for id, kind in EVERY.items():
        names = {name: f"effects.{id}.{name}" for name in kind.model_fields}
        values: dict[str, Any] = {
            name: parameter_set.values[d] for name, d in names.items() if d in parameter_set.values
        }
        if profile := _profile(vehicle, dataset, parameter_set, id):
            values["profile"] = profile
        if any(value != kind.model_fields[name].default for name, value in values.items()):
            effects[id] = values
    known = vehicle.values()
    changes = {name: value for name, value in parameter_set.values.items() if name in known}
    physics = vehicle.with_parameters(changes).physics.model_dump()
    physics["effects"] = effects
    return vehicle.model_copy(
        update={
            "name": f"{vehicle.name}, extended",
            "physics": type(vehicle.physics).model_validate(physics),
        }
    )


def _profile(vehicle: Vehicle, dataset: Dataset, parameter_set: ParameterSet, id: str) -> tuple[tuple[float, ...], ...]:
    """Rows of `RoadEffect.profile`: those of the file with what was fitted added, and places that it did not have."""
    fitted = {}
    for name, value in parameter_set.values.items():
        size, abscissa = place_of(name) or ("", 0.0)
        if size.startswith(f"effects.{id}."):
            fitted[abscissa] = value
    rows = getattr(getattr(vehicle.physics.effects, id), "profile", ())
    if not fitted:
        return rows
    known = list(zip(rows, abscissae(rows, dataset), strict=True))
    in_file = {at: row[-1] for row, at in known if at is not None}
    moved = [(*row[:3], row[3] + (_at(fitted, at) if at is not None else 0.0)) for row, at in known]
    for abscissa, value in fitted.items():
        if (at := dataset.road.place(abscissa)) is not None:
            place = *dataset.on_map.latitude_longitude(*at[:2]), at[2]
            moved.append((*place, value + _at(in_file, abscissa)))
    return tuple(moved)


def _at(points: Mapping[float, float], abscissa: float) -> float:
    return float(profile(points, np.array([abscissa]))[0]) if points else 0.0
