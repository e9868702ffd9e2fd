"""The numbers of one car by name: what a fit starts from, and what it arrives at.

Physical parameters have the names that they have everywhere (`chassis.mass`, as in `Vehicle.values`); all other numbers
of a vehicle file have their path in it (`sensors.imu.force_noise.0`, `reference.position.0`). Who fits may add numbers
of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from vsense_ros.model.vehicle import Vehicle

Values = Mapping[str, float]

EXACT = 17  # significant digits that distinguish any two numbers
_PHYSICS = "physics."


@dataclass(frozen=True)
class ParameterSet:
    """Numbers of a model by name."""

    values: Values

    def changed(self, changes: Values) -> ParameterSet:
        """This set with some numbers changed or added."""
        return ParameterSet({**self.values, **changes})


def of_vehicle(vehicle: Vehicle) -> ParameterSet:
    """All numbers of a vehicle file."""
    return ParameterSet({name: float(node[key]) for name, node, key in _numbers(vehicle.model_dump(mode="json"))})


def with_values(vehicle: Vehicle, parameter_set: ParameterSet, digits: int = EXACT) -> Vehicle:
    """The vehicle with the numbers of a set; those that differ are rounded to so many significant digits.

    Raises `KeyError` for a name that the vehicle file does not have, and `ValueError` if no vehicle can be like that.
    """
    data = vehicle.model_dump(mode="json")
    places = {name: (node, key) for name, node, key in _numbers(data)}
    for name, value in parameter_set.values.items():
        if name not in places:
            raise KeyError(f"the vehicle file of {vehicle.name} has no number {name}")
        node, key = places[name]
        if value != node[key]:
            node[key] = rounded(value, digits)
    return Vehicle.model_validate(data)


def rounded(value: float, digits: int) -> float:
    """A number with so many significant digits."""
    return float(f"{value:.{digits}g}")


def _numbers(node: Any, name: str = "") -> Iterator[tuple[str, Any, str | int]]:
    """All numbers below a node of a vehicle file: the name of each, what holds it, and its key there."""
    keys: Iterator[tuple[str | int, Any]] = iter(node.items() if isinstance(node, dict) else enumerate(node))
    for key, value in keys:
        path = f"{name}{key}"
        if isinstance(value, dict | list):
            yield from _numbers(value, f"{path}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield path.removeprefix(_PHYSICS), node, key
