"""Means of what the sensors of a car measure, second by second: for filters of what changes within hours.

The messages of all sensors are put on the time at which they measured; a second is complete when something was measured
`AVERAGES.delay` after its end. Readings of GNSS are few, so that the speed of the car would have changed between them
and the mean of the wheels: each is led to the middle of its second by what the wheels gained or lost until then.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Recording, Sample, by_arrival
from vsense_ros.model.sensors import GnssVelocity, Imu, SensorBase, WheelSpeeds, WheelTorques
from vsense_ros.model.sensors.gnss_vertical_velocity import GnssVerticalVelocity
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AveragesSettings:
    """How readings are averaged: decisions of this project."""

    length: float = 1.0  # [s] over which is averaged
    delay: float = 0.5  # [s] by which a message may be later than others
    least: int = 5  # readings of wheels and of the inertial sensor in that time
    shortest: float = 30.0  # [s] of a recording that can determine what changes so slowly


AVERAGES = AveragesSettings()


@dataclass(frozen=True)
class Mean:
    """Means over `AVERAGES.length`, SI, in the axes of the car. What was not measured is NaN."""

    stamp: int  # [ns] of its end
    spin: Array  # (4,) of the wheels
    spin_deviation: Array  # (4,) of the mean, by the noise of single readings
    rates: Array  # (6,) of the inertial sensor: turn rates and specific forces
    acceleration: float  # of the wheels' rolling speed
    ground_speed: tuple[float, float]  # of the GNSS antenna, and its standard deviation
    vertical_speed: tuple[float, float]  # likewise
    course: tuple[float, float]  # of the antenna over ground [rad], likewise
    torques: Array  # (4,) at the wheels, drive minus brake


class Averages:
    """Averages of one vehicle's sensors. `add` takes messages in order of arrival and returns what is complete.

    Raises `InputError` for a vehicle without wheel speeds or an inertial sensor.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.radii = rolling_radii(vehicle)
        self.sensors: dict[type[SensorBase], SensorBase] = {}
        for sensor in vehicle.sensing().values():
            if isinstance(sensor, Imu | WheelSpeeds | WheelTorques | GnssVelocity | GnssVerticalVelocity):
                self.sensors.setdefault(type(sensor), sensor)
        for kind in (WheelSpeeds, Imu):
            if kind not in self.sensors:
                raise InputError(f"{vehicle.name}: this needs {kind.words}, which no sensor of the vehicle file gives")
        velocity = self.sensors.get(GnssVelocity)
        if isinstance(velocity, GnssVelocity) and GnssVerticalVelocity not in self.sensors:
            both = {name: getattr(velocity, name) for name in ("topic", "frame_id", "position", "latency")}
            self.sensors[GnssVerticalVelocity] = GnssVerticalVelocity(**both, noise=2 * velocity.noise)
        self._readers = [(kind, Reader(0, one, Map(None))) for kind, one in self.sensors.items()]
        self._turns = {kind: _turn(sensor) for kind, sensor in self.sensors.items()}
        self._rows: dict[type[SensorBase], list[tuple[int, Array, Array]]] = {kind: [] for kind in self.sensors}
        self._end = 0

    @property
    def topics(self) -> dict[str, str]:
        """Topics that it listens to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self.sensors.values()}

    @property
    def needed(self) -> list[SensorBase]:
        """Sensors without which there are no means."""
        return [self.sensors[WheelSpeeds], self.sensors[Imu]]

    def add(self, sample: Sample) -> Iterator[Mean]:
        """Take a message; others than those of `topics` are left alone."""
        for kind, reader in self._readers:
            if sample.topic == self.sensors[kind].topic:
                yield from self._take(kind, reader.read(sample))

    def over(self, recording: Recording) -> Iterator[Mean]:
        """Take all messages of a recording in order of arrival, as `add` takes each, read in blocks."""
        channels = [channel.in_order() for topic, channel in recording.channels.items() if topic in self.topics]
        streams = [self._read(channel) for channel in channels]
        for readings in by_arrival([channel.received for channel in channels], streams):
            for kind, event in readings:
                yield from self._take(kind, event)

    def _read(self, channel: Channel) -> Iterator[list[tuple[type[SensorBase], Event | str]]]:
        """What the sensors that listen to a channel read in each of its messages."""
        listeners = [(kind, reader) for kind, reader in self._readers if self.sensors[kind].topic == channel.topic]
        kinds = [kind for kind, _ in listeners]
        for read in zip(*(reader.read_channel(channel) for _, reader in listeners), strict=True):
            yield list(zip(kinds, read, strict=True))

    def _take(self, kind: type[SensorBase], event: Event | str) -> Iterator[Mean]:
        """Take what was read of a message."""
        if isinstance(event, str):
            return
        yield from self._complete(event.stamp)
        value, turn = event.value, self._turns[kind]
        if turn is not None:
            whole = np.isfinite(value).all()
            value = turn @ value if whole else self.sensors[kind].in_axes_of_car(value[None])[0]
        self._rows[kind].append((event.stamp, value, event.variance))

    def _complete(self, stamp: int) -> Iterator[Mean]:
        length, delay = round(AVERAGES.length * 1e9), round(AVERAGES.delay * 1e9)
        if abs(stamp - self._end) > 3 * length + delay:  # the beginning, a pause, or another clock
            for rows in self._rows.values():
                rows.clear()
            self._end = stamp + length
        while stamp >= self._end + delay:
            if (mean := self._mean(self._end - length, self._end)) is not None:
                yield mean
            for kind, rows in self._rows.items():
                self._rows[kind] = [row for row in rows if row[0] >= self._end]
            self._end += length

    def _mean(self, begin: int, end: int) -> Mean | None:
        parts = {
            kind: [row for row in rows if begin <= row[0] < end and np.isfinite(row[1]).any()]
            for kind, rows in self._rows.items()
        }
        wheels, inertial = parts[WheelSpeeds], parts[Imu]
        if min(len(wheels), len(inertial)) < AVERAGES.least:
            return None
        time, spin, _ = self._columns(wheels, begin)
        rolling = np.nanmedian(spin * self.radii, axis=1) if np.isfinite(spin).any(axis=1).all() else None
        if rolling is None:
            return None
        middle = time.mean()
        slope = float(np.polyfit(time - middle, rolling, 1)[0])
        noise = self.sensors[WheelSpeeds].deviations() / np.sqrt(np.isfinite(spin).sum(axis=0).clip(min=1))
        torques = parts.get(WheelTorques, [])
        ground = self._led(parts.get(GnssVelocity, []), begin, time, rolling)
        vertical = self._led(parts.get(GnssVerticalVelocity, []), begin, time, np.zeros_like(rolling))
        rates = _mean(self._columns(inertial, begin)[1])
        course = self._course(parts.get(GnssVelocity, []), begin, float(rates[2]))
        torque = _mean(self._columns(torques, begin)[1]) if len(torques) >= AVERAGES.least else np.full(4, np.nan)
        return Mean(end, _mean(spin), noise, rates, slope, ground, vertical, course, torque)

    @staticmethod
    def _columns(rows: list[tuple[int, Array, Array]], begin: int) -> tuple[Array, Array, Array]:
        """Times [s] since `begin` (n,), values and variances (n, m)."""
        stamps, values, variances = zip(*rows, strict=True)
        return (np.array(stamps) - begin) * 1e-9, np.array(values), np.array(variances)

    def _led(
        self, rows: list[tuple[int, Array, Array]], begin: int, time: Array, rolling: Array
    ) -> tuple[float, float]:
        """Amount of a velocity at the middle, by readings of it at other times, and its standard deviation."""
        if not rows:
            return np.nan, np.nan
        at, values, variances = self._columns(rows, begin)
        amount = np.hypot(*values.T) if values.shape[1] == 2 else values[:, 0]
        gained = np.interp(at, time, rolling) - rolling.mean()
        known = np.isfinite(amount)
        if not known.any():
            return np.nan, np.nan
        deviation = np.sqrt(variances[known].mean() / known.sum())
        return float(np.mean((amount - gained)[known])), float(deviation)

    def _course(self, rows: list[tuple[int, Array, Array]], begin: int, rate: float) -> tuple[float, float]:
        """Course at the middle of a second in which the car turned at a rate [rad/s], and its standard deviation."""
        rows = [row for row in rows if np.isfinite(row[1]).all()]
        if not rows or not np.isfinite(rate):
            return np.nan, np.nan
        at, values, variances = self._columns(rows, begin)
        velocity = np.mean((values[:, 0] + 1j * values[:, 1]) * np.exp(1j * rate * (AVERAGES.length / 2 - at)))
        return float(np.angle(velocity)), float(np.sqrt(variances.mean() / len(rows)) / max(abs(velocity), 1e-3))


class ByAverages(ABC):
    """A filter of what changes within hours, by the averages of one vehicle's sensors. `add` takes messages in order of
    arrival, `take` a recording."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.averages = Averages(vehicle)

    @property
    def topics(self) -> dict[str, str]:
        """Topics that it listens to, with their message types."""
        return self.averages.topics

    def add(self, sample: Sample) -> bool:
        """Take a message. Returns whether a second that says something was complete."""
        says_something = [self._use(mean) for mean in self.averages.add(sample)]  # each is used
        return any(says_something)

    def take(self, recording: Recording) -> None:
        """Take all messages of a recording."""
        for mean in self.averages.over(recording):
            self._use(mean)

    @abstractmethod
    def _use(self, mean: Mean) -> bool:
        """Take in one second. Returns whether it says something."""


def _mean(values: Array) -> Array:
    """Mean of what is known in each column (m,), NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    with np.errstate(invalid="ignore"):
        return np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / count, np.nan)


def _turn(sensor: SensorBase) -> Array | None:
    """What turns a measurement into the axes of the car (m, m); None where nothing does."""
    unit = np.eye(len(sensor.deviations()))
    turn = sensor.in_axes_of_car(unit).T
    return None if np.array_equal(turn, unit) else turn
