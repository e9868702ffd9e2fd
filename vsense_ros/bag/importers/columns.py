"""A recording from the columns of a table or measurement file, as a mapping says (see `mapping.py`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.mapping import (
    QUANTITIES,
    Column,
    ColumnMapping,
    Columns,
    Origin,
    Ref,
    Signal,
    factor_to_si,
    signals_of,
    unit_of,
)
from vsense_ros.checks.held import first_of_each, period_of_updates
from vsense_ros.errors import InputError
from vsense_ros.messages import units
from vsense_ros.messages.memory import give_back
from vsense_ros.messages.recording import FIELDS, Channel, Recording
from vsense_ros.messages.topics import TOPICS


@dataclass(frozen=True)
class ColumnSettings:
    """Limits by which columns are understood."""

    rows_examined: int = 100_000  # at the beginning, by which it is seen if values are held
    latest: float = 4e9  # [s] of any time: the year 2096
    most_radians: float = 7.0  # [rad] that an angle without a stated unit has at the most: little more than a turn


SETTINGS = ColumnSettings()
_WRAPPING = ("course", "yaw", "heading")


class NoValues(InputError):
    """None of the columns of a topic holds a number."""


def recording_from(
    mapping: ColumnMapping,
    columns: Columns,
    name: str,
    source: str,
    base: int | None = None,
    *,
    is_piece: bool = False,
) -> Recording:
    """The recording that the mapping makes of the columns; `base` is the Unix time [ns] of their time 0, if not that
    of the mapping. A piece of a table may have no values of a topic, which it then lacks; a whole one may not."""
    notes: list[str] = []
    if mapping.time.rate is not None and mapping.time.start is None:
        notes.append(f"{name}: its rows have no date; counted from 1970 (key start of time)")
    made = _Maker(mapping, columns, mapping.time.base if base is None else base, notes)
    channels = {}
    for topic, fields in mapping.topics.items():
        if fields:
            try:
                channels[topic] = made.channel(topic, mapping.fields(topic))
            except NoValues:
                if not is_piece:
                    raise
            give_back()
    return Recording(channels, name, tuple(dict.fromkeys(notes)), 0, {"source": source})


class _Maker:
    """Makes the channels of a mapping."""

    def __init__(self, mapping: ColumnMapping, columns: Columns, base: int, notes: list[str]) -> None:
        self._mapping, self._columns, self._base, self._notes = mapping, columns, base, notes
        self._stamps: tuple[Array, build.Stamps] | None = None

    def channel(self, topic: str, fields: Mapping[str, Any]) -> Channel:
        """The channel of a topic."""
        signals = [(field, signal) for field, value in fields.items() for signal in signals_of(value)]
        if not signals:
            raise InputError(f"{topic}: no column is given for any of its fields")
        raw = {ref: self._columns(ref) for _, signal in signals for ref in signal.refs}
        longest = max(raw, key=lambda ref: np.count_nonzero(np.isfinite(raw[ref].values)))
        time = raw[longest].time
        if all(_same_times(c.time, time) for c in raw.values()):
            keep = np.any([np.isfinite(c.values) for c in raw.values()], axis=0)
            keep = self._updates(topic, raw, keep)
        else:
            keep = np.isfinite(raw[longest].values)
            self._notes.append(f"{topic}: its columns have different times; interpolated to those of {longest}")
        time = time if keep.all() else time[keep]
        if not len(time):
            raise NoValues(f"{topic}: none of its columns ({', '.join(map(str, raw))}) holds a number")
        possible = np.abs(time) < SETTINGS.latest
        if not possible.all():
            raise InputError(f"{topic}: a time of {time[np.argmin(possible)]:g} s is none; is its unit right?")

        def value(field: str, signal: Signal | None) -> Array:
            if signal is None:
                return np.broadcast_to(np.nan, len(time))
            columns = [self._brought(raw[ref], keep, time, field in _WRAPPING) for ref in signal.refs]
            own = columns.pop(0) if len(columns) == 1 else np.mean(columns, axis=0)
            key = f"{topic}.{field}"
            unit = unit_of(key, signal, next((raw[ref].unit for ref in signal.refs if raw[ref].unit), ""))
            factor = factor_to_si("mapping", key, signal, unit, QUANTITIES[topic][field])
            own *= signal.scale  # in its place: tables are long
            own += signal.offset
            own *= signal.sign * factor
            return own

        return _Fields(topic, fields, value, len(time), self._mapping.origin).channel(self._stamps_of(time))

    def _stamps_of(self, time: Array) -> build.Stamps:
        """Time stamps of rows; those of topics with the same rows are made once."""
        if self._stamps is None or self._stamps[0] is not time:
            self._stamps = time, build.nanoseconds(time, self._base)
        return self._stamps[1]

    def _updates(self, topic: str, raw: Mapping[Ref, Column], keep: np.ndarray) -> np.ndarray:
        """Rows at which a slower source brought something new, where a faster table repeats its values."""
        rows = np.flatnonzero(keep)
        beginning = rows[: SETTINGS.rows_examined]
        every = period_of_updates(np.column_stack([column.values[beginning] for column in raw.values()]))
        if every is None:
            return keep
        fresh = first_of_each(np.column_stack([column.values[rows] for column in raw.values()]), every)
        self._notes.append(f"{topic}: each value stands in {every} rows; only the first of them is a measurement")
        updates = np.zeros(len(keep), bool)
        updates[rows[fresh]] = True
        return updates

    def _brought(self, column: Column, keep: np.ndarray, time: Array, wraps: bool) -> Array:
        """Values of a column at the times of a topic."""
        if _same_times(column.time, time):  # every row is one of the topic
            return column.values.copy()
        if len(column.time) == len(keep) and np.array_equal(column.time[keep], time):
            return column.values[keep]
        unit = units.canonical(column.unit) or ""
        turn = 2 * np.pi if unit == "rad" else 360.0
        if wraps and np.nanmax(np.abs(column.values), initial=0.0) < SETTINGS.most_radians and unit != "deg":
            turn = 2 * np.pi
        return _between(time, column.time, column.values, turn if wraps else None)


def _same_times(one: Array, other: Array) -> bool:
    """True if two columns have the same times; those of one table are one array."""
    return one is other or (len(one) == len(other) and np.array_equal(one, other))


def _between(time: Array, own_time: Array, own: Array, turn: float | None) -> Array:
    """A column at other times than its own: linear between its values, NaN outside them; angles the short way round."""
    good = np.isfinite(own)
    if not good.any():
        return np.full(len(time), np.nan)
    known = np.unwrap(own[good], period=turn) if turn else own[good]
    return np.interp(time, own_time[good], known, left=np.nan, right=np.nan)


class _Fields:
    """The fields of one topic, and the message that they make."""

    def __init__(
        self,
        topic: str,
        fields: Mapping[str, Any],
        value: Callable[[str, Signal | None], Array],
        rows: int,
        origin: Origin | None,
    ) -> None:
        self._topic, self._fields, self._value, self._rows, self._origin = topic, fields, value, rows, origin

    def vector(self, field: str) -> Array:
        given = self._fields.get(field) or [None, None, None]
        if not isinstance(given, list):
            raise InputError(f"mapping: {self._topic}.{field}: expected three values: x, y, z")
        if not any(signal is not None for signal in given):
            return np.broadcast_to(np.nan, (self._rows, len(given)))
        vectors = np.empty((self._rows, len(given)))
        for i, signal in enumerate(given):
            vectors[:, i] = np.nan if signal is None else self._value(field, signal)
        return vectors

    def scalar(self, field: str) -> Array:
        given = self._fields.get(field)
        if isinstance(given, list | dict):
            raise InputError(f"mapping: {self._topic}.{field}: expected one signal")
        return self._value(field, given)

    def yaw(self) -> Array:
        """Counter-clockwise from east [rad]."""
        return np.pi / 2 - self.scalar("heading") if "heading" in self._fields else self.scalar("yaw")

    def body_velocity(self) -> Array:
        """Velocity in the axes of the car (n, 3) [m/s]."""
        if "linear" in self._fields:
            return self.vector("linear")
        up = self.scalar("up") if "up" in QUANTITIES[self._topic] else np.full(self._rows, np.nan)
        if "speed" in self._fields:
            speed = self.scalar("speed")
            if "side_slip" not in self._fields:
                return np.column_stack([speed, np.full(self._rows, np.nan), up])
            slip = self.scalar("side_slip")
            return np.column_stack([speed * np.cos(slip), speed * np.sin(slip), up])
        return np.column_stack([self.scalar("forward"), self.scalar("left"), up])

    def enu_velocity(self) -> Array:
        """Velocity to the east, north and up (n, 3) [m/s]."""
        if "linear" in self._fields:
            return self.vector("linear")
        if "forward" in self._fields:
            if not {"heading", "yaw"} & self._fields.keys():
                raise InputError(
                    "mapping: gps/velocity: velocities in the axes of the car need its heading or yaw; without one "
                    "they are vehicle/velocity"
                )
            yaw, along, across = self.yaw(), self.scalar("forward"), self.scalar("left")
            across = across if "left" in self._fields else np.zeros(self._rows)
            east, north = along * np.cos(yaw) - across * np.sin(yaw), along * np.sin(yaw) + across * np.cos(yaw)
            return np.column_stack([east, north, self.scalar("up")])
        if "course" not in self._fields:
            raise InputError(
                "mapping: gps/velocity: a speed without a course has no direction; say it as vehicle/velocity.speed"
            )
        return build.course_velocity(self.scalar("speed"), self.scalar("course"), self.scalar("up"))

    def fix(self, stamp: build.Stamps) -> Channel:
        if "east" not in self._fields:
            return build.fix(stamp, self.scalar("latitude"), self.scalar("longitude"), self.scalar("altitude"))
        assert self._origin is not None
        up = self.scalar("up") if "up" in self._fields else np.zeros(self._rows)
        origin = (self._origin.latitude, self._origin.longitude, self._origin.altitude)
        latitude, longitude, altitude = build.geodetic_from_enu(self.scalar("east"), self.scalar("north"), up, origin)
        return build.fix(stamp, latitude, longitude, altitude if "up" in self._fields else np.full(self._rows, np.nan))

    def channel(self, stamp: build.Stamps) -> Channel:
        topic, fields = self._topic, self._fields
        spec = TOPICS[topic]
        if spec.names:
            field, joints = next((name, given) for name, given in fields.items() if given)
            return build.joints(topic, stamp, field, {j: self._value(field, signal) for j, signal in joints.items()})
        if topic == "gps/fix":
            return self.fix(stamp)
        if topic == "gps/velocity":
            return build.velocity(stamp, self.enu_velocity())
        if topic == "vehicle/velocity":
            return build.body_velocity(stamp, self.body_velocity())
        oriented = bool({"yaw", "heading"} & fields.keys())
        if topic == "imu/data" and not oriented:
            return build.imu(stamp, self.vector("angular_velocity"), self.vector("linear_acceleration"))
        return self._general(stamp)

    def _general(self, stamp: build.Stamps) -> Channel:
        topic, kind = self._topic, TOPICS[self._topic].kind
        made = {f: self.vector(f) for f in FIELDS[kind] if QUANTITIES[topic].get(f) and f not in ("yaw", "heading")}
        absent: dict[str, Array] = {}
        if kind == "sensor_msgs/msg/Imu":
            for field in ("angular_velocity", "linear_acceleration"):
                if np.isnan(made[field]).all():
                    absent[f"{field}_covariance"] = np.tile([-1.0] + [0.0] * 8, (len(stamp), 1))
                    made[field] = np.zeros((len(stamp), 3))
        if "orientation" in FIELDS[kind]:
            yaw = self.yaw()
            zero = np.where(np.isnan(yaw), np.nan, 0.0)
            made["orientation"] = np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])
        if kind == "nav_msgs/msg/Odometry":
            made["linear"] = self.body_velocity()
            unknown = np.zeros((len(stamp), 36))
            unknown[:, [21, 28]] = np.nan
            absent["pose_covariance"] = unknown
        return build.channel(topic, stamp, made | absent)
