"""Smoothing of a recorded drive: each estimate of a filter of one state space, given what was measured after it.

All messages are put in the order of their measurement first, so that nothing is late. `run_smoothed` smooths what a
filter estimated; `run_offline` fits a trajectory to all measurements, as a reference for filters that are live.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.iterated import iterated
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.smoother import FixedLag, smoothed
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.motion import Snapshot
from vsense_ros.navigation.offline import OFFLINE, UNITS
from vsense_ros.navigation.offline import Offline as OfflineSpace
from vsense_ros.navigation.reading_use import usable
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.run import Run, as_recording, never_started, topics_in
from vsense_ros.runner.runner import Runner

_DETERMINED = 0.9  # share of its prior deviation, below which a recording determines a parameter
_OUTPUT_PERIOD = 0.0099  # [s] at least, between two estimates


def run_smoothed(
    recording: Recording,
    vehicle: Vehicle,
    name: str,
    *,
    lag: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Run the filter `name`, each estimate given the whole recording (Rauch, Tung & Striebel 1965), or `lag` [s] of it
    after the estimate. Raises `InputError` as `run` does, and for a filter that is not one state space."""
    done = progress or (lambda share: None)
    runner = Runner(vehicle, recording.map_origin, every_filter()[name].make)
    ekf = single_ekf(runner)
    if ekf is None:
        raise InputError(
            f"{name}: only an extended Kalman filter of one state space can be smoothed; `vsense filters` lists a "
            "cascade's states with a dot"
        )
    began = time.perf_counter()
    step = vehicle.observer.longest_step
    record = Record(ekf) if lag is None else FixedLag(ekf, max(1, round(lag / step)))
    estimates: list[Snapshot] = []
    snapshots: list[Snapshot] = []
    messages = 0
    for count in follow(runner, record, recording, step, snapshots, lambda share: done(0.7 * share)):
        messages += 1
        if isinstance(record, FixedLag) and len(snapshots) >= len(record.instants) and count:
            when, belief = record.delayed()
            at = snapshots[0].stamp + round(when * 1e9)
            estimates.append(_as(snapshots[-len(record.instants)], belief, at))
    if not snapshots:
        raise never_started(recording, runner)
    if lag is None:
        beliefs = smoothed(record)
        estimates = [_as(s, b, s.stamp) for s, b in zip(snapshots, beliefs, strict=True)]
    done(1.0)
    elapsed = time.perf_counter() - began
    return Run(
        output=as_recording(runner.adapter, _thinned(estimates), recording),
        step_us_median=1e6 * elapsed / max(messages, 1),
        realtime_factor=recording.duration / elapsed,
        messages_lost=recording.messages_lost,
        diagnostics=runner.diagnostics(),
        parameters=runner.parameters(),
    )


@dataclass(frozen=True)
class Offline:
    """The motion of a car by all of a recording, on the topics of an estimate; the parameters of sensors and car that
    it determines, by name, value and standard deviation [`navigation.offline.UNITS`]; and by how many standard
    deviations the last iteration moved a state."""

    output: Recording
    parameters: dict[str, tuple[float, float]]
    change: float


def run_offline(recording: Recording, vehicle: Vehicle, *, progress: Callable[[float], None] | None = None) -> Offline:
    """Fit the motion of a car to all that its sensors measured (`navigation.offline`), by Gauss-Newton over the whole
    recording. Raises `InputError` as `run_smoothed` does."""
    done = progress or (lambda share: None)

    def make(vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Aided:
        used = usable(sensors)
        return Aided("offline", OFFLINE, car_numbers(vehicle, used.values()), used)

    runner = Runner(vehicle, recording.map_origin, make)
    ekf = single_ekf(runner)
    assert ekf is not None
    record, snapshots = Record(ekf), list[Snapshot]()
    for _ in follow(runner, record, recording, vehicle.observer.longest_step, snapshots, lambda s: done(0.3 * s)):
        pass
    if not snapshots:
        raise never_started(recording, runner)
    estimates = iterated(record, progress=lambda share: done(0.3 + 0.7 * share))
    smooth = [_as(s, b, s.stamp) for s, b in zip(snapshots, estimates.beliefs, strict=True)]
    done(1.0)
    output = as_recording(runner.adapter, _thinned(smooth), recording)
    parameters = {
        name: (value, deviation)
        for name, (value, deviation) in runner.adapter.parameters(smooth[-1]).items()
        if name in UNITS and deviation < _DETERMINED * OfflineSpace.prior[name]
    }
    return Offline(output, parameters, estimates.change)


def _thinned(snapshots: list[Snapshot]) -> list[Snapshot]:
    """Those that are at least `_OUTPUT_PERIOD` apart."""
    kept: list[Snapshot] = []
    for one in snapshots:
        if not kept or one.stamp - kept[-1].stamp >= _OUTPUT_PERIOD * 1e9:
            kept.append(one)
    return kept


def single_ekf(runner: Runner) -> Ekf | None:
    """The extended Kalman filter of one state space that a runner has; None for a cascade or another kind of filter."""
    single = getattr(runner.filter, "filter", None)
    return single if isinstance(single, Ekf) else None


def follow(
    runner: Runner,
    record: Record,
    recording: Recording,
    step: float,
    snapshots: list[Snapshot],
    progress: Callable[[float], None],
) -> Iterator[int]:
    """Take a runner along a recording, its messages in the order of their measurement, and record what its filter does.

    Steps are `step` [s] at most; each adds to `snapshots`. Yields after each reading how many steps led to it.
    """
    aided, adapter = runner.filter, runner.adapter
    assert isinstance(aided, Aided)
    aided.filter = record
    events = runner.readings(recording.samples(topics_in(recording, runner.topics)))
    at_start = 0
    for i, event in enumerate(events):
        if i % 500 == 0:
            progress(i / len(events))
        if not runner.started:
            runner.gather(event)
            if runner.started:
                at_start = runner.stamp
                snapshots.append(adapter.snapshot(at_start))
            continue
        elapsed = (event.stamp - at_start) * 1e-9 - record.instants[-1].time
        for _ in range(count := int(np.ceil(max(elapsed, 0.0) / step - 1e-6))):
            aided.predict(elapsed / count)
            snapshots.append(adapter.snapshot(at_start + round(record.instants[-1].time * 1e9)))
        runner.act(event)
        yield count


def _as(snapshot: Snapshot, belief: Gaussian, stamp: int) -> Snapshot:
    """A snapshot of one part with another belief."""
    return Snapshot(stamp, ((belief.mean, belief.covariance, *snapshot.parts[0][2:]),))
