"""From messages to measurements: what a message says, if it can be true."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.estimation.source import Source
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Recording, Sample

Array = NDArray[np.float64]

_LARGEST_VALUE = 1e7  # no quantity here is larger in SI units
_HEIGHTS = -500.0, 9000.0  # [m] of roads, with a margin
BLOCK = 4096  # messages of a recording that are read at once
UNUSABLE = "no usable number in the message"
_NOWHERE = 1e-3  # [deg] from latitude and longitude 0, where receivers are that know nothing


class Map:
    """East and north of a fixed origin (latitude, longitude [deg], height [m]), which by default is the first fix that
    can be one: with a status that says so, on a road of this earth."""

    def __init__(self, origin: tuple[float, float, float] | None) -> None:
        self.origin = origin

    def placed(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Fields of a NavSatFix with `east`, `north` and `up` [m] added; NaN for what is no place on earth."""
        latitude, longitude, height = (float(values[k][0]) for k in ("latitude", "longitude", "altitude"))
        east = north = up = float("nan")
        nowhere = abs(latitude) < _NOWHERE and abs(longitude) < _NOWHERE
        if self.origin is None and not nowhere:
            self._begin(values, latitude, longitude, height)
        if abs(latitude) <= 90 and abs(longitude) <= 360 and not nowhere and self.origin is not None:
            east, north, _ = pymap3d.geodetic2enu(latitude, longitude, self.origin[2], *self.origin)
            up = height - self.origin[2]  # which follows the curvature of the earth, as a road does
        places = {"east": east, "north": north, "up": up}
        return {**values, **{name: np.array([float(place)]) for name, place in places.items()}}

    def _begin(self, values: Mapping[str, Array], latitude: float, longitude: float, height: float) -> None:
        """Lay the origin, if these may be it."""
        status = values.get("status")
        fixed = status is None or not len(status) or status[0] >= 0
        high = np.isfinite(height)
        if fixed and abs(latitude) <= 90 and abs(longitude) <= 360 and (not high or _HEIGHTS[0] < height < _HEIGHTS[1]):
            self.origin = (latitude, longitude, height if high else 0.0)

    def latitude_longitude(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude of a place on the map [deg]. Raises `ValueError` where there has been no fix yet."""
        if self.origin is None:
            raise ValueError("the map has no origin")
        latitude, longitude, _ = pymap3d.enu2geodetic(east, north, 0.0, *self.origin)
        return float(latitude), float(longitude)


class Measurements(NamedTuple):
    """Measurements of one sensor: `stamp` (n,) with the latency taken off [ns], `value` and `variance` (n, m), NaN
    where a component is absent; `why` says what was wrong with the first message without one, if there was any."""

    stamp: NDArray[np.int64]
    value: Array
    variance: Array
    why: str = ""


class Reader:
    """Reads the messages of one sensor."""

    def __init__(self, index: int, sensor: Source, on_map: Map) -> None:
        self._index, self._sensor, self._map = index, sensor, on_map
        self._message, self._frame, self._geodetic = sensor.message, sensor.frame_id, sensor.geodetic
        offsets = sensor.offsets()
        self._offsets = offsets if offsets.any() else None
        self._usual = sensor.deviations() ** 2
        self._variance = self._usual.copy()  # of the message that is read
        self._latency = int(sensor.latency * 1e9)
        # Most messages state the same variance as others before them.
        self._least = self._usual * sensor.least_stated**2
        self._believed = lru_cache(maxsize=64)(self._checked)
        self.too_sure = ""  # which standard deviation the messages state that no such sensor has, in words

    def _checked(self, stated: bytes) -> tuple[Array, NDArray[np.bool_] | None]:
        """Variances as they are used, not to be changed, and of which components a number was stated, None for all."""
        variance, usual = np.frombuffer(stated), self._usual
        less = (variance < self._least) & (variance > 0) & (variance < NOISE.smaller**2 * usual)
        if less.any():
            self.too_sure = (
                f"standard deviation {self._sensor.noise_in_words(np.sqrt(np.where(less, variance, usual)))}, of its "
                "messages, is none that such a sensor has: that of the vehicle file counts"
            )
        variance = np.where(variance < self._least, usual, variance)
        with np.errstate(invalid="ignore"):
            is_number = variance < _LARGEST_VALUE**2
        if is_number.all():
            return variance, None
        return np.where(is_number, variance, 1.0), is_number

    def stated(self, variance: Array) -> StatedNoise:
        """The noise that counts with a measurement that has these variances (m,)."""
        if not self._sensor.states_noise:  # what `read` makes of a value is no statement of a message
            return StatedNoise(self.noise(self._usual), 1.0)
        known = self._usual > 0
        ratio = float(np.max(np.sqrt(variance[known] / self._usual[known]), initial=0.0))
        return StatedNoise(self.noise(variance), ratio, self.too_sure)

    def noise(self, variance: Array) -> str:
        """In words, the standard deviations that count with a measurement that has these variances (m,), and whose
        they are."""
        counts = variance if self._sensor.states_noise else self._usual
        stated, of_file = (self._sensor.noise_in_words(np.sqrt(v)) for v in (counts, self._usual))
        if not of_file:
            return ""
        return f"{of_file}, of the vehicle file" if stated == of_file else f"{stated}, of its messages; file {of_file}"

    def read_channel(self, channel: Channel) -> Iterator[Event | str]:
        """What `read` makes of each message of a channel, where nothing depends on other sensors in blocks of them."""
        for block in self._blocks(channel):
            rows = self._rows(block)
            if rows is None:
                yield from map(self.read, block)
                continue
            usable = np.any(np.isfinite(rows.value), axis=1).tolist()
            index, table = self._index, zip(usable, rows.stamp.tolist(), rows.value, rows.variance, strict=True)
            for is_usable, stamp, value, variance in table:
                yield Event(index, stamp, value, variance) if is_usable else UNUSABLE

    def measurements(self, channel: Channel) -> Measurements:
        """The measurements in all messages of a channel that have one, as arrays: a recording of hours has millions,
        and an object for each would take ten times the memory."""
        parts: list[Measurements] = []
        why = ""
        for block in self._blocks(channel):
            rows = self._rows(block)
            if rows is None:
                read = [self.read(sample) for sample in block]
                events = [one for one in read if isinstance(one, Event)]
                why = why or next((one for one in read if isinstance(one, str)), "")
                if not events:
                    continue
                rows = Measurements(
                    np.array([event.stamp for event in events], dtype=np.int64),
                    np.array([event.value for event in events]),
                    np.array([event.variance for event in events]),
                )
            usable = np.any(np.isfinite(rows.value), axis=1)
            if not usable.all():
                why = why or UNUSABLE
                rows = Measurements(rows.stamp[usable], rows.value[usable], rows.variance[usable])
            parts.append(rows)
        if not parts:
            nothing = np.zeros((0, len(self._usual)))
            return Measurements(np.zeros(0, dtype=np.int64), nothing, nothing, why)
        return Measurements(
            np.concatenate([part.stamp for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.variance for part in parts]),
            why,
        )

    def _blocks(self, channel: Channel) -> Iterator[Channel]:
        return (channel.select(slice(first, first + BLOCK)) for first in range(0, len(channel), BLOCK))

    def _rows(self, block: Channel) -> Measurements | None:
        """What is read of the messages of a channel, whose values are NaN where nothing is usable; None where they have
        to be read one by one."""
        if self._geodetic or self._unexpected(block):
            return None
        value = np.empty((len(block), len(self._usual)))
        variance = np.tile(self._usual, (len(block), 1))
        try:
            self._sensor.read_rows(block.names, block.columns, value, variance)
        except (KeyError, IndexError, ValueError):
            return None
        if self._offsets is not None:
            value -= self._offsets
        self._believed(variance[0].tobytes())  # which notes what cannot be true
        variance = np.where(variance < self._least, self._usual, variance)
        with np.errstate(invalid="ignore"):
            is_number = variance < _LARGEST_VALUE**2
            known = is_number & (np.abs(value) < _LARGEST_VALUE)
        variance[~is_number] = 1.0
        value[~known] = np.nan
        return Measurements(block.stamp - self._latency, value, variance)

    def _unexpected(self, message: Sample | Channel) -> str:
        """What is not as expected in the kind or the frame of a message, or of all of a channel; empty for nothing."""
        if message.kind != self._message:
            return f"message type {message.kind}, expected {self._message}"
        if message.frame_id != self._frame and self._frame and message.frame_id:
            return f"frame_id {message.frame_id!r}, expected {self._frame!r}"
        return ""

    def read(self, sample: Sample) -> Event | str:
        """The measurement in a message, or why there is none."""
        if unexpected := self._unexpected(sample):
            return unexpected
        stated = self._variance
        stated[:] = self._usual
        value = np.empty(len(stated))
        try:
            values = self._map.placed(sample.values) if self._geodetic else sample.values
            self._sensor.read(sample.names, values, value, stated)
        except (KeyError, IndexError, ValueError) as error:
            return f"unreadable: {type(error).__name__} {error}"
        if self._offsets is not None:
            value -= self._offsets
        variance, is_number = self._believed(stated.tobytes())
        # The sum of squares finds anything unusual, NaN included; looking closer costs ten times as much.
        if not (is_number is None and value.dot(value) < _LARGEST_VALUE**2):
            with np.errstate(invalid="ignore"):
                known = np.abs(value) < _LARGEST_VALUE
            if is_number is not None:
                known &= is_number
            value[~known] = np.nan
            if not known.any():
                return UNUSABLE
        return Event(self._index, sample.stamp - self._latency, value, variance)


@dataclass(frozen=True)
class NoiseSettings:
    """When a standard deviation that messages state is taken for one in another unit: a decision of this project."""

    larger: float = 30.0  # [-] times that of the vehicle file; km/h is 3.6 times m/s, centimetres 100 times metres
    smaller: float = 1e-3  # [-] times that of the vehicle file; degrees of latitude are 10⁻⁵ times metres


NOISE = NoiseSettings()


@dataclass(frozen=True)
class StatedNoise:
    """Which standard deviations count with the messages of a sensor, in words, and the largest of them over that of the
    vehicle file; `too_sure` says that what messages state is less than any such sensor has, and does not count."""

    words: str
    ratio: float
    too_sure: str = ""

    @property
    def doubt(self) -> str:
        """What is doubtful about them, in words; empty for nothing."""
        if self.ratio <= NOISE.larger:
            return self.too_sure
        return (
            f"standard deviation {self.words}: {self.ratio:.0f} times that of the vehicle file, so that its "
            "measurements hardly count; if its messages state another unit or a variance, correct the driver, or set "
            "noise_from_message: false in the vehicle file"
        )


def noise_at_start(recording: Recording, sensors: Mapping[str, Source]) -> dict[str, StatedNoise]:
    """By sensor, which standard deviations count with its first message that can be read."""
    noisy = {}
    for index, (name, sensor) in enumerate(sensors.items()):
        if sensor.topic not in recording:
            continue
        reader = Reader(index, sensor, Map(recording.map_origin))
        events = (reader.read(sample) for sample in recording[sensor.topic].in_order())
        first = next((event for event in events if isinstance(event, Event)), None)
        if first is not None and (stated := reader.stated(first.variance)).words:
            noisy[name] = stated
    return noisy
