"""What a drive has determined of a filter's states, when, and in which kind of motion.

A state counts as determined once its standard deviation is half of that at start. Which motion determined it is where
the logarithm of the deviation fell. Combinations of which nothing was determined are those of the observability Gramian
(`estimation.observability`), where the filter is one state space.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from vsense_ros.errors import InputError
from vsense_ros.estimation.observability import Direction, observability
from vsense_ros.estimation.record import Record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import STRAIGHT
from vsense_ros.navigation.motion import Snapshot
from vsense_ros.navigation.space import MOTION
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.kinematic import KinematicAdapter
from vsense_ros.runner.run import never_started, topics_in
from vsense_ros.runner.runner import Runner
from vsense_ros.runner.smoothing import follow, single_ekf

Array = NDArray[np.float64]

PERIOD = 0.1  # [s] between two deviations that are kept
HALF = 0.5  # of the deviation at start, from which on a state counts as determined
MOTIONS = ("standing", "going straight", "accelerating or braking", "turning")
_SMOOTH = 11  # deviations over which an acceleration is averaged
_SLOWEST, _PUSH = 0.5, 0.5  # [m/s] above which a car moves, [m/s²] above which it gains or loses speed


@dataclass(frozen=True)
class State:
    """One element of a filter's error [SI]: standard deviations at start and end; when it was determined [s], None if
    it was not; and the motion in which most was."""

    name: str
    before: float
    after: float
    determined_at: float | None
    motion: str

    @property
    def left(self) -> float:
        """Deviation at the end over that at start."""
        return self.after / self.before if self.before > 0 else 1.0


@dataclass(frozen=True)
class Determined:
    """What one drive has determined of a filter's states.

    `t` (n,) [s] from the start, `deviations` (n, e), `motion` (n,) places in `MOTIONS`.
    `undetermined` are combinations of which little was determined, weakest first; None where the filter is a cascade.
    """

    states: tuple[State, ...]
    t: Array
    deviations: Array
    motion: NDArray[np.int64]
    undetermined: tuple[Direction, ...] | None


def determined_by(
    recording: Recording, vehicle: Vehicle, name: str, progress: Callable[[float], None] = lambda share: None
) -> Determined:
    """Raises `InputError` if the recording has none of the vehicle's sensors, or the filter never starts."""
    runner = Runner(vehicle, recording.map_origin, every_filter()[name].make)
    adapter = runner.adapter
    if not isinstance(adapter, KinematicAdapter):
        raise InputError(f"the filter {name} is none of GNSS and inertial sensors, of which this is computed")
    single = single_ekf(runner)
    directions = None
    if single is not None:
        record = Record(single)
        snapshots: list[Snapshot] = []
        for _ in follow(runner, record, recording, vehicle.observer.longest_step, snapshots, progress):
            pass
        if snapshots:
            directions = observability(record).undetermined
            snapshots = _thinned(snapshots)
    else:
        snapshots = _run(runner, recording, progress)
    if not snapshots:
        raise never_started(recording, runner)
    progress(1.0)
    t = np.array([one.stamp - snapshots[0].stamp for one in snapshots]) * 1e-9
    variances = [np.concatenate([part[1].diagonal() for part in one.parts]) for one in snapshots]
    deviations = np.sqrt(np.array(variances).clip(min=0))
    if directions is None:  # by the first message of a cascade, much has been determined already
        deviations[0] = adapter.filter.definition.deviations
    motion = _motion(adapter, snapshots, t)
    states = tuple(_state(name, t, deviations[:, i], motion) for i, name in enumerate(adapter.filter.definition.errors))
    return Determined(states, t, deviations, motion, directions)


def _run(runner: Runner, recording: Recording, progress: Callable[[float], None]) -> list[Snapshot]:
    """A filter of several parts, message by message."""
    topics = topics_in(recording, runner.topics)
    total = sum(len(recording[topic]) for topic in topics)
    snapshots: list[Snapshot] = []
    for i, sample in enumerate(recording.samples(topics)):
        runner.add(sample)
        if runner.started and (not snapshots or runner.stamp >= snapshots[-1].stamp + PERIOD * 1e9):
            snapshots.append(runner.snapshot())
        if i % 500 == 0:
            progress(i / total)
    return snapshots


def _thinned(snapshots: list[Snapshot]) -> list[Snapshot]:
    kept = [snapshots[0]]
    for one in snapshots[1:]:
        if one.stamp >= kept[-1].stamp + PERIOD * 1e9:
            kept.append(one)
    return kept


def _motion(adapter: KinematicAdapter, snapshots: list[Snapshot], t: Array) -> NDArray[np.int64]:
    """Places in `MOTIONS` (n,), by what the filter estimates; where it estimates no speed, it counts as moving."""
    motions = adapter.readout.motions(snapshots)
    motion = np.full(len(t), 1)

    def of(name: str) -> Array | None:
        return motions.value[:, MOTION.index(name)] if name in motions.estimated else None

    speed, rate = of("forward_velocity"), of("yaw_rate")
    if rate is None and (yaw := of("yaw")) is not None and len(t) > 1:
        rate = np.gradient(np.unwrap(yaw), t)
    if speed is not None and len(t) > 1:
        motion[np.abs(uniform_filter1d(np.gradient(speed, t), _SMOOTH)) > _PUSH] = 2
    if rate is not None:
        motion[np.abs(rate) > STRAIGHT] = 3
    if speed is not None:
        motion[np.abs(speed) < _SLOWEST] = 0
    return motion


def _state(name: str, t: Array, deviation: Array, motion: NDArray[np.int64]) -> State:
    first = float(deviation[0])
    below = np.flatnonzero(deviation <= HALF * first) if first > 0 else np.zeros(0, dtype=np.int64)
    fall = -np.diff(np.log(np.maximum(deviation, 1e-300)))
    by_motion = [float(np.sum(fall[(motion[1:] == i) & (fall > 0)])) for i in range(len(MOTIONS))]
    most = MOTIONS[int(np.argmax(by_motion))] if len(below) and max(by_motion) > 0 else ""
    return State(name, first, float(deviation[-1]), float(t[below[0]]) if len(below) else None, most)
