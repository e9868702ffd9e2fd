"""The past of a recorded drive in the light of all that followed: a filter of this room, smoothed.

Of filters of one state space. All messages are put in the order of their measurement first, so that nothing is late.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.smoother import FixedLag, smoothed
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.motion import Snapshot
from vsense_ros.navigation.navigator import Navigator
from vsense_ros.navigation.run import Run, as_recording, topics_in

_OUTPUT_PERIOD = 0.0099  # [s] at least, between two estimates


def run_smoothed(
    recording: Recording,
    vehicle: Vehicle,
    name: str,
    *,
    lag: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """As `run`, each estimate in the light of the whole recording (Rauch, Tung & Striebel 1965), or of `lag` [s] after
    it. Raises `InputError` as `run` does, and for a filter of several state spaces."""
    done = progress or (lambda share: None)
    navigator = Navigator(vehicle, name, recording.map_origin)
    ekf = navigator.filter.filter
    if not isinstance(ekf, Ekf):
        raise InputError(
            f"{name}: only an extended Kalman filter of one state space can be smoothed; `vsense filters` lists a "
            "cascade's states with a dot"
        )
    began = time.perf_counter()
    step = vehicle.observer.longest_step
    record = Record(ekf) if lag is None else FixedLag(ekf, max(1, round(lag / step)))
    navigator.filter.filter = record
    found: list[Snapshot] = []
    snapshots: list[Snapshot] = []
    messages = 0
    for count in follow(navigator, record, recording, step, snapshots, lambda share: done(0.7 * share)):
        messages += 1
        if isinstance(record, FixedLag) and len(snapshots) >= len(record.instants) and count:
            when, belief = record.delayed()
            at = snapshots[0].stamp + round(when * 1e9)
            found.append(_as(snapshots[-len(record.instants)], belief, at))
    if not snapshots:
        text = "; ".join(f"{d.name}: {d.message}" for d in navigator.diagnostics())
        raise InputError(f"{recording.name or 'recording'}: the filter {name} never started ({text})")
    if lag is None:
        beliefs = smoothed(record)
        found = [_as(s, b, s.stamp) for s, b in zip(snapshots, beliefs, strict=True)]
    kept, last = [], -1e18
    for one in found:
        if one.stamp - last >= _OUTPUT_PERIOD * 1e9:
            kept.append(one)
            last = one.stamp
    done(1.0)
    elapsed = time.perf_counter() - began
    return Run(
        output=as_recording(navigator.readout.motions(kept), recording),
        step_us_median=1e6 * elapsed / max(messages, 1),
        realtime_factor=recording.duration / elapsed,
        messages_lost=recording.messages_lost,
        diagnostics=navigator.diagnostics(),
        parameters=navigator.parameters(),
    )


def follow(
    navigator: Navigator,
    record: Record,
    recording: Recording,
    step: float,
    snapshots: list[Snapshot],
    progress: Callable[[float], None],
) -> Iterator[int]:
    """Take a navigator whose filter is `record` along a recording, its messages in the order of their measurement.

    Steps are `step` [s] at most; each adds to `snapshots`. Yields after each reading how many steps led to it.
    """
    events = navigator.events(recording.samples(topics_in(recording, navigator.topics)))
    at_start = 0
    for i, event in enumerate(events):
        if i % 500 == 0:
            progress(i / len(events))
        if not navigator.started:
            navigator.begin_with(event)
            if navigator.started:
                at_start = navigator.stamp
                snapshots.append(navigator.readout.snapshot(at_start))
            continue
        elapsed = (event.stamp - at_start) * 1e-9 - record.instants[-1].time
        for _ in range(count := int(np.ceil(max(elapsed, 0.0) / step - 1e-6))):
            navigator.filter.predict(elapsed / count)
            snapshots.append(navigator.readout.snapshot(at_start + round(record.instants[-1].time * 1e9)))
        navigator.correct(event)
        yield count


def _as(snapshot: Snapshot, belief: Gaussian, stamp: int) -> Snapshot:
    """A snapshot of one part with another belief."""
    return Snapshot(stamp, ((belief.mean, belief.covariance, snapshot.parts[0][2]),))
