"""Messages as numbers: one `Sample`, a `Channel` of many, a `Recording` of all.

This is the only form in which data travels between importers, bags, drivers, nodes, observers and reports.
It depends on numpy alone, so that everything can be used without ROS. Units are SI, axes ISO 8855; times are
integer nanoseconds since the Unix epoch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.components import columns_of
from vsense_ros.messages.table import Table, merged

if TYPE_CHECKING:
    import pandas
    import polars
    import xarray

T = TypeVar("T")

# Fields of each message type that carry numbers, with their length; 0 stands for "as many as `names`",
# where an empty array says that the message does not carry the field.
FIELDS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        "sensor_msgs/msg/Imu": {
            "orientation": 4,  # quaternion x, y, z, w
            "orientation_covariance": 9,
            "angular_velocity": 3,  # [rad/s]
            "angular_velocity_covariance": 9,
            "linear_acceleration": 3,  # specific force [m/s²]
            "linear_acceleration_covariance": 9,
        },
        "sensor_msgs/msg/NavSatFix": {
            "status": 1,
            "service": 1,
            "latitude": 1,  # [deg]
            "longitude": 1,  # [deg]
            "altitude": 1,  # above the ellipsoid [m]
            "position_covariance": 9,  # ENU [m²]
            "position_covariance_type": 1,
        },
        "sensor_msgs/msg/JointState": {"position": 0, "velocity": 0, "effort": 0},
        "geometry_msgs/msg/TwistWithCovarianceStamped": {"linear": 3, "angular": 3, "covariance": 36},
        "geometry_msgs/msg/TwistStamped": {"linear": 3, "angular": 3},
        "geometry_msgs/msg/AccelStamped": {"linear": 3, "angular": 3},
        "geometry_msgs/msg/AccelWithCovarianceStamped": {"linear": 3, "angular": 3, "covariance": 36},
        "geometry_msgs/msg/Vector3Stamped": {"vector": 3},
        "geometry_msgs/msg/WrenchStamped": {"force": 3, "torque": 3},
        "nav_msgs/msg/Odometry": {
            "position": 3,
            "orientation": 4,
            "pose_covariance": 36,
            "linear": 3,
            "angular": 3,
            "twist_covariance": 36,
        },
    }
)


@dataclass(slots=True)  # which is made for every frame of a bus: a frozen one takes three times as long
class Sample:
    """One message of a topic; nobody changes it.

    `values` maps the field names of `FIELDS[kind]` to float arrays of shape `(length,)`.
    """

    topic: str
    kind: str
    stamp: int  # time of measurement [ns]
    values: Mapping[str, NDArray[np.float64]]
    frame_id: str = ""
    names: tuple[str, ...] = ()  # of the joints of a JointState
    child_frame_id: str = ""  # of an Odometry
    received: int | None = None  # time of arrival [ns]; None: unknown


@dataclass(frozen=True, repr=False)
class Channel:
    """All messages of one topic, one row each, in order of arrival.

    `columns` maps the field names of `FIELDS[kind]` to float arrays of shape `(rows, length)`.
    """

    topic: str
    kind: str
    stamp: NDArray[np.int64]  # (rows,) time of measurement [ns]
    received: NDArray[np.int64]  # (rows,) time of arrival [ns]
    columns: Mapping[str, NDArray[np.float64]]
    frame_id: str = ""
    names: tuple[str, ...] = ()
    child_frame_id: str = ""

    def __post_init__(self) -> None:
        if self.kind not in FIELDS:
            raise ValueError(f"{self.topic}: message type {self.kind!r} has no numeric form; known: {sorted(FIELDS)}")
        rows = len(self.stamp)
        for name, column in self.columns.items():
            if name not in FIELDS[self.kind]:
                raise ValueError(f"{self.topic}: {self.kind} has no field {name!r}")
            if column.ndim != 2 or len(column) != rows:
                raise ValueError(f"{self.topic}: field {name} has shape {column.shape}, expected ({rows}, …)")

    def __len__(self) -> int:
        return len(self.stamp)

    def __repr__(self) -> str:
        return f"<Channel: {self.topic}, {self.kind}, {len(self)} messages>"

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Time of measurement relative to the first row [s]."""
        return (self.stamp - self.stamp[0]) * 1e-9 if len(self) else np.zeros(0)

    @property
    def measured(self) -> Mapping[str, NDArray[np.float64]]:
        """The columns, with NaN in the rows in which a vector is absent: its covariance there begins with -1, as the
        definition of sensor_msgs/Imu has it. Of a car whose rates and accelerations are in two frames of its bus, each
        message has one of the vectors."""
        measured = dict(self.columns)
        for name, covariance in self.columns.items():
            field = name.removesuffix("_covariance")
            if field == name or field not in measured or covariance.shape[1] == 0:
                continue
            absent = covariance[:, 0] == -1
            if absent.any():
                measured[field] = np.where(absent[:, None], np.nan, measured[field])
        return measured

    def table(self) -> Table:
        """The signals of the topic with their units, by time of measurement; without covariances and without what the
        messages say is absent. Of two messages with one stamp the one that arrived last counts, for each signal."""
        return Table(self.topic, self.stamp, columns_of(self.topic, self.kind, self.names, self.measured)).in_order()

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Channel:
        """The channel with only these rows."""
        stamp = self.stamp[rows]
        columns = {
            name: column[rows] if column.strides[0] else np.broadcast_to(column[:1], (len(stamp), column.shape[1]))
            for name, column in self.columns.items()
        }
        return replace(self, stamp=stamp, received=self.received[rows], columns=columns)

    def compact(self) -> Channel:
        """The channel with columns that never change stored as one row, which cannot be written to. Covariances seldom
        change, and are most of what inertial sensors and odometry send."""
        columns = {
            name: np.broadcast_to(column[:1].copy(), column.shape) if _is_constant(column) else column
            for name, column in self.columns.items()
        }
        return replace(self, columns=columns)

    def in_order(self) -> Channel:
        """The channel with its rows in order of arrival."""
        if np.all(self.received[1:] >= self.received[:-1]):
            return self
        return self.select(np.argsort(self.received, kind="stable"))

    def __iter__(self) -> Iterator[Sample]:
        """All rows as samples."""
        fields, frames = tuple(self.columns), (self.frame_id, self.names, self.child_frame_id)
        for stamp, received, *row in zip(
            self.stamp.tolist(), self.received.tolist(), *self.columns.values(), strict=True
        ):
            yield Sample(self.topic, self.kind, stamp, dict(zip(fields, row, strict=True)), *frames, received)

    def sample(self, row: int) -> Sample:
        """One row as a `Sample`."""
        return Sample(
            self.topic,
            self.kind,
            int(self.stamp[row]),
            {name: column[row] for name, column in self.columns.items()},
            self.frame_id,
            self.names,
            self.child_frame_id,
            int(self.received[row]),
        )


def _is_constant(column: NDArray[np.float64]) -> bool:
    """True if all rows of a column (n, m) are the same to the last bit, and stored one by one."""
    if len(column) < 2 or not column.strides[0] or column.dtype != np.float64:
        return False
    bits = column.view(np.int64)
    return bool((bits[-1] == bits[0]).all() and (bits == bits[0]).all())


@dataclass(frozen=True, repr=False)
class Recording:
    """Channels by topic, and what the reader had to say about the file they come from."""

    channels: Mapping[str, Channel]
    name: str = ""
    notes: tuple[str, ...] = ()  # losses, repairs and doubts, in plain words
    messages_lost: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    damage: tuple[str, ...] = ()  # what is known to be cut off or broken of the file, of which `notes` may say more

    def __repr__(self) -> str:
        return f"<Recording: {self.name or 'unnamed'}, {self.duration:.1f} s, {', '.join(self.channels) or 'empty'}>"

    def __iter__(self) -> Iterator[str]:
        """Topics."""
        return iter(self.channels)

    def __contains__(self, topic: str) -> bool:
        return topic in self.channels

    def __getitem__(self, topic: str) -> Channel:
        return self.channels[topic]

    @property
    def start(self) -> int:
        """Earliest time of arrival [ns]; 0 for an empty recording."""
        return min((int(c.received.min()) for c in self.channels.values() if len(c)), default=0)

    @property
    def first_stamp(self) -> int:
        """Earliest time of measurement [ns]; 0 for an empty recording."""
        return min((int(c.stamp.min()) for c in self.channels.values() if len(c)), default=0)

    @property
    def duration(self) -> float:
        """From the first to the last arrival [s]."""
        last = max((int(c.received.max()) for c in self.channels.values() if len(c)), default=0)
        return (last - self.start) * 1e-9

    @property
    def map_origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [deg] and height [m] of the map frame of the reference, if the file says so."""
        keys = ("origin_latitude_deg", "origin_longitude_deg", "origin_altitude_m")
        try:
            latitude, longitude, height = (float(self.metadata[key]) for key in keys)
        except (KeyError, ValueError):
            return None
        return (latitude, longitude, height) if np.isfinite((latitude, longitude, height)).all() else None

    def between(self, begin: float | None, end: float | None) -> Recording:
        """What was measured between two times [s since the first stamp]; all from the beginning, or to the end, where
        one is None."""
        first = self.first_stamp
        low, high = (None if limit is None else first + round(limit * 1e9) for limit in (begin, end))
        channels = {}
        for topic, channel in self.channels.items():
            rows = np.ones(len(channel), dtype=bool)
            if low is not None:
                rows &= channel.stamp >= low
            if high is not None:
                rows &= channel.stamp <= high
            if rows.any():
                channels[topic] = channel.select(rows)
        return replace(self, channels=channels)

    def digest(self, topics: Iterable[str] | None = None) -> bytes:
        """What distinguishes copies from other recordings: SHA-256 of stamps and values, on all topics or those."""
        digest, at_once = sha256(), 4096  # rows, as columns that never change are stored as one
        for topic in sorted(self.channels if topics is None else topics):
            channel = self.channels[topic]
            digest.update(topic.encode() + channel.stamp.tobytes())
            for name, values in sorted(channel.columns.items()):
                digest.update(name.encode())
                for first in range(0, len(values), at_once):
                    digest.update(np.ascontiguousarray(values[first : first + at_once]).data)
        return digest.digest()

    def tables(self) -> tuple[Table, ...]:
        """A table for each topic that has messages: its signals with their units, over its own times."""
        return tuple(channel.table() for channel in self.channels.values() if len(channel))

    def table(self) -> Table:
        """All signals over all times at which anything was measured; NaN where a signal was not. Nothing is
        interpolated."""
        return merged(self.tables(), self.name)

    def to_pandas(self) -> pandas.DataFrame:
        """`table` as a pandas frame over the time [s] since the first stamp; columns are named with their units, as
        `imu/data/angular_velocity.z [rad/s]`. Raises `MissingExtra` if pandas is not installed."""
        return self.table().to_pandas()

    def to_polars(self) -> polars.DataFrame:
        """`table` as a polars frame, with time [s] and stamp [ns] as its first columns. Raises `MissingExtra` if polars
        is not installed."""
        return self.table().to_polars()

    def to_xarray(self) -> xarray.Dataset:
        """`table` as an xarray data set over `time` [s], each variable with its unit in `attrs["units"]`. Raises
        `MissingExtra` if xarray is not installed."""
        return self.table().to_xarray()

    def compact(self) -> Recording:
        """The recording with columns that never change stored as one row: `Channel.compact`."""
        return replace(self, channels={topic: channel.compact() for topic, channel in self.channels.items()})

    def samples(self, topics: tuple[str, ...] | None = None) -> Iterator[Sample]:
        """All messages in order of arrival, ties in the order of the channels."""
        chosen = [c.in_order() for topic, c in self.channels.items() if topics is None or topic in topics]
        return by_arrival([c.received for c in chosen], [iter(c) for c in chosen])


def by_arrival(
    received: Sequence[NDArray[np.int64]], streams: Sequence[Iterator[T]], at_once: int = 1 << 16
) -> Iterator[T]:
    """What streams give, in order of arrival, ties in the order of the streams; `received` are ascending times of
    arrival [ns], as many as each stream gives. Of a stream about so many are put in order `at_once`."""
    begun = [0] * len(received)
    while left := [i for i, times in enumerate(received) if begun[i] < len(times)]:
        until = min(received[i][min(begun[i] + at_once, len(received[i])) - 1] for i in left)
        ends = [int(np.searchsorted(times, until, side="right")) for times in received]
        parts = [times[begin:end] for times, begin, end in zip(received, begun, ends, strict=True)]
        source = np.repeat(np.arange(len(streams)), [len(part) for part in parts])
        for index in source[np.argsort(np.concatenate(parts), kind="stable")].tolist():
            yield next(streams[index])
        begun = ends


def as_numbers(times: NDArray[np.int64], at_once: int = 1 << 12) -> Iterator[int]:
    """Times as numbers of Python, some at once: all of a drive of hours would take a gigabyte."""
    return chain.from_iterable(times[i : i + at_once].tolist() for i in range(0, len(times), at_once))
