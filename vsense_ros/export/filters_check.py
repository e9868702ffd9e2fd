"""An exported GNSS/INS filter beside the one in Python: the same calls to both, on a recording."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Gaussian, Innovation
from vsense_ros.export import filters
from vsense_ros.export.check import FLAGS, build
from vsense_ros.export.same_calls import Difference, ExportedFilter, lead, relative, require_start
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.heading_bank import HeadingBank
from vsense_ros.navigation.reading_use import usable
from vsense_ros.navigation.space import filters_of, parameters_of
from vsense_ros.runner import Runner

Array = NDArray[np.float64]

_COMPARED = 10  # corrections, after which all of the state is compared; what they found is at each


class Exported(ExportedFilter):
    """The exported filter, called from Python. `memory` (s,) is its struct, in double or single precision."""

    def __init__(self, library: ctypes.CDLL, memory: NDArray[Any], sensors: Sequence[str]) -> None:
        super().__init__(library, memory, sensors)
        self._start = self.function("start", None, [ctypes.c_void_p])

    def start(self) -> None:
        """Begin as before any measurement."""
        self._start(self._struct)


class _Twin(Aided):
    """A filter whose every call is made to the exported one as well, and the results compared.

    The struct of the exported one is at the end of the memory, so that both go back together for a late
    measurement. Python writes into it at the start, and where trust was lost: all but the numbers of the car. In single
    precision it takes half of that memory, and is compared by a copy in double precision.
    """

    def __init__(
        self,
        name: str,
        library: ctypes.CDLL,
        difference: Difference,
        single: bool,
        vehicle: Vehicle,
        sensors: dict[str, SensorBase],
    ) -> None:
        sensors = usable(sensors)
        definition, numbers = DEFINITIONS[name][1], car_numbers(vehicle, sensors.values())
        made: Any = definition.make(numbers)
        size = len(made.memory)
        super().__init__(name, definition, numbers, sensors, behind=size)
        self.reckoning = None  # of axes that are left out, which is not in the sources
        self._ours, self.difference = self.memory[:size], difference
        self._theirs: NDArray[Any] = self.behind.view(np.float32)[:size] if single else self.behind
        self._copied = np.zeros(size) if single else self.behind
        self._there = made.at(self._copied)  # the struct, as Python reads it
        self.other = Exported(library, self._theirs, [key for key in sensors if self.uses(key)])
        self.other.start()
        parts = self._there.bank if isinstance(self._there, HeadingBank) else filters_of(self._there)
        self._numbers = [parameters_of(part) for part in parts]

    def start(self, belief: Gaussian) -> None:
        super().start(belief)
        self._copy()

    def _copy(self) -> None:
        self._copied[:] = self._theirs
        numbers = [own.copy() for own in self._numbers]
        self._copied[:] = self._ours
        for own, kept in zip(self._numbers, numbers, strict=True):
            own[:] = kept
        self._theirs[:] = self._copied
        self.difference.placed += 1

    def predict(self, h: float) -> None:
        super().predict(h)
        self.other.predict(h)
        self.difference.predictions += 1

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        innovation = super().correct(sensor, value, variance, limit, scale)
        if self.uses(sensor):
            self.difference.corrected(self.other.correct(sensor, value, variance, limit, scale), innovation)
            if self.difference.corrections % _COMPARED == 0:
                self.compare()
        return innovation

    def inflate(self) -> None:
        super().inflate()
        self._copy()

    def compare(self) -> None:
        """Compare state, covariance and inputs of both."""
        self._copied[:] = self._theirs
        self.difference.compare(self._there.belief(), self.filter.belief())
        self.difference.state = max(self.difference.state, relative(self._there.inputs, self.inputs))


def compare(
    vehicle: Vehicle,
    name: str,
    folder: Path,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
    *,
    single: bool = False,
) -> Difference:
    """Compile the sources that `filters.write` made, with the same `single`, and run the filter on a recording with
    the exported one beside it, which gets the same calls and nothing else.

    Raises `InputError` without a compiler, and where it never starts.
    """
    name = FILTERS[name].name
    library, difference = build(folder, FLAGS, filters.sources(name, folder)), Difference()
    runner = Runner(vehicle, recording.map_origin, partial(_Twin, name, library, difference, single))
    lead(runner, recording, lambda: None, progress)
    runner.snapshot()
    require_start(runner, recording)
    assert isinstance(runner.filter, _Twin)
    runner.filter.compare()
    difference.returns = sum(health.late for health in runner.health)
    return difference
