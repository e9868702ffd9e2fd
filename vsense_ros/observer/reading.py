"""From messages to measurements: what a message says, if it can be true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.model.sensors import SensorBase
from vsense_ros.recording import Sample

Array = NDArray[np.float64]

_LARGEST_VALUE = 1e7  # no quantity here is larger in SI units
_SMALLEST_VARIANCE = 1e-6  # of the sensor's own: no message makes a sensor a thousand times better than it is


@dataclass(slots=True)
class Event:
    """A measurement or input that belongs to a time."""

    sensor: int
    stamp: int  # of the measurement, latency taken off [ns]
    value: Array  # (m,), NaN where absent
    variance: Array  # (m,)
    counted: bool = False  # in the sensor's health


class Map:
    """East and north of a fixed origin (latitude, longitude [deg], height [m]), which by default is the first fix."""

    def __init__(self, origin: tuple[float, float, float] | None) -> None:
        self.origin = origin

    def placed(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Fields of a NavSatFix with `east` and `north` [m] added; NaN for what is no place on earth."""
        latitude, longitude, height = (float(values[k][0]) for k in ("latitude", "longitude", "altitude"))
        east = north = float("nan")
        if abs(latitude) <= 90 and abs(longitude) <= 360:
            if self.origin is None:
                self.origin = (latitude, longitude, height if np.isfinite(height) else 0.0)
            east, north, _ = pymap3d.geodetic2enu(latitude, longitude, self.origin[2], *self.origin)
        return {**values, "east": np.array([float(east)]), "north": np.array([float(north)])}


class Reader:
    """Reads the messages of one sensor."""

    def __init__(self, index: int, sensor: SensorBase, on_map: Map) -> None:
        self._index, self._sensor, self._map = index, sensor, on_map
        self._variance = sensor.deviations() ** 2
        self._least = self._variance * _SMALLEST_VARIANCE
        self._latency = int(sensor.latency * 1e9)

    def read(self, sample: Sample) -> Event | str:
        """The measurement in a message, or why there is none."""
        sensor = self._sensor
        if sample.kind != sensor.message:
            return f"message type {sample.kind}, expected {sensor.message}"
        if sensor.frame_id and sample.frame_id and sample.frame_id != sensor.frame_id:
            return f"frame_id {sample.frame_id!r}, expected {sensor.frame_id!r}"
        variance = self._variance.copy()
        value = np.empty(len(variance))
        try:
            values = self._map.placed(sample.values) if sensor.kind == "gnss_position" else sample.values
            sensor.read(sample.names, values, value, variance)
        except (KeyError, IndexError, ValueError) as error:
            return f"unreadable: {type(error).__name__} {error}"
        # A sum of Python's numbers finds anything unusual, NaN included; looking closer costs ten times as much.
        if not sum(map(abs, value.tolist())) < _LARGEST_VALUE or not sum(variance.tolist()) < _LARGEST_VALUE**2:
            with np.errstate(invalid="ignore"):
                known = (np.abs(value) < _LARGEST_VALUE) & (variance < _LARGEST_VALUE**2)
            value[~known], variance[~known] = np.nan, 1.0
            if not known.any():
                return "no usable number in the message"
        np.maximum(variance, self._least, out=variance)
        return Event(self._index, sample.stamp - self._latency, value, variance)
