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


def added(field: str, axes: Sequence[int], amount: float, rise: float = 0.0) -> Change:
    """An amount more, that takes `rise` [s] to come."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        since = times[rows] - times[rows][0]
        share = np.minimum(since / rise, 1.0) if rise else np.ones_like(since)
        return _with(channel, field, rows, axes, channel.columns[field][_cells(rows, axes)] + amount * share[:, None])

    return change


def scaled(field: str, axes: Sequence[int], factor: float) -> Change:
    """So many times as much."""
    return lambda channel, rows, times: _with(
        channel, field, rows, axes, factor * channel.columns[field][_cells(rows, axes)]
    )


def replaced(field: str, axes: Sequence[int], value: float) -> Change:
    """Always the same: zero, or NaN where nothing comes."""
    return lambda channel, rows, times: _with(channel, field, rows, axes, value)


def held(field: str, axes: Sequence[int]) -> Change:
    """What was last."""
    return lambda channel, rows, times: _with(
        channel, field, rows, axes, channel.columns[field][np.flatnonzero(rows)[0], list(axes)]
    )


def noise(field: str, axes: Sequence[int], deviation: float) -> Change:
    """Nothing but noise around zero, as of a sensor that has lost its element."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        rng = np.random.default_rng(1)
        return _with(channel, field, rows, axes, deviation * rng.standard_normal((int(rows.sum()), len(axes))))

    return change


def silent(channel: Channel, rows: Rows, times: Array) -> Channel:
    """No message."""
    return channel.select(~rows)


def rare(period: float) -> Change:
    """One message in a period [s]."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        turn = np.floor(times / period)
        return channel.select(~rows | (np.diff(turn, prepend=-1.0) > 0))

    return change


def moved(east: float, north: float) -> Change:
    """A position that lies beside the true one [m]."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        columns = {name: column.copy() for name, column in channel.columns.items()}
        place = [columns[name][rows, 0] for name in ("latitude", "longitude", "altitude")]
        there = pymap3d.enu2geodetic(east, north, 0.0, *place)
        for name, values in zip(("latitude", "longitude"), there, strict=False):
            columns[name][rows, 0] = values
        return replace(channel, columns=columns)

    return change


def without_fix(channel: Channel, rows: Rows, times: Array) -> Channel:
    """A receiver that says that it has no fix."""
    return _with(channel, "status", rows, [0], -1.0)


def shaken(rate: float, rates: float, forces: float) -> Change:
    """IMU messages at another rate [Hz], whose values alternate by so much [rad/s, m/s²]."""

    def change(channel: Channel, rows: Rows, times: Array) -> Channel:
        where = np.flatnonzero(rows)
        begin, end = times[where[0]], times[where[-1]]
        new = np.arange(begin, end, 1 / rate)
        taken = np.minimum(np.searchsorted(times, new, side="right") - 1, where[-1])
        made = channel.select(taken)
        sign = np.where(np.arange(len(new)) % 2, 1.0, -1.0)[:, None]
        shift = np.round((new - times[taken]) * 1e9).astype(np.int64)
        columns = dict(made.columns)
        columns[GYRO], columns[ACCELEROMETER] = (
            made.columns[GYRO] + rates * sign,
            made.columns[ACCELEROMETER] + forces * sign,
        )
        made = replace(made, stamp=made.stamp + shift, received=made.received + shift, columns=columns)
        parts = [channel.select(times < begin), made, channel.select(times >= end)]
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
