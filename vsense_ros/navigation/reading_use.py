"""What a filter uses a sensor's readings for: its inputs, measurements and conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, largest_nis
from vsense_ros.model.sensors import SensorBase, words_of
from vsense_ros.navigation.memory import Memory
from vsense_ros.navigation.readings import (
    CONDITIONS_AT,
    INPUTS,
    MEASUREMENTS,
    SPEED,
    RollingSpeed,
    travelling_speed,
)
from vsense_ros.navigation.space import Definition


class Use(NamedTuple):
    """What a reading is used for: inputs by (place in the filter, place in the reading), the input `speed`, remembered
    inputs, measurements by name with how they are made, the largest normalized innovation squared that is believed and
    their usual variances, and conditions with zeros and variances."""

    inputs: tuple[tuple[int, int], ...]
    speed: Callable[[Array], float] | None
    remembered: tuple[Memory, ...]
    measurements: tuple[tuple[str, Callable[[Array, Array], tuple[Array, Array]], float, Array], ...]
    conditions: tuple[tuple[str, Array, Array], ...]
    gate: float

    @classmethod
    def of(
        cls,
        sensor: SensorBase,
        definition: Definition,
        input_names: Sequence[str],
        memories: Sequence[Memory],
        speed: Callable[[Array], float] | None,
    ) -> Use:
        """The use of a sensor in the filter of a definition; `speed` gives the speed of the car [m/s] from a
        reading."""
        measured, gate = sensor.measures, sensor.gate
        inputs = tuple(
            (i, INPUTS[name].places[0])
            for i, name in enumerate(input_names)
            if name in INPUTS and INPUTS[name].measures in measured
        )
        measurements, conditions = [], []
        for measurement in definition.measurements:
            source = MEASUREMENTS.get(measurement.name)
            if source is not None and source.measures in measured:
                limit = largest_nis(gate, len(measurement.deviations)) if sensor.deviations().any() else np.inf
                measurements.append((measurement.name, source.of, limit, measurement.variances))
            elif source is None and CONDITIONS_AT in measured:
                conditions.append((measurement.name, np.zeros(len(measurement.deviations)), measurement.variances))
        remembered = tuple(memory for memory in memories if memory.remembered.measures in measured)
        speed = speed if SPEED in input_names else None
        return cls(inputs, speed, remembered, tuple(measurements), tuple(conditions), gate)

    @property
    def does_something(self) -> bool:
        """True if a reading changes the filter."""
        return bool(self.inputs or self.speed or self.remembered or self.measurements or self.conditions)

    def largest(self, own_limit: float, limit: float, components: int) -> float:
        """The largest normalized innovation squared that is believed of a measurement with its `own_limit`, where that
        of a reading of so many components is `limit`."""
        if not (isfinite(limit) and isfinite(own_limit)):
            return np.inf
        return own_limit * (limit / largest_nis(self.gate, components))


def check_sensors(
    name: str, definition: Definition, input_names: Sequence[str], sensors: Mapping[str, SensorBase]
) -> None:
    """Raise `InputError` if none of the sensors measures what an input of the filter `name` needs, or nothing measures
    what any of its measurements does."""
    measured: set[str] = {quantity for sensor in sensors.values() for quantity in sensor.measures}
    kinds = ", ".join(sorted({words_of(sensor.kind) for sensor in sensors.values()})) or "none"
    for input_name in input_names:
        source = INPUTS.get(input_name)
        if source is not None and source.measures not in measured:
            raise InputError(
                f"the filter {name!r} needs the input {input_name}, of a sensor that measures {source.measures!r}; "
                f"the vehicle file lists {kinds}"
            )
    names = [measurement.name for measurement in definition.measurements if measurement.name in MEASUREMENTS]
    if names and not any(MEASUREMENTS[one].measures in measured for one in names):
        raise InputError(
            f"the filter {name!r} is corrected by {', '.join(names)}, of a sensor that measures "
            f"{MEASUREMENTS[names[0]].measures!r}; the vehicle file lists {kinds}"
        )


def usable(sensors: Mapping[str, SensorBase]) -> dict[str, SensorBase]:
    """The sensors that any filter of this package could use."""
    measurable = {source.measures for source in INPUTS.values()} | {source.measures for source in MEASUREMENTS.values()}
    return {key: sensor for key, sensor in sensors.items() if not measurable.isdisjoint(sensor.measures)}


def speed_from(sensor: SensorBase, sensors: Mapping[str, SensorBase], radius: float) -> Callable[[Array], float] | None:
    """How a reading gives the input `speed`, if it is this sensor that does."""
    rolling = any("rolling speed" in other.measures for other in sensors.values())
    if rolling and "rolling speed" in sensor.measures:
        return RollingSpeed(radius)
    if not rolling and "course" in sensor.measures:
        return travelling_speed
    return None
