"""What a recording holds and what looks wrong in it: rates, gaps, clocks, frozen signals, units, signs, frames.

Whether its signals can be true together, `plausibility.py` says. A doubt is a sentence for people; nothing is changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.plausibility import Finding, doubts, findings, measured, present
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import INPUTS, TOPICS, Topic

__all__ = ["Gap", "Inspection", "TopicInfo", "doubts", "inspect"]

Array = NDArray[np.float64]

_CLOCK_JUMP = 600.0  # [s] between two messages: no gap in the data but a clock that was set
_GAP = 3.0  # periods
_FROZEN = 1.0  # [s] of exactly the same values from an inertial sensor, which always has noise


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
    findings: tuple[Finding, ...] = ()  # of the checks of plausibility, also those that no topic has

    @property
    def problems(self) -> tuple[str, ...]:
        """All doubts, each with its topic."""
        known = {info.topic for info in self.topics}
        of_topics = [f"{info.topic}: {problem}" for info in self.topics for problem in info.problems]
        return (*(f"{f.topic}: {f.text}" for f in self.findings if f.topic not in known), *of_topics)


def inspect(recording: Recording, topics: Mapping[str, Topic] = TOPICS) -> Inspection:
    """Look through a recording; `topics` are all that somebody may read."""
    found = findings(recording)
    return Inspection(
        recording.name,
        recording.start,
        recording.duration,
        tuple(
            _topic(channel, recording.start, topics.get(topic), [f.text for f in found if f.topic == topic])
            for topic, channel in recording.channels.items()
        ),
        tuple(topic for topic in INPUTS if topic not in recording),
        recording.notes,
        recording.messages_lost,
        tuple(found),
    )


def _topic(channel: Channel, start: int, expected: Topic | None, doubts: list[str]) -> TopicInfo:
    step = np.diff(channel.stamp) * 1e-9
    jumped = np.abs(step) >= _CLOCK_JUMP
    normal = step[(step > 0) & ~jumped]
    # Messages that carry parts of a topic come in groups: the longer of their steps is the period.
    period = float(np.percentile(normal, 75)) if len(normal) else float("nan")
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
    signals = dict(measured(present(channel)))
    share = (
        float(np.mean([np.isnan(values).mean() for values in signals.values()])) if signals and len(channel) else 0.0
    )
    live = {name: values for name, values in signals.items() if not np.isnan(values).all()}
    constant = tuple(name for name, values in live.items() if len(values) > 1 and np.nanstd(values) == 0.0)
    problems += _inertial(channel, live)
    holes = {
        name: int(np.isnan(values).sum())
        for name, values in live.items()
        if np.isnan(values).any() and not _takes_turns(channel, values)
    }
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


def _takes_turns(channel: Channel, values: Array) -> bool:
    """Whether a signal is absent from messages that carry other parts of the topic, and comes regularly itself."""
    stamp = channel.stamp[np.isfinite(values)]
    if len(stamp) < 10:
        return False
    step = np.diff(np.concatenate([channel.stamp[:1], stamp, channel.stamp[-1:]]))
    return bool(step.max() <= _GAP * np.percentile(step, 75)) and len(stamp) < 0.9 * len(channel)


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
    for name, values in live.items():
        seconds, values = channel.seconds[np.isfinite(values)], values[np.isfinite(values)]
        breaks = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        first, last = breaks[:-1], breaks[1:] - 1
        length = seconds[last] - seconds[first]
        longest = int(np.argmax(length))
        if length[longest] >= _FROZEN and last[longest] - first[longest] >= 20:
            yield f"{name} is frozen for {length[longest]:.1f} s from {seconds[first[longest]]:.1f} s on"
