"""What a recording holds and what looks wrong in it: rates, gaps, clocks, frozen signals, units, signs, frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import USUAL_TOPICS, Role, Topics
from vsense_ros.checks.sentences import sentence
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import measured, present
from vsense_ros.checks.values import standing_signals
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import TOPICS, Topic

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StreamSettings:
    """What is unusual in a stream of messages."""

    clock_jump: float = setting(600.0, "s", "between two messages that is no gap but a clock that was set", JUDGEMENT)
    gap: float = setting(3.0, "-", "periods between two messages that are a gap", JUDGEMENT)
    frozen: float = setting(1.0, "s", "of equal values from an inertial sensor, which always has noise", JUDGEMENT)
    frozen_rows: int = setting(20, "-", "messages in that time", JUDGEMENT)
    latency: tuple[float, float] = setting((-0.1, 2.0), "s", "median age of messages on arrival", JUDGEMENT)
    partial: float = setting(0.9, "-", "share of messages, with less of which a signal takes turns", JUDGEMENT)


SETTINGS = StreamSettings()
_OWN = "vsense/"  # begins the topics of the project's own estimates


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
    findings: tuple[Finding, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """What cannot be right of it, in words."""
        return tuple(map(sentence, self.findings))


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
    findings: tuple[Finding, ...] = ()  # of all checks, also those that concern no topic

    @property
    def problems(self) -> tuple[str, ...]:
        """All that cannot be right, each with its topic."""
        known = {info.topic for info in self.topics}
        of_topics = [f"{info.topic}: {problem}" for info in self.topics for problem in info.problems]
        return (*(f"{f.topic}: {sentence(f)}" for f in self.findings if f.topic not in known), *of_topics)


def inspect(recording: Recording, expected: Mapping[str, Topic] = TOPICS, topics: Topics = USUAL_TOPICS) -> Inspection:
    """Look through a recording. `expected` are all topics that somebody may read, `topics` those of the vehicle by
    role."""
    reported = findings(recording, topics)
    return Inspection(
        recording.name,
        recording.start,
        recording.duration,
        tuple(
            _topic(channel, recording.start, expected.get(topic), [f for f in reported if f.topic == topic], topics)
            for topic, channel in recording.channels.items()
        ),
        tuple(topic for topic in topics.values() if topic not in recording),
        recording.notes,
        recording.messages_lost,
        tuple(reported),
    )


def _topic(
    channel: Channel, start: int, expected: Topic | None, findings: Sequence[Finding], topics: Topics
) -> TopicInfo:
    step = np.diff(channel.stamp) * 1e-9
    jumped = np.abs(step) >= SETTINGS.clock_jump
    normal = step[(step > 0) & ~jumped]
    # Messages that carry parts of a topic come in groups: the longer of their steps is the period.
    period = float(np.percentile(normal, 75)) if len(normal) else float("nan")
    paused = np.flatnonzero((step > SETTINGS.gap * period) & ~jumped)
    steady = normal[normal <= SETTINGS.gap * period]
    gaps = tuple(Gap((int(channel.stamp[i]) - start) * 1e-9, float(step[i])) for i in paused)
    latency = np.asarray((channel.received - channel.stamp) * 1e-9 if len(channel) else [np.nan], dtype=float)
    signals = dict(measured(present(channel)))
    live = {name: values for name, values in signals.items() if not np.isnan(values).all()}
    absent = [float(np.isnan(values).mean()) for values in signals.values()] if len(channel) else []
    return TopicInfo(
        channel.topic,
        channel.kind,
        channel.frame_id,
        channel.names,
        len(channel),
        1.0 / float(steady.mean()) if len(steady) else float("nan"),
        gaps,
        int((step < 0).sum()),
        int((step == 0).sum()),
        tuple(step[jumped].tolist()),
        float(np.median(latency)),
        float(np.percentile(latency, 99)),
        float(np.mean(absent)) if absent else 0.0,
        tuple(name for name, values in live.items() if len(values) > 1 and np.nanstd(values) == 0.0),
        (
            *_labels(channel, expected), *findings, *_gaps(channel, gaps), *_stamps(channel, start, jumped, latency),
            *_frozen(channel, topics), *_holes(channel, live),
        ),
    )  # fmt: skip


def _labels(channel: Channel, expected: Topic | None) -> Iterator[Finding]:
    """Type, frames and names that nobody expects."""
    topic, certain = channel.topic, Confidence.CERTAIN
    if expected is None:
        if not topic.startswith(_OWN):
            yield Finding(topic, Kind.MISSING, Reason.TOPIC_UNKNOWN, confidence=certain)
        return
    if channel.kind != expected.kind:
        names = {"actual": channel.kind, "expected": expected.kind}
        yield Finding(topic, Kind.FRAME, Reason.TYPE_UNEXPECTED, confidence=certain, names=names)
        return
    for what, actual, wanted in (
        ("frame id", channel.frame_id, expected.frame_id),
        ("child frame id", channel.child_frame_id, expected.child_frame_id),
    ):
        if wanted and actual != wanted:
            names = {"what": what, "actual": actual, "expected": wanted}
            yield Finding(topic, Kind.FRAME, Reason.FRAME_UNEXPECTED, confidence=certain, names=names)
    unknown = [name for name in channel.names if expected.names and name not in expected.names]
    if unknown:
        names = {"actual": ", ".join(unknown), "expected": ", ".join(expected.names)}
        yield Finding(topic, Kind.MISSING, Reason.NAMES_UNKNOWN, confidence=certain, names=names)


def _gaps(channel: Channel, gaps: Sequence[Gap]) -> Iterator[Finding]:
    if gaps:
        longest = max(gaps, key=lambda gap: gap.length)
        span = longest.start, longest.start + longest.length
        yield Finding(channel.topic, Kind.GAP, Reason.GAPS, span=span, evidence={"count": float(len(gaps))})


def _stamps(channel: Channel, start: int, jumped: NDArray[np.bool_], latency: Array) -> Iterator[Finding]:
    """Clocks that were set, messages out of order, and stamps that are much older than the arrival."""
    topic, step = channel.topic, np.diff(channel.stamp) * 1e-9
    for index in np.flatnonzero(jumped):
        when = (int(channel.received[index + 1]) - start) * 1e-9
        evidence = {"change": float(step[index])}
        yield Finding(topic, Kind.CLOCK, Reason.CLOCK_JUMPS, span=(when, when), evidence=evidence)
    backwards, again = int((step < 0).sum()), int((step == 0).sum())
    if backwards > int((step[jumped] < 0).sum()):
        yield Finding(topic, Kind.ORDER, Reason.OLDER_THAN_LAST, evidence={"count": float(backwards)})
    if again:
        yield Finding(topic, Kind.DUPLICATES, Reason.SAME_STAMP, evidence={"count": float(again)})
    usual = float(np.median(latency))
    if not SETTINGS.latency[0] <= usual <= SETTINGS.latency[1] and not np.isnan(usual):
        yield Finding(topic, Kind.CLOCK, Reason.STAMPS_OLD, evidence={"latency": usual})


def _frozen(channel: Channel, topics: Topics) -> Iterator[Finding]:
    """Inertial signals that stand still."""
    if channel.topic == topics[Role.IMU]:
        for name, begin, end in standing_signals(present(channel), SETTINGS.frozen, SETTINGS.frozen_rows):
            yield Finding(channel.topic, Kind.FROZEN, Reason.VALUE_STANDS, name, span=(begin, end))


def _holes(channel: Channel, live: Mapping[str, Array]) -> Iterator[Finding]:
    """Signals that are absent from some messages."""
    for name, values in live.items():
        count = int(np.isnan(values).sum())
        if count and not _takes_turns(channel, values):
            evidence = {"count": float(count), "rows": float(len(channel))}
            yield Finding(channel.topic, Kind.MISSING, Reason.NOT_A_NUMBER, name, evidence=evidence)


def _takes_turns(channel: Channel, values: Array) -> bool:
    """True if a signal is absent from messages that carry other parts of the topic, and comes regularly itself."""
    stamp = channel.stamp[np.isfinite(values)]
    if len(stamp) < 10:
        return False
    step = np.diff(np.concatenate([channel.stamp[:1], stamp, channel.stamp[-1:]]))
    return bool(step.max() <= SETTINGS.gap * np.percentile(step, 75)) and len(stamp) < SETTINGS.partial * len(channel)
