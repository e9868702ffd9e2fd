"""The exported C, the functional mock-up unit and the filter in Python on one recording: a test in the loop without
Simulink, of the model (Python), of the software (C) and of the unit that a simulation tool loads."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.export import c, check, fmu, fmu_check
from vsense_ros.export.same_calls import Driven, drive_together, moments, start_of
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.sensors import sensors_of

Array = NDArray[np.float64]
Progress = Callable[[float], None]

PYTHON, C, UNIT = "Python", "C", "FMU"


@dataclass(frozen=True)
class SideBySide:
    """Outputs of each of them, and the time that they took."""

    outputs: tuple[tuple[str, str], ...]  # name and unit of each of n
    values: dict[str, Array]  # outputs (moments, n), by who computed them
    seconds: dict[str, float]  # of a step with the corrections before it, mean
    steps: int

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Each with each."""
        return list(combinations(self.values, 2))

    def apart(self, pair: tuple[str, str]) -> tuple[Array, Array]:
        """RMS (n,) and largest (n,) difference of a pair, in units of the outputs; not a number where one of them is
        none."""
        difference = np.abs(self.values[pair[0]] - self.values[pair[1]])
        return np.sqrt(np.mean(difference**2, axis=0)), difference.max(axis=0)


class _Timed:
    """What is driven, with the time it takes [s] and its steps."""

    def __init__(self, driven: Driven) -> None:
        self._driven, self.inputs = driven, driven.inputs
        self.seconds, self.steps = 0.0, 0

    def correct(self, sensor: str, value: Array, variance: Array, limit: float) -> Any:
        begin = perf_counter()
        self._driven.correct(sensor, value, variance, limit)
        self.seconds += perf_counter() - begin

    def look(self) -> None:
        begin = perf_counter()
        self._driven.look()
        self.seconds += perf_counter() - begin

    def advance(self, h: float) -> None:
        begin = perf_counter()
        self._driven.advance(h)
        self.seconds += perf_counter() - begin
        self.steps += 1


def beginning(recording: Recording, seconds: float) -> Recording:
    """The first `seconds` [s] of a recording."""
    end = recording.first_stamp + round(seconds * 1e9)
    channels = {topic: channel.select(channel.stamp < end) for topic, channel in recording.channels.items()}
    return replace(recording, channels=channels)


def has_unit() -> bool:
    """True if FMPy, which runs the FMU, is installed."""
    return find_spec("fmpy") is not None


@dataclass(frozen=True)
class Built:
    """What was compiled: the exported C, and the unit where FMPy is installed."""

    library: ctypes.CDLL
    unit: Path | None


def build(vehicle: Vehicle, folder: Path, optimised: str = fmu.OPTIMISED) -> Built:
    """Write and compile the observer of a vehicle in `folder`. Raises `InputError` without a compiler."""
    c.write(vehicle, folder / "c")
    library = check.build(folder / "c", (optimised, "-std=c99"))
    if not has_unit():
        return Built(library, None)
    fmu.write(vehicle, folder / "observer.fmu", 3, optimised=optimised)
    return Built(library, folder / "observer.fmu")


def compare(vehicle: Vehicle, built: Built, recording: Recording, progress: Progress | None = None) -> SideBySide:
    """Make the same calls to all, in order of time. Raises `InputError` where the recording has none of the sensors."""
    sensors, drive = sensors_of(vehicle), moments(vehicle, recording)
    speed, yaw = start_of(vehicle, drive)
    names = tuple((entry.name.lower(), entry.unit) for entry in c.Contents(c.Observer.of(vehicle)).states())
    exported = check.Exported(vehicle, built.library)
    exported.start(speed, yaw)
    own = fmu_check.InPython(vehicle, sensors, speed, yaw)
    timed = {PYTHON: _Timed(own), C: _Timed(exported)}
    states: dict[str, list[Array]] = {name: [] for name in timed}
    together = drive_together(vehicle, sensors, drive, tuple(timed.values()), fmu_check.as_a_unit_gets)
    for i, _ in enumerate(together):
        states[PYTHON].append(own.filter.belief().mean[: len(names)].copy())
        states[C].append(exported.parts["state"].copy())
        if progress is not None and i % 50 == 0:
            progress(0.5 * i / len(drive))
    seconds = {name: one.seconds for name, one in timed.items()}
    if built.unit is not None:
        with closing(fmu_check.Running(built.unit, fmu.Unit(vehicle), 3, speed, yaw)) as running:
            states[UNIT], seconds[UNIT] = _timed(fmu_check.drive_unit(running, vehicle, drive))
    steps = timed[C].steps
    return SideBySide(
        names,
        {name: np.array(values).reshape(-1, len(names)) for name, values in states.items()},
        {name: total / max(1, steps) for name, total in seconds.items()},
        steps,
    )


def _timed(states: Iterator[Array]) -> tuple[list[Array], float]:
    """All states, and the time that they took [s]."""
    begin = perf_counter()
    return list(states), perf_counter() - begin
