"""The observer on a recording, without ROS: the same job as the node, as fast as the machine can."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import MakeFilter
from vsense_ros.observer.estimate import BALANCE, Estimate, estimate_samples, stacked
from vsense_ros.observer.observer import Observer


@dataclass(frozen=True)
class Run:
    """What the observer made of a recording."""

    output: Recording
    step_us_median: float  # computing time of one message that moved the filter [µs]
    realtime_factor: float  # length of the recording over computing time
    messages_lost: int
    diagnostics: list[Diagnostic]
    parameters: dict[str, tuple[float, float]]  # value and standard deviation at the end


def run(
    recording: Recording,
    vehicle: Vehicle,
    *,
    rate: float = 100.0,
    make: MakeFilter | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Feed all messages of a recording in order of arrival, and collect the estimates at `rate` [Hz] or less.

    `make` builds the filter, as for `Observer`. `progress` is called with the share done, 0 to 1. Raises `InputError`
    if the recording has none of the vehicle's sensors, or never tells how the car moves.
    """
    observer = Observer(vehicle, recording.map_origin, make)
    present = topics_in(recording, observer)
    total = sum(len(recording[t]) for t in present)
    interval = int(0.999e9 / rate)
    estimates: list[Estimate] = []
    times: list[float] = []
    last = 0
    began = time.perf_counter()
    for i, sample in enumerate(recording.samples(present)):
        before = time.perf_counter()
        observer.add(sample)
        times.append(time.perf_counter() - before)
        if observer.started and observer.stamp >= last + interval:
            estimates.append(observer.snapshot())
            last = observer.stamp
        if progress is not None and i % 500 == 0:
            progress(i / total)
    elapsed = time.perf_counter() - began
    if not estimates:
        text = "; ".join(f"{d.name}: {d.message}" for d in observer.diagnostics())
        raise InputError(f"{recording.name or 'recording'}: the observer never started ({text})")
    if progress is not None:
        progress(1.0)
    return Run(
        output=as_recording(estimates, recording.name, recording.metadata),
        step_us_median=float(np.median(times) * 1e6),
        realtime_factor=recording.duration / elapsed,
        messages_lost=recording.messages_lost,
        diagnostics=observer.diagnostics(),
        parameters=observer.parameters(),
    )


def topics_in(recording: Recording, observer: Observer) -> tuple[str, ...]:
    """Topics of the observer's sensors that a recording has messages of. Raises `InputError` if there are none."""
    topics = tuple(observer.topics)
    present = tuple(t for t in topics if t in recording and len(recording[t]))
    if not present:
        raise InputError(
            f"{recording.name or 'recording'}: none of the vehicle's sensors is in it; expected {', '.join(topics)}, "
            f"found {', '.join(sorted(recording.channels)) or 'nothing'}"
        )
    return present


def as_recording(estimates: Sequence[Estimate], name: str, metadata: Mapping[str, str]) -> Recording:
    """Estimates as the output channels of a recording; arrival times are the times they are valid for."""
    stamps = np.array([e.stamp for e in estimates])
    channels = {
        s.topic: Channel(s.topic, s.kind, stamps, stamps, s.values, s.frame_id, s.names, s.child_frame_id)
        for s in estimate_samples(stacked(estimates))
    }
    balance = channels[BALANCE]
    told = np.hstack([balance.columns["force"], balance.columns["torque"]])
    heard = np.asarray(np.isfinite(told).any(axis=1), dtype=bool)
    if not heard.any():
        del channels[BALANCE]
    elif not heard.all():
        channels[BALANCE] = balance.select(heard)
    return Recording(channels, name=name, metadata=dict(metadata))
