"""An exported filter beside the one in Python: the same calls to both on a recording, and how far they come apart."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Gaussian, Innovation, largest_nis
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.estimation.intake import Intake, by_topic
from vsense_ros.estimation.reading import Map
from vsense_ros.export.c import Observer
from vsense_ros.export.sources import identifier
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.sensors import sensors_of

Array = NDArray[np.float64]


def relative(values: Array, expected: Array, unit: Array | None = None) -> float:
    """Largest difference, relative to what was expected where that is above one; infinite where one is no number."""
    apart = np.abs(values - expected) / (np.maximum(1.0, np.abs(expected)) if unit is None else unit)
    return float(
        np.max(np.where(np.isnan(values) & np.isnan(expected), 0.0, np.nan_to_num(apart, nan=np.inf)), initial=0.0)
    )


@dataclass
class Difference:
    """How far the two came apart, and over how much."""

    state: float = 0.0  # largest |c - python| / max(1, |python|); forces, which are differences, by the largest of them
    covariance: float = 0.0  # largest, in units of both standard deviations
    innovation: float = 0.0  # of the normalized innovation squared, as for the state
    outputs: float | None = None  # of accelerations, forces and slips of the wheels, relative to the largest of a kind
    predictions: int = 0
    corrections: int = 0
    returns: int = 0  # of late measurements, for which both go back
    surveyed: int = 0  # looks at the road that the vehicle file knows
    placed: int = 0  # how often C was given Python's state: at start, and where the heading was first taken
    widened: int = 0  # how often it was given Python's covariance, where that takes a sensor to be less certain

    @property
    def largest(self) -> float:
        """The largest of all differences."""
        return max(self.state, self.covariance, self.innovation, self.outputs or 0.0)

    def corrected(self, theirs: float, innovation: Innovation) -> None:
        """Compare the normalized innovation squared that both found in one correction."""
        self.corrections += 1
        self.innovation = max(self.innovation, relative(np.array(theirs), np.array(innovation.nis)))

    def compare(self, theirs: Gaussian, ours: Gaussian, unit: Array | None = None) -> None:
        """Compare what both believe; `unit` (n,) are the sizes by which states are divided, by default `relative`'s."""
        self.state = max(self.state, relative(theirs.mean, ours.mean, unit))
        deviation = np.sqrt(np.maximum(np.diag(ours.covariance), 1e-300))
        apart = relative(theirs.covariance, ours.covariance, np.outer(deviation, deviation))
        self.covariance = max(self.covariance, apart)

    def in_words(self) -> list[str]:
        """Lines for the terminal."""
        outputs = "" if self.outputs is None else f", outputs {self.outputs:.1e}"
        looks = f", {self.surveyed} looks at a known road" if self.surveyed else ""
        widened = f"; the covariance {self.widened} times, where a sensor is doubted" if self.widened else ""
        return [
            f"Greatest difference {self.largest:.1e} (state {self.state:.1e}, covariance {self.covariance:.1e}, "
            f"innovations {self.innovation:.1e}{outputs})",
            f"after {self.predictions} predictions and {self.corrections} corrections in a row; "
            f"{self.returns} returns for late measurements{looks}; "
            f"the state was copied {self.placed} times, at the start{widened}.",
        ]


class ExportedFilter:
    """An exported filter, called from Python: `memory` (s,) is its struct, in double or single precision.

    `sensors` are the names of those that correct.
    """

    def __init__(self, library: ctypes.CDLL, memory: NDArray[Any], sensors: Sequence[str]) -> None:
        self.memory, self._library = memory, library
        self.number: Any = ctypes.c_float if memory.dtype == np.float32 else ctypes.c_double
        self._struct = ctypes.c_void_p(memory.ctypes.data)
        address, number = ctypes.c_void_p, self.number
        self._predict = self.function("predict", ctypes.c_int, [address, number])
        self._correct = {
            name: self.function(f"correct_{identifier(name)}", number, [address] * 3 + [number] * 2) for name in sensors
        }
        # Copying into these is quicker than asking an array for its address.
        self._value, self._variance = np.zeros((2, COMPONENTS), memory.dtype)
        self._measured = self._value.ctypes.data, self._variance.ctypes.data

    def function(self, name: str, result: Any, arguments: list[Any]) -> Any:
        """One function of the library, by its name behind `vsense_`."""
        function = self._library[f"vsense_{name}"]
        function.restype, function.argtypes = result, arguments
        return function

    def predict(self, h: float) -> bool:
        """Go on by `h` [s]; False where that was impossible."""
        return bool(self._predict(self._struct, h))

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        """Correct by a measurement (m,), and return its normalized innovation squared."""
        m = len(value)
        self._value[:m], self._variance[:m] = value, variance
        return float(self._correct[sensor](self._struct, *self._measured, limit, scale))


class Runner(Protocol):
    """What runs a filter on messages."""

    @property
    def topics(self) -> Any:
        """Names of the topics to which it listens."""

    @property
    def started(self) -> bool:
        """True once its filter has begun."""

    def add(self, sample: Sample) -> Any:
        """Take a message."""


def lead(
    runner: Runner,
    recording: Recording,
    every_hundredth: Callable[[], None],
    progress: Callable[[float], None] | None = None,
) -> None:
    """Give all messages of a recording to a runner; `every_hundredth` is called once in a hundred after its start."""
    topics = tuple(topic for topic in runner.topics if topic in recording)
    total = sum(len(recording[topic]) for topic in topics)
    for i, sample in enumerate(recording.samples(topics)):
        runner.add(sample)
        if i % 100 == 0:
            if runner.started:
                every_hundredth()
            if progress is not None:
                progress(i / total)


def require_start(runner: Runner, recording: Recording) -> None:
    """Raises `InputError` where a recording gave a filter nothing to begin with."""
    if not runner.started:
        raise InputError(f"{recording.name or 'recording'}: the filter never started, there is nothing to compare")


@dataclass(frozen=True)
class Moment:
    """What was measured at one time [s since the first], values by the name of the sensor."""

    time: float
    measured: dict[str, Array]


def moments(vehicle: Vehicle, recording: Recording) -> list[Moment]:
    """What the sensors of a vehicle measured, in order of time: as if nothing came late. The map begins where that of a
    road does that the vehicle file knows, else where that of the recording does."""
    sensors = sensors_of(vehicle)
    names, listening = list(sensors), by_topic(tuple(sensors.values()))
    origin = Observer.of(vehicle).map_origin or recording.map_origin
    intake = Intake(sensors, Map(origin), 1e9, lambda: True)
    events = []
    for sample in recording.samples(tuple(t for t in listening if t in recording)):
        for index in listening[sample.topic]:
            event = intake.read(index, sample)
            if event is not None:
                events.append((event.stamp, index, event.value.copy()))
    if not events:
        raise InputError(f"{recording.name or 'recording'} has none of the sensors of {vehicle.name}")
    events.sort(key=lambda e: e[:2])
    first = events[0][0]
    return [
        Moment((stamp - first) * 1e-9, {names[index]: value for _, index, value in together})
        for stamp, together in groupby(events, key=lambda e: e[0])
    ]


START_SPEED = 20.0  # [m/s], of a drive without any velocity on the map: between a city and a country road


def start_of(vehicle: Vehicle, drive: Sequence[Moment]) -> tuple[float, float]:
    """Speed [m/s] and heading [rad] at the start, from the first velocity on the map, else 20 m/s towards east."""
    kinds = {name: sensor.kind for name, sensor in sensors_of(vehicle).items()}
    for moment in drive:
        for name, value in moment.measured.items():
            if kinds[name] == "gnss_velocity" and np.all(np.isfinite(value[:2])):
                return float(np.hypot(*value[:2])), float(np.arctan2(value[1], value[0]))
    return START_SPEED, 0.0


class Driven(Protocol):
    """What is driven by measurements: an exported filter, or one in Python."""

    @property
    def inputs(self) -> NDArray[Any]:
        """Inputs (k,), to be written."""

    def correct(self, sensor: str, value: Array, variance: Array, limit: float) -> Any:
        """Correct by a measurement (m,)."""

    def look(self) -> None:
        """Look up the road, where the vehicle file knows it."""

    def advance(self, h: float) -> None:
        """Go on by `h` [s], and linearise."""


def drive_together(
    vehicle: Vehicle,
    sensors: dict[str, SensorBase],
    drive: Sequence[Moment],
    driven: Sequence[Driven],
    given: Callable[[SensorBase, Array], Array],
) -> Iterator[Moment]:
    """Make the same calls to all: inputs, corrections, steps; yields each moment when all stand before the next one.

    `given` says what of a sensor's measurement a correction gets.
    """
    for now, later in pairwise(drive):
        for name, value in now.measured.items():  # inputs first, as a unit gets all before it steps
            if (part := sensors[name].inputs) is not None:
                for one in driven:
                    one.inputs[part] = np.nan_to_num(value)
        for name, value in now.measured.items():
            sensor = sensors[name]
            if not sensor.is_input:
                variance = sensor.deviations() ** 2
                for one in driven:
                    one.correct(name, given(sensor, value), variance, largest_nis(sensor.gate, len(variance)))
        for one in driven:
            one.look()
        h = later.time - now.time
        count = max(1, int(np.ceil(h / vehicle.observer.longest_step - 1e-9)))
        for _ in range(count):
            for one in driven:
                one.advance(h / count)
        yield now
