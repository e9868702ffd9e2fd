"""Faults of sensors, put into recordings: what an observer has to survive.

A `Change` makes another recording of one, between two times [s] after its start; `Fault` names it. All of them alter
messages as a sensor, a cable or a receiver would; the truth below `reference/` stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]
Change = Callable[[Channel, Rows, Array], Channel]  # of one channel, where it is hit, and at which times [s]

IMU, WHEELS, STEERING = "imu/data", "vehicle/wheel_speeds", "vehicle/steering"
FIX, VELOCITY = "gps/fix", "gps/velocity"
GYRO, ACCELEROMETER = "angular_velocity", "linear_acceleration"


@dataclass(frozen=True)
class Fault:
    """What happens to messages of some topics from `begin` to `end` [s] after the start of a recording."""

    name: str
    topics: tuple[str, ...]
    change: Change
    begin: float
    end: float = np.inf

    def of(self, recording: Recording) -> Recording:
        """The recording with the fault in it; topics that it does not have are left out."""
        channels = dict(recording.channels)
        for topic in self.topics:
            if topic in channels:
                times = np.asarray((channels[topic].stamp - recording.start) * 1e-9, dtype=np.float64)
                hit = (times >= self.begin) & (times < self.end)
                if hit.any():
                    channels[topic] = self.change(channels[topic], hit, times)
        return replace(recording, channels=channels)


def _cells(rows: NDArray[np.bool_], axes: Sequence[int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.flatnonzero(rows)[:, None], np.asarray(axes, dtype=np.intp)[None, :]


def _with(channel: Channel, field: str, rows: Rows, axes: Sequence[int], values: Array | float) -> Channel:
    column = channel.columns[field].copy()
    column[_cells(rows, axes)] = values
    return replace(channel, columns={**channel.columns, field: column})


def added(field: str, axes: Sequence[int], amount: float | Sequence[float], rise: float = 0.0) -> Change:
    """An amount more, the same on all axes or one for each, that takes `rise` [s] to come."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        since = times[rows] - times[rows][0]
        share = np.minimum(since / rise, 1.0) if rise else np.ones_like(since)
        error = share[:, None] * np.asarray(amount)
        return _with(channel, field, rows, axes, channel.columns[field][_cells(rows, axes)] + error)

    return change


def scaled(field: str, axes: Sequence[int], factor: float) -> Change:
    """The change that multiplies a signal by a factor."""
    return lambda channel, rows, times: _with(
        channel, field, rows, axes, factor * channel.columns[field][_cells(rows, axes)]
    )


def replaced(field: str, axes: Sequence[int], value: float) -> Change:
    """The change that sets a signal to one value: zero, or NaN for a signal that is absent."""
    return lambda channel, rows, times: _with(channel, field, rows, axes, value)


def held(field: str, axes: Sequence[int], deviation: float = 0.0) -> Change:
    """The last value, with noise of a standard deviation, as of a sensor that has lost its element."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        last = channel.columns[field][np.flatnonzero(rows)[0], list(axes)]
        return _with(channel, field, rows, axes, last + _noise(rows, axes, deviation))

    return change


def noise(field: str, axes: Sequence[int], deviation: float) -> Change:
    """Nothing but noise around zero, as of a sensor that has lost its element."""
    return lambda channel, rows, times: _with(channel, field, rows, axes, _noise(rows, axes, deviation))


def _noise(rows: Rows, axes: Sequence[int], deviation: float) -> Array:
    return deviation * np.random.default_rng(1).standard_normal((int(rows.sum()), len(axes)))


def drifting(field: str, axes: Sequence[int], rate: float) -> Change:
    """An error that grows by `rate` each second, for as long as the fault lasts."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        error = rate * (times[rows] - times[rows][0])[:, None]
        return _with(channel, field, rows, axes, channel.columns[field][_cells(rows, axes)] + error)

    return change


def turned(field: str, axes: Sequence[int], signs: Sequence[float]) -> Change:
    """A vector in another frame: component i is what `axes[i]` was, times `signs[i]`."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        values = channel.columns[field][_cells(rows, axes)] * np.asarray(signs)
        return _with(channel, field, rows, range(len(axes)), values)

    return change


def stamped(seconds: float) -> Change:
    """Times of measurement that are wrong by so much. Late ones also arrive as late: the message was under way. Early
    ones have a stamp from before the measurement."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        shift = np.where(rows, round(seconds * 1e9), 0)
        moved = replace(channel, stamp=channel.stamp + shift, received=channel.received + np.maximum(shift, 0))
        return moved.in_order()

    return change


def silent(channel: Channel, rows: Rows, times: Array) -> Channel:
    """The change that leaves out all messages."""
    return channel.select(~rows)


def rare(period: float) -> Change:
    """The change that leaves one message in each period [s]."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        turn = np.floor(times / period)
        return channel.select(~rows | (np.diff(turn, prepend=-1.0) > 0))

    return change


PLACE = "linear"  # the field of places east, north and above the first fix [m] that `on_map` gives a change


def on_map(change: Change) -> Change:
    """A change of the field `PLACE`, done to positions that are given by latitude and longitude."""

    def changed(channel: Channel, rows: Rows, times: Array) -> Channel:
        fixes = np.column_stack([channel.columns[name][:, 0] for name in ("latitude", "longitude", "altitude")])
        fixes[:, 2] = np.nan_to_num(fixes[:, 2])
        finite = np.isfinite(fixes).all(axis=1)
        if not finite.any():
            return channel
        origin = fixes[finite][0]
        places = np.column_stack(pymap3d.geodetic2enu(*fixes.T, *origin))
        on_plane = replace(channel, kind="geometry_msgs/msg/TwistStamped", columns={PLACE: places})
        changed_fixes = pymap3d.enu2geodetic(*change(on_plane, rows, times).columns[PLACE].T, *origin)
        columns = dict(channel.columns)
        for name, values in zip(("latitude", "longitude"), changed_fixes, strict=False):
            columns[name] = np.where(rows, values, columns[name][:, 0])[:, None]
        return replace(channel, columns=columns)

    return changed


def moved(east: float, north: float) -> Change:
    """A position that lies beside the true one [m]."""
    return on_map(added(PLACE, [0, 1], (east, north)))


def without_fix(channel: Channel, rows: Rows, times: Array) -> Channel:
    """A receiver that says that it has no fix."""
    return _with(channel, "status", rows, [0], -1.0)


def shaken(rate: float, rates: float, forces: float) -> Change:
    """IMU messages at another rate [Hz], whose values alternate by so much [rad/s, m/s²]."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        changed_rows = np.flatnonzero(rows)
        begin, end = times[changed_rows[0]], times[changed_rows[-1]]
        new = np.arange(begin, end, 1 / rate)
        source_rows = np.minimum(np.searchsorted(times, new, side="right") - 1, changed_rows[-1])
        resampled = channel.select(source_rows)
        sign = np.where(np.arange(len(new)) % 2, 1.0, -1.0)[:, None]
        shift = np.round((new - times[source_rows]) * 1e9).astype(np.int64)
        columns = dict(resampled.columns)
        columns[GYRO], columns[ACCELEROMETER] = (
            resampled.columns[GYRO] + rates * sign,
            resampled.columns[ACCELEROMETER] + forces * sign,
        )
        resampled = replace(
            resampled, stamp=resampled.stamp + shift, received=resampled.received + shift, columns=columns
        )
        parts = [channel.select(times < begin), resampled, channel.select(times >= end)]
        return replace(
            channel,
            stamp=np.concatenate([p.stamp for p in parts]),
            received=np.concatenate([p.received for p in parts]),
            columns={name: np.concatenate([p.columns[name] for p in parts]) for name in channel.columns},
        )

    return change


def stated(field: str, variance: float) -> Change:
    """A covariance [unit of the field] that is the same on the whole diagonal."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        size = int(channel.columns[field].shape[1] ** 0.5)
        return _with(channel, field, rows, range(size * size), (variance * np.eye(size)).ravel())

    return change
