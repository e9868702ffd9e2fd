"""The plausibility of what a driver has just received: the checks of recordings, on its latest seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Finding, Kind
from vsense_ros.checks.roles import USUAL_TOPICS, Topics
from vsense_ros.checks.sentences import sentences
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import FIELDS, Channel, Recording, Sample

_NANO = 1_000_000_000


@dataclass(frozen=True)
class WatchSettings:
    """How much of a stream is looked at, and how often."""

    span: float = setting(40.0, "s", "of the stream that are looked at", JUDGEMENT)
    least: float = setting(15.0, "s", "of a topic, of less of which nothing is said", JUDGEMENT)
    least_rows: int = setting(20, "-", "samples of a topic, likewise", JUDGEMENT)
    period: float = setting(10.0, "s", "between two looks", JUDGEMENT)
    step: float = setting(0.02, "s", "within which further samples of a topic are left out", JUDGEMENT)
    restart: float = setting(10.0, "s", "between two samples after which the stream begins anew", JUDGEMENT)


SETTINGS = WatchSettings()
_SPAN, _STEP, _RESTART = (round(one * _NANO) for one in (SETTINGS.span, SETTINGS.step, SETTINGS.restart))
# What shows in a few seconds. The rest does not, or the monitor of a stream says it at once.
_SHOWN = (Kind.SIGN, Kind.AXES, Kind.UNIT, Kind.LAG, Kind.FRAME, Kind.FAILED)


class PlausibilityWatch:
    """Keeps the latest samples of a driver, and says in its diagnostics what cannot be true together of them."""

    def __init__(self, name: str, topics: Topics = USUAL_TOPICS) -> None:
        self.name, self.topics = name, topics
        self._samples: dict[str, deque[Sample]] = {}
        self._last: dict[str, tuple[int, int, tuple[str, ...]]] = {}  # kept: stamp, that of the next, names
        self._last_look: int | None = None
        self._findings: list[Finding] = []

    def add(self, sample: Sample) -> None:
        """Keep a sample."""
        topic, stamp, names = sample.topic, sample.stamp, sample.names
        last = self._last.get(topic)
        if last is not None:
            latest, following, known = last
            if latest < stamp < following and known == names:
                return
        else:
            self._samples[topic] = deque()
            latest = stamp
        self._last[topic] = stamp, stamp + _STEP, names
        kept = self._samples[topic]
        if not -_RESTART < stamp - latest < _RESTART:
            kept.clear()  # the clock was set, or the stream begins anew
        begin = stamp - _SPAN
        while kept and kept[0].stamp < begin:
            kept.popleft()
        kept.append(sample)

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """What cannot be true at `now` [ns]; nothing where there is no doubt."""
        if self._last_look is None or not 0 <= now - self._last_look < SETTINGS.period * _NANO:
            self._last_look = now
            self._findings = self._look()
        if not self._findings:
            return []
        return [Diagnostic(f"{self.name}: plausibility", Level.WARN, "; ".join(sentences(self._findings)))]

    def _look(self) -> list[Finding]:
        channels = {}
        for topic, kept in list(self._samples.items()):
            if len(kept) > SETTINGS.least_rows and kept[-1].stamp - kept[0].stamp > SETTINGS.least * _NANO:
                channels[topic] = _channel(list(kept))
        if not channels:
            return []
        return [f for f in findings(Recording(channels), self.topics) if f.kind in _SHOWN]


def _channel(samples: list[Sample]) -> Channel:
    """Samples as a channel; joints that some of them lack are NaN there."""
    first = samples[0]
    names = tuple(dict.fromkeys(name for sample in samples for name in sample.names))
    columns = {}
    for field, width in FIELDS[first.kind].items():
        rows = [np.atleast_1d(sample.values.get(field, np.zeros(width))) for sample in samples]
        if width or all(sample.names == names for sample in samples):
            columns[field] = np.array(rows, float).reshape(len(samples), -1)
            continue
        table = np.full((len(samples), len(names)), np.nan)
        for row, (sample, values) in enumerate(zip(samples, rows, strict=True)):
            if len(values) == len(sample.names):
                table[row, [names.index(name) for name in sample.names]] = values
        columns[field] = table
    stamp = np.array([sample.stamp for sample in samples], np.int64)
    received = np.array([s.stamp if s.received is None else s.received for s in samples], np.int64)
    return Channel(first.topic, first.kind, stamp, received, columns, first.frame_id, names)
