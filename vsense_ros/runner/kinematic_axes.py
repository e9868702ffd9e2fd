"""The axes of an inertial sensor that is mounted in others than those of the car, and readings in those of the car."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.timeline import Channel, Event
from vsense_ros.model.sensors import SensorBase
from vsense_ros.navigation.aided import Aided
from vsense_ros.runner.inertial_axes import InertialAxes, Judged

Array = NDArray[np.float64]


class KinematicAxes(InertialAxes):
    """The axes of the first inertial sensor of a filter, which are inputs or measurements in the axes of the car."""

    filter: Aided

    def __init__(self, filter: Aided, sensors: Mapping[str, SensorBase]) -> None:
        super().__init__(filter)
        self.sensors, self._list = sensors, tuple(sensors.values())
        self._placed = [_placed(sensor) for sensor in self._list]
        self._of_car, self._of_sensor, self._order = self._axes_of_car()

    def _axes_of_car(self) -> tuple[list[int], list[int], Array | None]:
        """For each axis of the inertial sensor the nearest one of the car, the reverse of that, and the order in which
        components of an innovation by axes of the car are those of the sensor; None where nothing changes."""
        same = list(range(6))
        if self.filter.inertial is None:
            return same, same, None
        sensor = self.sensors[self.filter.inertial]
        of_car = []
        for axis in range(6):
            probe = np.zeros((1, 6))
            probe[0, axis] = np.nan
            absent = np.flatnonzero(np.isnan(sensor.in_axes_of_car(probe)[0]))
            of_car.append(int(absent[0]) if len(absent) == 1 else axis)
        if of_car == same or sorted(of_car) != same:
            return same, same, None
        order = np.array([*of_car, *range(6, 6 + len(self.filter.conditions))])
        return of_car, [of_car.index(axis) for axis in range(6)], order

    def in_axes_of_car(self, event: Event) -> Array:
        """The reading in the axes of the car, at cog as far as rates alone determine it."""
        sensor, value = self._list[event.sensor], event.value
        if (placed := self._placed[event.sensor]) is not None:
            value = placed(value)
        elif "heading" in sensor.measures and (heading := sensor.heading(value, event.variance)) is not None:
            value = np.array([np.cos(heading[0]), np.sin(heading[0])])
        return value

    def axes(self) -> dict[int, Judged]:
        key = self.filter.inertial
        judged = tuple(self._of_sensor[axis] for axis in self.filter.judged)
        if key is None or not judged:
            return {}
        words = tuple(one.words for one in self.sensors[key].components)
        conditions = len(self.filter.conditions)
        return {list(self.sensors).index(key): Judged(words, judged, conditions, self.sensors[key].gate)}

    def correct(self, channel: Channel, event: Event, gate: float) -> Innovation:
        innovation = self.filter.correct(channel.name, self.in_axes_of_car(event), event.variance, channel.limit)
        return self._in_axes_of_sensor(innovation)

    def correct_by_axis(self, channel: Channel, event: Event, gate: float) -> Iterator[tuple[int, Innovation]]:
        """The axes of the reading that the filter has just used or refused, and the conditions behind them."""
        refused = {self._of_sensor[axis] for axis in self.filter.refused}
        all_of_it = self._newest
        for place, far in enumerate(all_of_it.whitened.tolist()):
            if np.isfinite(far):
                alone = np.full_like(all_of_it.whitened, np.nan)
                alone[place] = far
                yield place, Innovation(alone, all_of_it.factor, far**2, place not in refused)

    def believe(self, channel: Channel, event: Event, axis: int) -> bool:
        return False

    def innovation_of_axis(self, channel: Channel, event: Event, axis: int) -> Innovation:
        innovation = self.filter.innovation_of_axis(self._of_car[axis], self.in_axes_of_car(event), event.variance)
        return self._in_axes_of_sensor(innovation)

    def _in_axes_of_sensor(self, innovation: Innovation) -> Innovation:
        """An innovation whose axes are those of the car, with those of the sensor that are nearest to them."""
        if self._order is not None:
            innovation = innovation._replace(
                whitened=innovation.whitened[self._order], factor=innovation.factor[self._order][:, self._order]
            )
        self._newest = innovation
        return innovation


def _placed(sensor: SensorBase) -> Callable[[Array], Array] | None:
    """What brings a reading (6,) of an inertial sensor into the axes of the car and, as far as rates alone determine
    it, to cog; None of a sensor that is there, and of all others."""
    if "rates and forces" not in sensor.measures:
        return None
    arm = sensor.mounting()[:3]
    along, across, up = arm.tolist()
    turn = sensor.in_axes_of_car(np.eye(6)).T
    turned = not np.array_equal(turn, np.eye(6))

    def placed(value: Array) -> Array:
        if turned:
            value = turn @ value if isfinite(value.dot(value)) else sensor.in_axes_of_car(value[None])[0]
        if not at_cog:
            p, q, r = (rate if rate == rate else 0.0 for rate in value[:3].tolist())
            outward, square = p * along + q * across + r * up, p * p + q * q + r * r
            value = value - (  # ω × (ω × r)
                0.0, 0.0, 0.0, p * outward - along * square, q * outward - across * square, r * outward - up * square
            )  # fmt: skip
        return value

    at_cog = not arm.any()
    return placed if turned or not at_cog else None
