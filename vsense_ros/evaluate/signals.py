"""The signals that are compared, shown and tabled: their names, units and where they stand in the topics.

`vsense/*` (estimates) and `reference/*` (truth) carry the same messages, so one reading serves both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.estimates import UNESTIMATED_VARIANCE
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import WHEELS

MOST_POINTS = 1600  # of a curve, beyond which neither print nor screen shows more
PERIODS_OF_A_GAP = 10.0  # the usual time from one value to the next, after which a signal was interrupted
SLOWEST_SIDE_SLIP = 3.0  # below this speed the angle of the velocity vector says nothing [m/s]
# Standard deviation from which a heading is not known [rad]; that of one that may be anywhere is 104°.
UNKNOWN_HEADING = pi / 3

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Signal:
    """Name and unit of a signal; `shown_unit` and `shown_per_unit` are what people read it in.

    The range of one that is not `ranged`, as of a position, is that of the drive, not of what is hard to estimate. An
    estimate with a standard deviation of `unknown` [unit] or more claims nothing.
    """

    name: str
    label: str
    unit: str
    shown_unit: str
    shown_per_unit: float = 1.0
    angle: bool = False
    ranged: bool = True
    unknown: float = np.inf


@dataclass(frozen=True, slots=True)
class Series:
    """A signal over time, sorted by time of measurement.

    `stamp` (n,) [ns]; `value` (n, k) in the signal's unit, k = 2 for the horizontal position and 1 otherwise;
    `deviation` (n,) one standard deviation, of each component, where the message carries it; infinite where the value
    means nothing.
    """

    signal: Signal
    stamp: NDArray[np.int64]
    value: Array
    deviation: Array | None = None

    def __len__(self) -> int:
        return len(self.stamp)

    def shown(self) -> Array:
        """(n,) of a scalar signal in the unit people read it in."""
        return self.value[:, 0] * self.signal.shown_per_unit

    def band(self) -> Array | None:
        """(n,) two standard deviations in the unit people read it in; NaN where the value is not known at all, as the
        side slip of a car at rest."""
        if self.deviation is None:
            return None
        return np.where(np.isfinite(self.deviation), 2.0 * self.deviation * self.signal.shown_per_unit, np.nan)


def _signals() -> Mapping[str, Signal]:
    degree = 180.0 / pi
    chosen = [
        Signal("side_slip", "side slip", "rad", "°", degree, angle=True),
        Signal("lateral_velocity", "lateral velocity", "m/s", "m/s"),
        Signal("longitudinal_velocity", "longitudinal velocity", "m/s", "m/s"),
        Signal("speed", "speed", "m/s", "m/s"),
        Signal("yaw_rate", "yaw rate", "rad/s", "°/s", degree),
        Signal("yaw", "yaw", "rad", "°", degree, angle=True, ranged=False, unknown=UNKNOWN_HEADING),
        Signal("roll", "roll", "rad", "°", degree, angle=True),
        Signal("pitch", "pitch", "rad", "°", degree, angle=True),
        Signal("position", "horizontal position", "m", "m", ranged=False),
    ]
    for axis in ("longitudinal", "lateral", "vertical"):
        chosen.append(Signal(f"{axis}_acceleration", f"{axis} acceleration", "m/s²", "m/s²"))
    for wheel in WHEELS:
        for axis, label in (("x", "longitudinal"), ("y", "lateral"), ("z", "vertical")):
            chosen.append(Signal(f"wheel_force_{wheel}_{axis}", f"{label} tyre force {wheel.upper()}", "N", "kN", 1e-3))
    return {signal.name: signal for signal in chosen}


SIGNALS = _signals()


def find_channel(recording: Recording, topic: str) -> Channel | None:
    """The channel of a relative topic name, with or without a namespace before it; None: absent or empty."""
    for name, channel in recording.channels.items():
        if (name == topic or name.endswith("/" + topic)) and len(channel):
            return channel
    return None


def wrap(angle: Array) -> Array:
    """Angles into [-π, π) [rad]."""
    return (angle + pi) % (2.0 * pi) - pi


def euler_angles(quaternion: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw (ISO 8855: yaw about z, then pitch about y, then roll about x) [rad].

    `quaternion` (n, 4) as x, y, z, w; rows that are no rotation (all zeros) give NaN.
    """
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z, w = np.where(length > 0.5, quaternion / length, np.nan).T
    return (
        np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def read_signals(recording: Recording, source: str) -> dict[str, Series]:
    """All signals that `recording` holds below `source` ("vsense" or "reference").

    A value that is not finite, or whose variance is negative, not a number, or `UNESTIMATED_VARIANCE` (ways to say
    "absent"), is left out; a signal without any value is no signal. The side slip is what `<source>/sideslip` says,
    else the angle of the velocity vector, and is only given at more than `SLOWEST_SIDE_SLIP` where it is the angle of a
    velocity.
    """
    series_by_name: dict[str, Series] = {}

    def keep(name: str, channel: Channel, value: Array, variance: Array | None = None) -> None:
        series = make_series(SIGNALS[name], channel, value, variance)
        if len(series):
            series_by_name[name] = series

    odometry = find_channel(recording, f"{source}/odometry")
    if odometry is not None:
        _read_odometry(odometry, keep)
    sideslip = find_channel(recording, f"{source}/sideslip")
    if sideslip is not None:
        vector = sideslip.columns["vector"]
        keep("side_slip", sideslip, vector[:, :1], vector[:, 1] ** 2)
    acceleration = find_channel(recording, f"{source}/acceleration")
    if acceleration is not None:
        for column, axis in enumerate(("longitudinal", "lateral", "vertical")):
            value = acceleration.columns["linear"][:, column : column + 1]
            keep(f"{axis}_acceleration", acceleration, value, _variance(acceleration, "covariance", column))
    for wheel in WHEELS:
        force = find_channel(recording, f"{source}/wheel_force/{wheel}")
        if force is not None:
            deviation = find_channel(recording, f"{source}/wheel_force_deviation/{wheel}")
            has_deviation = deviation is not None and np.array_equal(deviation.stamp, force.stamp)
            for column, letter in enumerate("xyz"):
                variance = (
                    deviation.columns["force"][:, column] ** 2 if deviation is not None and has_deviation else None
                )
                keep(f"wheel_force_{wheel}_{letter}", force, force.columns["force"][:, column : column + 1], variance)
    return {name: series_by_name[name] for name in SIGNALS if name in series_by_name}


def _read_odometry(odometry: Channel, keep: Callable[[str, Channel, Array, Array | None], None]) -> None:
    linear, angular = odometry.columns["linear"], odometry.columns["angular"]
    variance = [_variance(odometry, "twist_covariance", axis) for axis in range(6)]
    speed = np.hypot(linear[:, 0], linear[:, 1])
    keep("longitudinal_velocity", odometry, linear[:, :1], variance[0])
    keep("lateral_velocity", odometry, linear[:, 1:2], variance[1])
    keep("yaw_rate", odometry, angular[:, 2:], variance[5])
    lateral_absent = variance[1] is not None and not np.any(
        (variance[1] >= 0.0) & (variance[1] != UNESTIMATED_VARIANCE)
    )
    if lateral_absent:
        keep("speed", odometry, np.abs(linear[:, :1]), variance[0])
    else:
        keep("speed", odometry, speed[:, None], variance[0])
        side_slip = np.where(speed > SLOWEST_SIDE_SLIP, np.arctan2(linear[:, 1], linear[:, 0]), np.nan)
        keep("side_slip", odometry, side_slip[:, None], None)
    variance = [_variance(odometry, "pose_covariance", axis) for axis in range(6)]
    for axis, (name, angle) in enumerate(
        zip(("roll", "pitch", "yaw"), euler_angles(odometry.columns["orientation"]), strict=True)
    ):
        keep(name, odometry, angle[:, None], variance[3 + axis])
    east, north = variance[:2]
    # One for both directions; where that of one is absent, so is the position.
    variance_of_either = (
        None if east is None or north is None else np.where((east < 0) | (north < 0), -1.0, (east + north) / 2)
    )
    keep("position", odometry, odometry.columns["position"][:, :2], variance_of_either)


def _variance(channel: Channel, column: str, axis: int) -> Array | None:
    """(rows,) of the diagonal of a 6x6 covariance; negative: the value is absent; None: the message has none."""
    if column not in channel.columns:
        return None
    covariance = channel.columns[column]
    return np.where(covariance[:, 0] == -1.0, -1.0, covariance[:, 7 * axis])


def make_series(signal: Signal, channel: Channel, value: Array, variance: Array | None = None) -> Series:
    """`value` (rows, k) of a channel as a series.

    Sorted by stamp; of two values with one stamp the one that arrived last.
    """
    good = np.isfinite(value).all(axis=1)
    if variance is not None:
        good &= (variance >= 0.0) & (variance != UNESTIMATED_VARIANCE)
    rows = np.flatnonzero(good)[::-1]
    stamp, first = np.unique(channel.stamp[rows], return_index=True)
    rows = rows[first]
    deviation = None
    if variance is not None and np.any(variance[rows] > 0.0):
        deviation = np.sqrt(variance[rows])
    return Series(signal, stamp, value[rows], deviation)


def thin(value: Array, points: int = MOST_POINTS) -> NDArray[np.intp]:
    """Rows that keep the extremes of each of `points` / 2 stretches: peaks survive, unlike with a stride."""
    if len(value) <= points:
        return np.arange(len(value))
    bins = points // 2
    edges = np.linspace(0, len(value), bins + 1).astype(int)
    rows = [first + pick(value[first:last]) for first, last in pairwise(edges) for pick in (np.argmin, np.argmax)]
    return np.unique(np.array(rows, dtype=np.intp))


def longest_period(stamp: NDArray[np.int64]) -> float:
    """Time from one value to the next [s] beyond which a signal with these stamps [ns] was interrupted."""
    return PERIODS_OF_A_GAP * float(np.median(np.diff(stamp))) * 1e-9 if len(stamp) > 1 else 0.0


def gaps(stamp: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 2) last stamp before and first after each interruption of a signal with these stamps [ns]."""
    before = np.flatnonzero(np.diff(stamp) * 1e-9 > longest_period(stamp))
    return np.column_stack([stamp[before], stamp[before + 1]])


def curve(stamp: NDArray[np.int64], start: int, *values: Array) -> tuple[Array, ...]:
    """Times after `start` [ns] in seconds, and values (n,), of curves as they are drawn.

    They keep the extremes of the first one (`thin`), and are not a number within an interruption, where no line may
    lead from one side to the other.
    """
    interrupted = gaps(stamp)
    rows = np.union1d(thin(values[0]), np.searchsorted(stamp, interrupted.ravel())).astype(np.intp)
    places = np.searchsorted(stamp[rows], interrupted[:, 1])
    times = (stamp[rows] - start) * 1e-9
    middles = (interrupted.mean(axis=1) - start) * 1e-9
    return np.insert(times, places, middles), *(np.insert(value[rows], places, np.nan) for value in values)
