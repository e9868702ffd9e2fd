"""An exported GNSS/INS filter beside the one in Python: the same calls to both, on a recording."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Filter, Gaussian, Innovation, Kept
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.export import filters
from vsense_ros.export.c import identifier
from vsense_ros.export.check import FLAGS, Difference, build, relative
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.heading_bank import HeadingBank
from vsense_ros.navigation.navigator import Navigator
from vsense_ros.navigation.space import filters_of, parameters_of

Array = NDArray[np.float64]

_COMPARED = 10  # corrections, after which all of the state is compared; what they found is at each


class Exported:
    """The exported filter, called from Python. `memory` (s,) is its struct."""

    def __init__(self, library: ctypes.CDLL, memory: Array, sensors: dict[str, int]) -> None:
        """`sensors`: those that it knows, by name, with their numbers of components."""
        self._struct = memory.ctypes.data_as(ctypes.c_void_p)
        number, address = ctypes.c_double, ctypes.c_void_p
        self._start = library.vsense_start
        self._start.restype, self._start.argtypes = None, [address]
        self._predict = library.vsense_predict
        self._predict.restype, self._predict.argtypes = ctypes.c_int, [address, number]
        self._correct: dict[str, Any] = {}
        self._give: dict[str, Any] = {}
        for name in sensors:
            self._correct[name] = library[f"vsense_correct_{identifier(name)}"]
            self._correct[name].restype, self._correct[name].argtypes = number, [*[address] * 3, number, number]
            self._give[name] = library[f"vsense_give_{identifier(name)}"]
            self._give[name].restype, self._give[name].argtypes = None, [address] * 2
        self._value, self._variance = np.zeros(COMPONENTS), np.zeros(COMPONENTS)

    def start(self) -> None:
        self._start(self._struct)

    def predict(self, h: float) -> bool:
        return bool(self._predict(self._struct, h))

    def give(self, sensor: str, value: Array) -> None:
        self._value[: len(value)] = value
        self._give[sensor](self._struct, self._value.ctypes.data)

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        self._value[: len(value)], self._variance[: len(value)] = value, variance
        call = self._correct[sensor]
        return float(call(self._struct, self._value.ctypes.data, self._variance.ctypes.data, limit, scale))


class _Twin(Aided):
    """A filter whose every call is made to the exported one as well, and the results compared.

    The struct of the exported one is the second half of the memory, so that both go back together for a late
    measurement. Python writes into it at the start, and where trust was lost: all but the numbers of the car.
    """

    def __init__(
        self,
        name: str,
        library: ctypes.CDLL,
        difference: Difference,
        vehicle: Vehicle,
        sensors: dict[str, SensorBase],
    ) -> None:
        definition, numbers = DEFINITIONS[name][1], car_numbers(vehicle, sensors.values())
        made: Any = definition.make(numbers)
        size = len(made.memory)
        memory = np.zeros(2 * size)
        super().__init__(name, definition, numbers, sensors, made.at(memory[:size]))
        self.memory, self._ours, self._theirs, self.difference = memory, memory[:size], memory[size:], difference
        self._there = made.at(memory[size:])  # the struct, as Python reads it
        used = {key: len(one.deviations()) for key, one in sensors.items() if self.uses(key)}
        self.other = Exported(library, self._theirs, used)
        self.other.start()
        parts = self._there.bank if isinstance(self._there, HeadingBank) else filters_of(self._there)
        self._numbers = [parameters_of(part) for part in parts]

    def backup(self) -> Kept:
        return Filter.backup(self)  # of both

    def start(self, belief: Gaussian) -> None:
        super().start(belief)
        self._copy()

    def _copy(self) -> None:
        numbers = [own.copy() for own in self._numbers]
        self._theirs[:] = self._ours
        for own, kept in zip(self._numbers, numbers, strict=True):
            own[:] = kept
        self.difference.placed += 1

    def predict(self, h: float) -> None:
        super().predict(h)
        self.other.predict(h)
        self.difference.predictions += 1

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        found = super().correct(sensor, value, variance, limit, scale)
        if self.uses(sensor):
            theirs = self.other.correct(sensor, value, variance, limit, scale)
            self.difference.corrections += 1
            apart = relative(np.array(theirs), np.array(found.nis))
            self.difference.innovation = max(self.difference.innovation, apart)
            if self.difference.corrections % _COMPARED == 0:
                self.compare()
        return found

    def inflate(self) -> None:
        super().inflate()
        self._copy()

    def compare(self) -> None:
        """State, covariance and inputs of both."""
        difference, ours, theirs = self.difference, self.filter.belief(), self._there.belief()
        deviation = np.sqrt(np.maximum(np.diag(ours.covariance), 1e-300))
        apart = max(relative(theirs.mean, ours.mean), relative(self._there.inputs, self.inputs))
        difference.state = max(difference.state, apart)
        apart = relative(theirs.covariance, ours.covariance, np.outer(deviation, deviation))
        difference.covariance = max(difference.covariance, apart)


def compare(
    vehicle: Vehicle,
    name: str,
    folder: Path,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
) -> Difference:
    """Compile the sources that `filters.write` made, and run the filter on a recording with the exported one beside it,
    which gets the same calls and nothing else. Raises `InputError` without a compiler, and where it never starts."""
    name = FILTERS[name].name
    library, difference = build(folder, FLAGS, filters.sources(name, folder)), Difference()
    navigator = Navigator(vehicle, name, recording.map_origin, partial(_Twin, name, library, difference))
    topics = tuple(topic for topic in navigator.topics if topic in recording)
    total = sum(len(recording[topic]) for topic in topics)
    for i, sample in enumerate(recording.samples(topics)):
        navigator.add(sample)
        if progress is not None and i % 100 == 0:
            progress(i / total)
    navigator.catch_up()
    if not navigator.started:
        raise InputError(f"{recording.name or 'recording'}: the filter never started, there is nothing to compare")
    assert isinstance(navigator.filter, _Twin)
    navigator.filter.compare()
    difference.returns = sum(health.late for health in navigator.health)
    return difference
