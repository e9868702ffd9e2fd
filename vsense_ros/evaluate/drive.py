"""One drive with all that is to be said about it, for tables, pictures and reports alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from vsense_ros.checks.inspect import TopicInfo, inspect
from vsense_ros.evaluate.balance import Balance, balance
from vsense_ros.evaluate.baselines import trivial
from vsense_ros.evaluate.metrics import SignalScore, compare, without_reference
from vsense_ros.evaluate.signals import find_channel, gaps
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import known_topics
from vsense_ros.model.vehicle import Vehicle


class RunFigures(Protocol):
    """What a run of an observer leaves behind, with or without ROS."""

    @property
    def output(self) -> Recording: ...
    @property
    def step_us_median(self) -> float: ...
    @property
    def realtime_factor(self) -> float: ...
    @property
    def messages_lost(self) -> int: ...
    @property
    def diagnostics(self) -> list[Diagnostic]: ...


@dataclass(frozen=True)
class Drive:
    """Input, output, scores and figures of one drive.

    `baselines` holds scores of simpler ways to the same signals, `trivial` those of what costs nothing, with its name;
    `way` says in words how the drive was computed; `notes` is what a reader must know (what was left out, what was lost
    and where).
    """

    name: str
    title: str
    input: Recording
    output: Recording
    scores: Mapping[str, SignalScore]
    unreferenced: tuple[str, ...]
    step_us_median: float
    realtime_factor: float
    messages_lost: int
    diagnostics: tuple[Diagnostic, ...] = ()
    baselines: Mapping[str, Mapping[str, SignalScore]] = field(default_factory=dict)
    way: str = ""
    notes: tuple[str, ...] = ()
    trivial: Mapping[str, tuple[str, SignalScore]] = field(default_factory=dict)
    balance: Balance | None = None  # of the tyre forces with the inertial sensor

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        input: Recording,
        run: RunFigures,
        *,
        vehicle: Vehicle | None = None,
        baselines: Mapping[str, Mapping[str, SignalScore]] | None = None,
        way: str = "",
        notes: tuple[str, ...] = (),
    ) -> Drive:
        """Compare the output of a run with the reference of its input; forces are added up for a `vehicle`."""
        scores = compare(run.output, input)
        return cls(
            name=name,
            title=title,
            input=input,
            output=run.output,
            scores=scores,
            unreferenced=tuple(without_reference(run.output, scores)),
            step_us_median=run.step_us_median,
            realtime_factor=run.realtime_factor,
            messages_lost=run.messages_lost,
            diagnostics=tuple(run.diagnostics),
            baselines=baselines or {},
            trivial=trivial(input),
            way=way,
            notes=notes + tuple(note for note in input.notes if note not in notes),
            balance=None if vehicle is None else balance(run.output, vehicle),
        )

    def summary(self) -> dict[str, Any]:
        """The drive as numbers, ready for JSON; SI units, None where a score has no value."""
        return {
            "signals": {
                name: {
                    "rmse": score.rmse,
                    "nrmsd_percent": score.nrmsd_percent,
                    "bias": score.bias,
                    "lag_s": score.lag_s,
                    "unit": score.unit,
                    "within_2s": score.within_2s,
                    "nees": score.nees,
                    "known": score.known_share,
                    "trivial": self.trivial[name][1].rmse if name in self.trivial else None,
                }
                for name, score in self.scores.items()
            },
            "balance_percent": None if self.balance is None else self.balance.percent,
            "step_us_median": _finite(self.step_us_median),
            "realtime_factor": _finite(self.realtime_factor),
            "messages_lost": self.messages_lost,
        }

    def sensors(self) -> list[TopicInfo]:
        """The topics that an estimator could use, in the order of the recording."""
        return [
            info
            for info in inspect(self.input, known_topics()).topics
            if info.count and not {"vsense", "reference"} & set(info.topic.strip("/").split("/"))
        ]

    def parameters(self) -> list[tuple[str, float, float, float]]:
        """Name, value and standard deviation of what the estimator found out about car and sensors, at the end, and the
        largest standard deviation of the drive, which that had before it was learnt [SI]."""
        channel = find_channel(self.output, "vsense/parameters")
        if channel is None:
            return []
        values, deviations = channel.columns["position"][-1], channel.columns["velocity"]
        numbers = values.tolist(), deviations[-1].tolist(), deviations.max(axis=0).tolist()
        return list(zip(channel.names, *numbers, strict=True))

    def facts(self) -> list[str]:
        """Duration, distance and speed range of the drive, in words."""
        facts = [f"{self.input.duration:.0f} s"]
        for recording, source in ((self.input, "reference"), (self.output, "vsense")):
            odometry = find_channel(recording, f"{source}/odometry")
            if odometry is None:
                continue
            speed = np.hypot(odometry.columns["linear"][:, 0], np.nan_to_num(odometry.columns["linear"][:, 1]))
            finite = np.isfinite(speed)
            if finite.sum() > 1:
                mean = (speed[finite][1:] + speed[finite][:-1]) / 2.0
                length = float(np.sum(mean * np.diff(odometry.stamp[finite]) * 1e-9))
                facts.append(f"{length / 1000.0:.2f} km" if length >= 1000.0 else f"{length:.0f} m")
                slow, fast = speed[finite].min() * 3.6, speed[finite].max() * 3.6
                facts.append(f"{slow:.0f}–{fast:.0f} km/h")
                break
        missing = self.without_estimate()
        if missing:
            facts.append(f"{missing:.1f} s without an estimate")
        return facts

    def without_estimate(self) -> float:
        """How long the output was interrupted, all its gaps together [s]."""
        odometry = find_channel(self.output, "vsense/odometry")
        if odometry is None:
            return 0.0
        return float(sum(end - begin for begin, end in gaps(np.sort(odometry.stamp)))) * 1e-9


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
