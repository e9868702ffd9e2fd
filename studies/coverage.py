"""Errors of estimates beside what the filter states of them, for the tables of several studies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from rich.table import Table

from vsense_ros.evaluate.baselines import trivial
from vsense_ros.evaluate.metrics import SignalScore, compare
from vsense_ros.evaluate.signals import SIGNALS
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.evaluate.wording import HEADINGS, score_cells
from vsense_ros.messages.recording import Recording

_SHOWN = HEADINGS[:4]  # error, share within two standard deviations, NEES, the error of what costs nothing
REFERENCE = "reference/odometry"


class Compared(NamedTuple):
    """Scores of one drive, and those of what costs nothing, by signal."""

    scores: Mapping[str, SignalScore]
    trivial: Mapping[str, tuple[str, SignalScore]]

    @classmethod
    def of(cls, output: Recording, recording: Recording, window: tuple[float, float] | None = None) -> Compared:
        """Compare estimates with the reference of a recording, between two times after its beginning [s]."""
        judged = recording if window is None else within(recording, *window)
        return cls(compare(output, judged), trivial(judged))

    def figures(self) -> dict[str, dict[str, float | None]]:
        """For each signal `within_2s`, `nees`, `rmse` and `trivial`, ready for JSON; SI units."""
        return {
            name: {
                "within_2s": one.within_2s,
                "nees": one.nees,
                "rmse": one.rmse,
                "trivial": self.trivial[name][1].rmse if name in self.trivial else None,
            }
            for name, one in self.scores.items()
        }


def within(recording: Recording, begin: float, end: float = np.inf) -> Recording:
    """The recording with its reference between two times after the beginning of that [s]."""
    channels = dict(recording.channels)
    for topic, channel in recording.channels.items():
        if topic.startswith("reference/"):
            seconds = (channel.stamp - recording[REFERENCE].stamp[0]) * 1e-9
            channels[topic] = channel.select((seconds >= begin) & (seconds <= end))
    return Recording(channels, recording.name, metadata=recording.metadata)


def coverage_table(drives: Mapping[str, Compared], title: str = "drive") -> Table:
    """For each drive and signal the error, the share of errors within two of the standard deviations that the filter
    states, NEES, and the error of what costs nothing."""
    table = plain_table(title, "signal", *_SHOWN, right=_SHOWN)
    for drive, compared in drives.items():
        for i, (name, score) in enumerate(compared.scores.items()):
            cells = score_cells(name, score, compared.trivial.get(name))[: len(_SHOWN)]
            table.add_row(drive if i == 0 else "", SIGNALS[name].label, *cells)
    return table
