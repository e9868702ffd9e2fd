"""A filter on a recording, without ROS: the same job as the node, as fast as the machine can."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.growing import Growing
from vsense_ros.messages.recording import Channel, Recording, Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.estimate import BALANCE
from vsense_ros.runner.adapter import Adapter, MakeFilter
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.playing import play
from vsense_ros.runner.runner import Runner

BLOCK = 256  # states that are made into columns at once, in some ten megabytes: of 64 each would take twice the time


@dataclass(frozen=True)
class Run:
    """What a filter made of a recording."""

    output: Recording
    step_us_median: float  # computing time of one message [µs], of the newest 100,000
    realtime_factor: float  # length of the recording over computing time
    messages_lost: int
    diagnostics: list[Diagnostic]
    parameters: dict[str, tuple[float, float]]  # value and standard deviation at the end
    failure: str = ""  # when and why the filter was given up for the first time, and how often that was


def run(
    recording: Recording,
    vehicle: Vehicle,
    name: str = "",
    *,
    rate: float = 100.0,
    make: MakeFilter | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Feed all messages of a recording in order of arrival, and collect the estimates at `rate` [Hz] or less.

    The filter is the one with this `name` in the catalogue, unless `make` builds another, as for `Runner`. `progress`
    is called with the share done, 0 to 1. Raises `InputError` if the recording has none of the vehicle's sensors, or
    the filter never starts.
    """
    silent = silent_wheels(vehicle, recording)
    known = {key: sensor for key, sensor in vehicle.sensors.items() if key not in silent}
    heard = vehicle.model_copy(update={"sensors": known})
    runner = Runner(heard, recording.map_origin, make or (every_filter()[name].make if name else None))
    present = topics_in(recording, runner.topics)
    total = sum(len(recording[t]) for t in present)
    interval = int(0.999e9 / rate)
    collected = Collected(runner.adapter)
    times: deque[float] = deque(maxlen=100_000)
    last = 0
    before = began = time.perf_counter()
    for i, _ in enumerate(play(runner, recording, present)):
        times.append(time.perf_counter() - before)
        if runner.started and runner.stamp >= last + interval:
            last, newest = runner.stamp, runner.incomplete_snapshot()
            if runner.started:
                collected.add(newest)
        if progress is not None and i % 500 == 0:
            progress(i / total)
        before = time.perf_counter()
    elapsed = time.perf_counter() - began
    if not collected.count:
        raise never_started(recording, runner)
    if progress is not None:
        progress(1.0)
    return Run(
        output=collected.recording(recording),
        step_us_median=float(np.median(times) * 1e6),
        realtime_factor=recording.duration / elapsed,
        messages_lost=recording.messages_lost,
        diagnostics=[*runner.diagnostics(), *silent.values()],
        parameters=runner.parameters(),
        failure=_failure(runner, recording, collected.first_stamp),
    )


def silent_wheels(vehicle: Vehicle, recording: Recording) -> dict[str, Diagnostic]:
    """Sensors of wheels that a vehicle file lists and a recording has no message of, by name, with their diagnostics;
    none where nothing else in the recording measures the speed.

    A filter that waits for them takes torques, radii and the car's longitudinal force to be measured.
    """

    def has(sensor: SensorBase) -> bool:
        return sensor.topic in recording and len(recording[sensor.topic]) > 0

    if not any(has(sensor) and "ground speed" in sensor.measures for sensor in vehicle.sensors.values()):
        return {}
    return {
        name: Diagnostic(name, Level.STALE, f"no message on {sensor.topic}")
        for name, sensor in vehicle.sensors.items()
        if sensor.measures & {"rolling speed", "torques"} and not has(sensor)
    }


def _failure(runner: Runner, recording: Recording, first: int) -> str:
    """A sentence about the times when the guard gave the filter up; empty for none. `first` is when it started [ns]."""
    failures = runner.guard.failures
    if not failures:
        return ""
    stamp, why = failures[0]
    more = f", and {len(failures) - 1} times more after it had started anew" if len(failures) > 1 else ""
    unheard = [line.name for line in runner.diagnostics() if line.level == Level.STALE and line.name in runner.names]
    hint = f"; nothing was heard of {', '.join(unheard)}, without which the model may not fit" if unheard else ""
    return (
        f"{recording.name or 'recording'}: the filter diverged {(stamp - first) * 1e-9:.1f} s "
        f"after its start{more}: {why}{hint}"
    )


def never_started(recording: Recording, runner: Runner) -> InputError:
    """The error for a recording on which a filter never started, with what it waits for."""
    text = "; ".join(f"{line.name}: {line.message}" for line in runner.diagnostics())
    return InputError(f"{recording.name or 'recording'}: the filter {runner.adapter.name} never started ({text})")


def topics_in(recording: Recording, topics: Iterable[str]) -> tuple[str, ...]:
    """Those topics of which a recording has messages. Raises `InputError` if there are none."""
    topics = tuple(topics)
    present = tuple(t for t in topics if t in recording and len(recording[t]))
    if not present:
        raise InputError(
            f"{recording.name or 'recording'}: none of the vehicle's sensors is in it; expected {', '.join(topics)}, "
            f"found {', '.join(sorted(recording.channels)) or 'nothing'}"
        )
    return present


class Collected:
    """States of a filter that become output channels, in blocks: an array operation on many costs little more than on
    one, and what a state holds beyond its outputs need not be kept. Arrival times are the times they are valid for."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._block: list[Any] = []
        self._first: list[Sample] = []  # the outputs, without values
        self._columns: list[dict[str, Growing]] = []  # of each
        self._stamps = array("q")

    def add(self, snapshot: Any) -> None:
        """Take the newest state."""
        self._stamps.append(snapshot.stamp)
        self._block.append(snapshot)
        if len(self._block) == BLOCK:
            self._end_block()

    @property
    def count(self) -> int:
        """How many states were taken."""
        return len(self._stamps)

    @property
    def first_stamp(self) -> int:
        """Time of the first state [ns]."""
        return self._stamps[0]

    def recording(self, recording: Recording) -> Recording:
        """The output channels, with name and metadata of the recording that they are made from."""
        if self._block:
            self._end_block()
        stamps = np.array(self._stamps, dtype=np.int64)
        channels = {}
        for s, columns in zip(self._first, self._columns, strict=True):
            values = {field: column.column() for field, column in columns.items()}
            channels[s.topic] = Channel(s.topic, s.kind, stamps, stamps, values, s.frame_id, s.names, s.child_frame_id)
        if BALANCE in channels:
            balance = channels[BALANCE]
            compared = np.hstack([balance.columns["force"], balance.columns["torque"]])
            known = np.asarray(np.isfinite(compared).any(axis=1), dtype=bool)
            if not known.any():
                del channels[BALANCE]
            elif not known.all():
                channels[BALANCE] = balance.select(known)
        return Recording(channels, name=recording.name, metadata=dict(recording.metadata))

    def _end_block(self) -> None:
        samples = self._adapter.columns(self._block)
        if not self._first:
            self._first = [replace(sample, values={}) for sample in samples]
            self._columns = [{field: Growing() for field in sample.values} for sample in samples]
        for sample, columns in zip(samples, self._columns, strict=True):
            for field, column in columns.items():
                column.add(sample.values[field])
        self._block = []


def as_recording(adapter: Adapter, snapshots: Iterable[Any], recording: Recording) -> Recording:
    """States of a filter as the output channels of a recording."""
    collected = Collected(adapter)
    for snapshot in snapshots:
        collected.add(snapshot)
    return collected.recording(recording)
