"""What a recording holds and what looks wrong in it: rates, gaps, clocks, frozen signals, units, signs, frames.

Units and signs are judged against other sensors of the same drive: wheel speeds against GNSS speed, gyro and steering
against the turning of the GNSS course, accelerometers against gravity. A doubt is a sentence for people; nothing is
changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import INPUTS, TOPICS, Topic

Array = NDArray[np.float64]

_CLOCK_JUMP = 600.0  # [s] between two messages: no gap in the data but a clock that was set
_GAP = 3.0  # periods
_FROZEN = 1.0  # [s] of exactly the same values from an inertial sensor, which always has noise
_GRAVITY = 9.81  # [m/s²]
_AS_KNOWN = 0.1  # relative difference of a rolling radius and that of the vehicle file which asks no question


@dataclass(frozen=True)
class Gap:
    """A pause in a topic: when it begins, from the start of the recording [s], and how long it is [s]."""

    start: float
    length: float


@dataclass(frozen=True)
class TopicInfo:
    """One topic. Times in seconds; latencies are arrival minus measurement."""

    topic: str
    kind: str
    frame_id: str
    names: tuple[str, ...]
    count: int
    rate_hz: float  # between gaps; NaN for less than two messages
    gaps: tuple[Gap, ...]
    backwards: int  # messages measured before their predecessor
    duplicates: int  # messages with the time of their predecessor
    jumps: tuple[float, ...]  # of the clock, by how much
    latency_median: float
    latency_p99: float
    nan_share: float  # of the measured values
    constant: tuple[str, ...]  # signals that never change
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Inspection:
    """A whole recording."""

    name: str
    start: int  # Unix time [ns]
    duration: float  # [s]
    topics: tuple[TopicInfo, ...]
    missing: tuple[str, ...]  # input topics that the recording does not have
    notes: tuple[str, ...]  # of the reader
    messages_lost: int

    @property
    def problems(self) -> tuple[str, ...]:
        """All doubts, each with its topic."""
        return tuple(f"{info.topic}: {problem}" for info in self.topics for problem in info.problems)


def inspect(recording: Recording, topics: Mapping[str, Topic] = TOPICS) -> Inspection:
    """Look through a recording; `topics` are all that somebody may read."""
    found = doubts(recording)
    return Inspection(
        recording.name,
        recording.start,
        recording.duration,
        tuple(
            _topic(channel, recording.start, topics.get(topic), found.get(topic, []))
            for topic, channel in recording.channels.items()
        ),
        tuple(topic for topic in INPUTS if topic not in recording),
        recording.notes,
        recording.messages_lost,
    )


def _topic(channel: Channel, start: int, expected: Topic | None, doubts: list[str]) -> TopicInfo:
    step = np.diff(channel.stamp) * 1e-9
    jumped = np.abs(step) >= _CLOCK_JUMP
    normal = step[(step > 0) & ~jumped]
    period = float(np.median(normal)) if len(normal) else float("nan")
    paused = np.flatnonzero((step > _GAP * period) & ~jumped)
    steady = normal[normal <= _GAP * period]
    gaps = tuple(Gap((int(channel.stamp[i]) - start) * 1e-9, float(step[i])) for i in paused)
    backwards, duplicates = int((step < 0).sum()), int((step == 0).sum())
    latency = (channel.received - channel.stamp) * 1e-9 if len(channel) else np.full(1, np.nan)

    problems = [*_frames(channel, expected), *doubts]
    if gaps:
        longest = max(gaps, key=lambda gap: gap.length)
        problems.append(f"{len(gaps)} gaps, the longest {longest.length:.2f} s at {longest.start:.2f} s")
    for index in np.flatnonzero(jumped):
        at = (int(channel.received[index + 1]) - start) * 1e-9
        problems.append(f"the clock jumps by {step[index]:+.1f} s at {at:.2f} s")
    if backwards > int((step[jumped] < 0).sum()):
        problems.append(f"{backwards} messages are older than the one before them")
    if duplicates:
        problems.append(f"{duplicates} messages have the time stamp of the one before them")
    late = float(np.median(latency))
    if not -0.1 <= late <= 2.0 and not np.isnan(late):
        problems.append(f"time stamps are {late:.3f} s older than the arrival (median): is a clock wrong?")
    signals = dict(_signals(channel))
    share = (
        float(np.mean([np.isnan(values).mean() for values in signals.values()])) if signals and len(channel) else 0.0
    )
    live = {name: values for name, values in signals.items() if not np.isnan(values).all()}
    constant = tuple(name for name, values in live.items() if len(values) > 1 and np.nanstd(values) == 0.0)
    problems += _inertial(channel, live)
    holes = {name: int(np.isnan(values).sum()) for name, values in live.items() if np.isnan(values).any()}
    problems += [f"{name} is NaN in {count} of {len(channel)} messages" for name, count in holes.items()]
    return TopicInfo(
        channel.topic,
        channel.kind,
        channel.frame_id,
        channel.names,
        len(channel),
        1.0 / float(steady.mean()) if len(steady) else float("nan"),
        gaps,
        backwards,
        duplicates,
        tuple(step[jumped].tolist()),
        late,
        float(np.percentile(latency, 99)),
        share,
        constant,
        tuple(problems),
    )


def _signals(channel: Channel) -> Iterator[tuple[str, Array]]:
    """Measured values of a channel by name; fields that are marked absent are left out."""
    for field, column in channel.columns.items():
        if "covariance" in field or field in ("status", "service"):
            continue
        if channel.topic == "gps/velocity" and field == "angular":
            continue
        mark = channel.columns.get(f"{field}_covariance")
        if channel.kind == "sensor_msgs/msg/Imu" and mark is not None and mark.shape[1] and (mark[:, 0] == -1).all():
            continue
        labels = channel.names if channel.names else ("x", "y", "z", "w")
        for index in range(column.shape[1]):
            yield (f"{field}.{labels[index]}" if column.shape[1] > 1 or channel.names else field), column[:, index]


def _frames(channel: Channel, expected: Topic | None) -> Iterator[str]:
    """Doubts about type, frames and names."""
    if expected is None:
        if not channel.topic.startswith("vsense/"):
            yield "no topic of this project: nothing reads it"
        return
    if channel.kind != expected.kind:
        yield f"type is {channel.kind}, expected {expected.kind}"
        return
    for what, found, wanted in (
        ("frame id", channel.frame_id, expected.frame_id),
        ("child frame id", channel.child_frame_id, expected.child_frame_id),
    ):
        if wanted and found != wanted:
            yield f"{what} is {found!r}, expected {wanted!r}"
    unknown = [name for name in channel.names if expected.names and name not in expected.names]
    if unknown:
        yield f"names {', '.join(unknown)} are unknown, expected {', '.join(expected.names)}"


def _inertial(channel: Channel, live: dict[str, Array]) -> Iterator[str]:
    """Inertial signals that stand still."""
    if channel.topic != "imu/data" or len(channel) < 2:
        return
    seconds = channel.seconds
    for name, values in live.items():
        breaks = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        first, last = breaks[:-1], breaks[1:] - 1
        length = seconds[last] - seconds[first]
        longest = int(np.argmax(length))
        if length[longest] >= _FROZEN and last[longest] - first[longest] >= 20:
            yield f"{name} is frozen for {length[longest]:.1f} s from {seconds[first[longest]]:.1f} s on"


def doubts(recording: Recording, radius: float | None = None) -> dict[str, list[str]]:
    """Doubts about units and signs, by topic; the rolling `radius` [m] is that of the car, if it is known."""
    found = {
        "imu/data": [*_gravity(recording), *_turning(recording)],
        "vehicle/wheel_speeds": list(_rolling(recording, radius)),
        "vehicle/steering": [*_steering_range(recording), *_steering_sign(recording)],
        "gps/fix": list(_fixes(recording)),
        "vehicle/brake_pressure": list(_pressure(recording)),
    }
    return {topic: sentences for topic, sentences in found.items() if sentences}


def _channel(recording: Recording, topic: str) -> Channel | None:
    """A topic of the right type with more than a second of data."""
    channel = recording.channels.get(topic)
    if channel is None or channel.kind != TOPICS[topic].kind or len(channel) < 10 or np.ptp(channel.seconds) < 1.0:
        return None
    return channel


def _gnss_motion(recording: Recording) -> tuple[NDArray[np.int64], Array, Array] | None:
    """Times [ns], speeds [m/s] and unwrapped courses [rad, counter-clockwise from east] of GNSS."""
    channel = _channel(recording, "gps/velocity")
    if channel is None:
        return None
    order = np.argsort(channel.stamp, kind="stable")
    east, north = channel.columns["linear"][order, :2].T
    good = np.isfinite(east) & np.isfinite(north)
    if good.sum() < 10:
        return None
    return channel.stamp[order][good], np.hypot(east, north)[good], np.unwrap(np.arctan2(north, east)[good])


def _at(stamp: NDArray[np.int64], channel: Channel, values: Array) -> Array:
    """Values of a channel at other times; NaN where it has none."""
    good = np.isfinite(values)
    if not good.any():
        return np.full(len(stamp), np.nan)
    order = np.argsort(channel.stamp[good], kind="stable")
    return np.interp(
        (stamp - stamp[0]) * 1e-9, (channel.stamp[good][order] - stamp[0]) * 1e-9, values[good][order], np.nan, np.nan
    )


def _rolling(recording: Recording, known: float | None) -> Iterator[str]:
    wheels, motion = _channel(recording, "vehicle/wheel_speeds"), _gnss_motion(recording)
    if wheels is None or motion is None:
        return
    wheels = wheels.select(np.flatnonzero(np.isfinite(wheels.columns["velocity"]).any(axis=1)))
    if not len(wheels):
        return
    stamp, speed, _ = motion
    turning = _at(stamp, wheels, np.nanmean(wheels.columns["velocity"], axis=1))
    moving = (speed > 3.0) & np.isfinite(turning) & (np.abs(turning) > 0.1)
    if moving.sum() < 10:
        return
    radius = float(np.median(speed[moving] / turning[moving]))
    if radius < 0:
        yield "turn backwards while GNSS moves: is the sign wrong?"
    if known is not None and abs(abs(radius) / known - 1.0) < _AS_KNOWN:
        return
    guesses = {"m/s": 1.0, "km/h": 1 / 3.6, "rpm": 2 * np.pi / 60 * 0.32, "deg/s": np.pi / 180 * 0.32}
    for unit, ratio in guesses.items():
        tolerance = 0.03 if unit in ("m/s", "km/h") else 0.4
        if abs(abs(radius) / ratio - 1.0) < tolerance:
            yield f"look like {unit}, expected rad/s: GNSS speed is {abs(radius):.4f} times their values"
            return
    if not 0.2 < abs(radius) < 0.6:
        yield f"GNSS speed is {abs(radius):.4f} m times their values, which is no rolling radius of a car"


def _gravity(recording: Recording) -> Iterator[str]:
    imu = _channel(recording, "imu/data")
    if imu is None or (imu.columns["linear_acceleration_covariance"][:, 0] == -1).all():
        return
    mean = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in imu.columns["linear_acceleration"].T])
    if np.isnan(mean).any():
        return
    size = float(np.linalg.norm(mean))
    if 0.9 < size < 1.1:
        yield "specific force looks like g, expected m/s²: its mean is 1"
    elif size < 1.0:
        yield "specific force has no gravity in it: expected +9.81 m/s² upwards at rest"
    elif abs(size - _GRAVITY) > 1.5:
        yield f"specific force has a mean of {size:.2f}, expected 9.81 m/s²"
    axis = int(np.argmax(np.abs(mean)))
    if size >= 0.9 and (axis != 2 or mean[2] < 0):
        yield f"gravity is on {'-' if mean[axis] < 0 else '+'}{'xyz'[axis]}, expected +z (axes x forward, y left, z up)"


def _turns(recording: Recording, channel: Channel, values: Array) -> tuple[float, float] | None:
    """Slope and correlation of values against the turning rate of the GNSS course, both over one second."""
    motion = _gnss_motion(recording)
    if motion is None:
        return None
    stamp, speed, course = motion
    seconds = (stamp - stamp[0]) * 1e-9
    later = np.searchsorted(seconds, seconds + 1.0)
    row = np.flatnonzero(later < len(seconds))
    later = later[row]
    span = seconds[later] - seconds[row]
    fast = (speed[row] > 5.0) & (speed[later] > 5.0) & (span < 1.5) & (span > 0)
    if fast.sum() < 10:
        return None
    row, later, span = row[fast], later[fast], span[fast]
    rate = (course[later] - course[row]) / span
    good = np.isfinite(values)
    if good.sum() < 10:
        return None
    order = np.argsort(channel.stamp[good], kind="stable")
    time = (channel.stamp[good][order] - stamp[0]) * 1e-9
    sums = np.concatenate([[0.0], np.cumsum(np.diff(time) * values[good][order][:-1])])
    mean = (np.interp(seconds[later], time, sums) - np.interp(seconds[row], time, sums)) / span
    if np.std(rate) < np.radians(0.4) or np.std(mean) == 0.0:
        return None
    correlation = float(np.corrcoef(rate, mean)[0, 1])
    return float(np.std(mean) / np.std(rate)) * np.sign(correlation), correlation


def _turning(recording: Recording) -> Iterator[str]:
    imu = _channel(recording, "imu/data")
    if imu is None or (imu.columns["angular_velocity_covariance"][:, 0] == -1).all():
        return
    found = _turns(recording, imu, imu.columns["angular_velocity"][:, 2])
    if found is None or abs(found[1]) < 0.6:
        return
    slope = found[0]
    if slope < 0:
        yield "the yaw rate is against the turning of the GNSS course: expected positive to the left"
    if 30 < abs(slope) < 100:
        yield f"the yaw rate looks like deg/s, expected rad/s: it is {abs(slope):.1f} times the turning of the course"
    elif not 0.5 < abs(slope) < 2.0:
        yield f"the yaw rate is {abs(slope):.3f} times the turning of the GNSS course, expected 1"


def _steering_range(recording: Recording) -> Iterator[str]:
    steering = _channel(recording, "vehicle/steering")
    if steering is None or steering.columns["position"].shape[1] == 0:
        return
    for index, name in enumerate(steering.names):
        values = steering.columns["position"][:, index]
        largest = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        limit = 1.2 if name.startswith("road_wheel") else 15.0
        if largest > limit:
            yield f"{name} reaches {largest:.1f} rad, which no car does: is it in degrees?"


def _steering_sign(recording: Recording) -> Iterator[str]:
    steering = _channel(recording, "vehicle/steering")
    if steering is None or steering.columns["position"].shape[1] == 0:
        return
    for index, name in enumerate(steering.names):
        found = _turns(recording, steering, steering.columns["position"][:, index])
        if found is None or abs(found[1]) < 0.6:
            continue
        slope = abs(found[0])
        if found[1] < 0:
            yield f"{name} is against the turning of the GNSS course: expected positive to the left"
        # Steering angle over yaw rate is (wheelbase / speed + understeer) times the ratio: below 5 s for any car at
        # more than 5 m/s; in degrees it is at least 57 times the smallest, 0.1 s.
        if slope > (2.0 if name.startswith("road_wheel") else 40.0):
            yield f"{name} is {slope:.0f} s times the yaw rate, which is too much for rad: is it in degrees?"


def _fixes(recording: Recording) -> Iterator[str]:
    channel = _channel(recording, "gps/fix")
    if channel is None:
        return
    latitude, longitude = channel.columns["latitude"][:, 0], channel.columns["longitude"][:, 0]
    if not (np.isfinite(latitude) & np.isfinite(longitude)).any():
        return
    if np.nanmax(np.abs(latitude)) > 90 or np.nanmax(np.abs(longitude)) > 180:
        yield "latitude or longitude is out of range: expected degrees"
        return
    if np.nanmax(np.abs(latitude)) < 1.6 and np.nanmax(np.abs(longitude)) < 3.2:
        yield "latitude and longitude are near zero: are they radians, or is there no fix?"
        return
    motion = _gnss_motion(recording)
    if motion is None:
        return
    stamp, speed, _ = motion
    north = np.diff(latitude) * 111_200.0
    east = np.diff(longitude) * 111_200.0 * np.cos(np.radians(latitude[:-1]))
    moved = np.hypot(east, north)
    pause = np.diff(channel.stamp) * 1e-9
    fast = np.interp((channel.stamp - stamp[0]) * 1e-9, (stamp - stamp[0]) * 1e-9, speed)
    reach = np.maximum(fast[:-1], fast[1:]) * np.abs(pause) * 1.5 + 5.0
    for index in np.flatnonzero((moved > reach) & (np.abs(pause) < 60.0)):
        at = (int(channel.stamp[index + 1]) - recording.start) * 1e-9
        yield f"the position jumps by {moved[index]:.1f} m at {at:.2f} s, at {fast[index]:.1f} m/s"


def _pressure(recording: Recording) -> Iterator[str]:
    channel = _channel(recording, "vehicle/brake_pressure")
    if channel is None or channel.columns["effort"].shape[1] == 0:
        return
    largest = float(np.nanmax(channel.columns["effort"]))
    if 0.5 < largest < 1000.0:
        yield f"reaches {largest:.1f} Pa only, which brakes nothing: is it in bar or kPa?"
