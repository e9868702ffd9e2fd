"""What a filter of GNSS and inertial sensors starts with: the first readings of its sensors, once they suffice.

It starts once its inputs have come and, if it estimates a heading, once the heading is known: by two antennas, or by
the course of a car that moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.model.sensors import SensorBase
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.readings import INPUTS, SPEED

ALIGNMENT_SPEED = 2.0  # [m/s] above it the course is the heading of a car
FASTEST = 150.0  # [m/s] beyond which a speed is none of a car
_TOGETHER = 5_000_000_000  # [ns] within which first readings belong to one start


class Beginning:
    """The newest reading of each sensor, in the axes of the car, until they suffice to start."""

    def __init__(self, filter: Aided, numbers: Mapping[str, float], sensors: Mapping[str, SensorBase]) -> None:
        self._filter, self._numbers, self._sensors = filter, numbers, sensors
        self._states = {name.rpartition(".")[2] for name in filter.names}
        self.readings: dict[str, tuple[int, Array]] = {}  # stamp [ns] and value of each

    def add(self, sensor: str, stamp: int, value: Array) -> tuple[int, dict[str, float]] | None:
        """Keep a reading; the time [ns] to start at and what is known there, by the names of states and numbers, once
        that suffices."""
        self.readings = {k: reading for k, reading in self.readings.items() if abs(reading[0] - stamp) < _TOGETHER}
        self.readings[sensor] = stamp, value
        if self.missing():
            return None
        known = self._known()
        return None if known is None else (max(read_at for read_at, _ in self.readings.values()), known)

    def clear(self) -> None:
        """Forget all readings and begin anew."""
        self.readings.clear()

    def missing(self) -> list[str]:
        """What the filter needs and the sensors that have come do not measure."""
        names, measures = self._filter.input_names, {key: self._sensors[key].measures for key in self.readings}
        missing = []
        for name in names:
            if name in INPUTS and "held" not in name:
                quantity, places = INPUTS[name]
                values = (value for key, (_, value) in self.readings.items() if quantity in measures[key])
                if not any(np.isfinite(value[places[0]]) for value in values):
                    missing.append(f"{name} ({quantity})")
        needs_course = SPEED in names or bool(self._states & {"yaw", "forward_velocity", "velocity_east"})
        if needs_course and not any("course" in measured for measured in measures.values()):
            missing.append("course")
        return missing

    def _known(self) -> dict[str, float] | None:
        """What the readings and the car's numbers give, by the names of states and numbers; None if that is not
        enough."""
        values: dict[str, float] = dict(self._numbers)
        for key, (_, value) in self.readings.items():
            measures = self._sensors[key].measures
            if "rates and forces" in measures and np.isfinite(value[2]):
                values["yaw_rate"] = float(value[2])
            if "position" in measures and np.isfinite(value).all():
                values["east"], values["north"] = value.tolist()
            if "heading" in measures and np.isfinite(value).all():
                values["yaw"] = float(np.arctan2(value[1], value[0]))
            if "course" in measures and np.isfinite(value).all():
                speed = hypot(*value.tolist())
                if speed < FASTEST:
                    values["forward_velocity"] = speed
                    values["velocity_east"], values["velocity_north"] = value.tolist()
                if ALIGNMENT_SPEED < speed < FASTEST:
                    values.setdefault("yaw", float(np.arctan2(value[1], value[0])))
        if self._filter.definition.finds_heading:
            return values if "forward_velocity" in values else None
        required = {"yaw" if name == "q_w" else name for name in self._states & {"yaw", "forward_velocity", "q_w"}}
        return None if required - set(values) else values
