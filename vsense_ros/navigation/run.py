"""A filter of this room on a recording, without ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.motion import Motions, Snapshot
from vsense_ros.navigation.navigator import Navigator


@dataclass(frozen=True)
class Run:
    """What a filter made of a recording."""

    output: Recording
    step_us_median: float  # computing time of one message that moved the filter [µs]
    realtime_factor: float  # length of the recording over computing time
    messages_lost: int
    diagnostics: list[Diagnostic]
    parameters: dict[str, tuple[float, float]]  # value and standard deviation at the end


def run(
    recording: Recording,
    vehicle: Vehicle,
    name: str,
    *,
    rate: float = 100.0,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Feed all messages of a recording in order of arrival, and collect the estimates at `rate` [Hz] or less.

    `progress` is called with the share done, 0 to 1. Raises `InputError` if the recording has none of the vehicle's
    sensors, or the filter never starts.
    """
    navigator = Navigator(vehicle, name, recording.map_origin)
    present = topics_in(recording, navigator.topics)
    total = sum(len(recording[t]) for t in present)
    interval, last = int(0.999e9 / rate), 0
    snapshots: list[Snapshot] = []
    times: list[float] = []
    began = time.perf_counter()
    for i, sample in enumerate(recording.samples(present)):
        before = time.perf_counter()
        navigator.add(sample)
        times.append(time.perf_counter() - before)
        if navigator.started and navigator.stamp >= last + interval:
            navigator.catch_up()
            snapshots.append(navigator.readout.snapshot(navigator.stamp))
            last = navigator.stamp
        if progress is not None and i % 500 == 0:
            progress(i / total)
    elapsed = time.perf_counter() - began
    if not snapshots:
        text = "; ".join(f"{d.name}: {d.message}" for d in navigator.diagnostics())
        raise InputError(f"{recording.name or 'recording'}: the filter {name} never started ({text})")
    if progress is not None:
        progress(1.0)
    return Run(
        output=as_recording(navigator.readout.motions(snapshots), recording),
        step_us_median=float(np.median(times) * 1e6),
        realtime_factor=recording.duration / elapsed,
        messages_lost=recording.messages_lost,
        diagnostics=navigator.diagnostics(),
        parameters=navigator.parameters(),
    )


def topics_in(recording: Recording, topics: Iterable[str]) -> tuple[str, ...]:
    """Those of which a recording has messages. Raises `InputError` if there are none."""
    present = tuple(t for t in topics if t in recording and len(recording[t]))
    if not present:
        raise InputError(
            f"{recording.name or 'recording'}: none of the vehicle's sensors is in it; expected "
            f"{', '.join(topics)}, found {', '.join(sorted(recording.channels)) or 'nothing'}"
        )
    return present


def as_recording(motions: Motions, of: Recording) -> Recording:
    """Estimates as the output channels of a recording; arrival times are the times they are valid for."""
    stamps = motions.stamp.astype(np.int64)
    channels = {
        s.topic: Channel(s.topic, s.kind, stamps, stamps, _rows(s.values), s.frame_id, s.names, s.child_frame_id)
        for s in motions.samples()
    }
    return Recording(channels, name=of.name, metadata=dict(of.metadata))


def _rows(values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns with one row for each time, also where there is only one."""
    return {name: value if value.ndim == 2 else value[None] for name, value in values.items()}
