"""The plausibility of what a driver has just received: the checks of recordings, on its latest seconds."""

from __future__ import annotations

from collections import deque

import numpy as np

from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.plausibility import Finding, findings
from vsense_ros.messages.recording import FIELDS, Channel, Recording, Sample

_SPAN = 40.0  # [s] that are looked at
_LEAST = 15.0  # [s] below which nothing is said
_EVERY = 10.0  # [s] between two looks
_RATE = 50.0  # [Hz] of a topic above which samples are left out
_NANO = 1_000_000_000
# What a few seconds cannot tell, or the monitor of a stream tells at once.
_NOT_ASKED = ("cut", "missing", "duplicates", "clock", "frozen", "held", "quantised", "jump")


class PlausibilityWatch:
    """Keeps the latest samples of a driver, and says in its diagnostics what cannot be true together of them."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._samples: dict[str, deque[Sample]] = {}
        self._last_look: int | None = None
        self._found: list[Finding] = []

    def add(self, sample: Sample) -> None:
        """Keep a sample."""
        kept = self._samples.get(sample.topic)
        if kept is None:
            kept = self._samples[sample.topic] = deque()
        if kept:
            if not 0 < sample.stamp - kept[-1].stamp < 10 * _NANO:
                if abs(sample.stamp - kept[-1].stamp) >= 10 * _NANO:
                    kept.clear()  # the clock was set, or the stream begins anew
            elif sample.stamp - kept[-1].stamp < _NANO / _RATE and sample.names == kept[-1].names:
                return
            while kept and sample.stamp - kept[0].stamp > _SPAN * _NANO:
                kept.popleft()
        kept.append(sample)

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """What cannot be true at `now` [ns]; nothing where there is no doubt."""
        if self._last_look is None or not 0 <= now - self._last_look < _EVERY * _NANO:
            self._last_look = now
            self._found = self._look()
        if not self._found:
            return []
        told = "; ".join(f"{finding.topic}: {finding.text}" for finding in self._found)
        return [Diagnostic(f"{self.name}: plausibility", Level.WARN, told)]

    def _look(self) -> list[Finding]:
        channels = {}
        for topic, kept in self._samples.items():
            if len(kept) > 20 and kept[-1].stamp - kept[0].stamp > _LEAST * _NANO:
                channels[topic] = _channel(list(kept))
        if not channels:
            return []
        return [f for f in findings(Recording(channels)) if f.fault not in _NOT_ASKED]


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
