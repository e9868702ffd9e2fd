"""The exported observer beside the one in Python: the same calls to both, on a recording."""

from __future__ import annotations

import ctypes
import platform
import re
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Gaussian, Innovation
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.export import c
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import Observer
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.spi import FILTERS, Spi, numbers_kept
from vsense_ros.observer.state import FORCE, Prior, layout

Array = NDArray[np.float64]

FLAGS = ("-O3", "-std=c99", "-Wall", "-Wextra", "-pedantic")


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

    @property
    def largest(self) -> float:
        """Of all of them."""
        return max(self.state, self.covariance, self.innovation, self.outputs or 0.0)

    def in_words(self) -> list[str]:
        """For the terminal."""
        outputs = "" if self.outputs is None else f", outputs {self.outputs:.1e}"
        looks = f", {self.surveyed} looks at a known road" if self.surveyed else ""
        return [
            f"Greatest difference {self.largest:.1e} (state {self.state:.1e}, covariance {self.covariance:.1e}, "
            f"innovations {self.innovation:.1e}{outputs})",
            f"after {self.predictions} predictions and {self.corrections} corrections in a row; "
            f"{self.returns} returns for late measurements{looks}; "
            f"the state was copied {self.placed} times, at the start.",
        ]


def build(folder: Path, flags: tuple[str, ...] = FLAGS, sources: Sequence[Path] = ()) -> ctypes.CDLL:
    """The `sources` in `folder`, by default vsense.c, as a library. Raises `InputError` where there is no compiler, or
    where it complains."""
    compiler = codegen.compiler()
    if compiler is None:
        raise InputError("no C compiler here (cc, gcc or clang; CC names another), which a check needs")
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "vsense.so"
        files = [str(file) for file in sources or (folder / "vsense.c",)]
        command = [compiler, *flags, "-fPIC", "-shared", *files, "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode or done.stderr:
            raise InputError(f"{' '.join(command)}:\n{done.stderr}")
        return ctypes.CDLL(str(target))


class Exported:
    """The exported observer, called from Python. `memory` is its struct, if it has a place already."""

    def __init__(self, vehicle: Vehicle, library: ctypes.CDLL, memory: Array | None = None) -> None:
        exported = c.Observer.of(vehicle)
        fields = exported.fields()
        self.memory = np.zeros(sum(fields.values())) if memory is None else memory
        ends = np.cumsum(list(fields.values())).tolist()
        self.parts = dict(zip(fields, np.split(self.memory, ends[:-1]), strict=True))
        self._library, self._struct = library, self.memory.ctypes.data_as(ctypes.c_void_p)
        number, address = ctypes.c_double, ctypes.c_void_p
        self._initialize = self._function("init", None, [address, number])
        self._place = self._function("place", None, [address, ctypes.c_int, number, number])
        self._linearize = self._function("linearize", None, [address])
        self._predict = self._function("predict", ctypes.c_int, [address, number])
        self._present = self._function("present", None, [address] * 3)
        self._survey = self._function("survey", ctypes.c_int, [address]) if exported.map_origin is not None else None
        self._correct = {
            name: self._function(f"correct_{c.identifier(name)}", number, [address] * 3 + [number] * 2)
            for name in exported.correcting
        }
        # Copying into these is quicker than asking an array for its address.
        self._value, self._variance = np.zeros(COMPONENTS), np.zeros(COMPONENTS)
        self._measured = self._value.ctypes.data, self._variance.ctypes.data
        self.start(0.0)

    def _function(self, name: str, result: Any, arguments: list[Any]) -> Any:
        function = self._library[f"vsense_{name}"]
        function.restype, function.argtypes = result, arguments
        return function

    @property
    def covariance(self) -> Array:
        """(n, n)."""
        size = len(self.parts["state"])
        return self.parts["covariance"].reshape(size, size)

    def belief(self) -> tuple[Array, Array]:
        """State and parameters, and the covariance of their errors, as `Filter.belief`."""
        state = self.parts["state"]
        if "estimates" not in self.parts:
            return state, self.covariance
        values = self.parts["estimates"]
        m = self.parts["parameter_covariance"].reshape(len(values), -1)
        s = self.parts["sensitivity"].reshape(len(values), -1).T
        across = s @ m
        return np.append(state, values), np.block([[self.covariance + across @ s.T, across], [across.T, m]])

    def start(self, speed: float) -> None:
        self._initialize(self._struct, speed)

    def place(self, index: int, value: float, deviation: float) -> None:
        self._place(self._struct, index, value, deviation)

    def linearize(self) -> None:
        self._linearize(self._struct)

    def predict(self, h: float) -> bool:
        return bool(self._predict(self._struct, h))

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        call, m = self._correct[sensor], len(value)
        self._value[:m], self._variance[:m] = value, variance
        return float(call(self._struct, *self._measured, limit, scale))

    def survey(self) -> bool:
        assert self._survey is not None, "its file knows no road"
        return bool(self._survey(self._struct))

    def present(self) -> tuple[Array, Array]:
        acceleration, wheels = np.zeros(14), np.zeros((7, 4))
        self._present(self._struct, acceleration.ctypes.data, wheels.ctypes.data)
        return acceleration, wheels


class _Twin(CarFilter):
    """A filter whose every call is made to the exported one as well, and the results compared.

    The struct of the exported one stands in the memory of the filter's car, so that both go back together for a late
    measurement. What is written into the mean directly, at the start and where the car stands, is copied.
    """

    def __init__(self, own: ErrorEkf | Spi, other: Exported, difference: Difference, mean: Array) -> None:
        self.own, self.other, self.difference, self._mean_there = own, other, difference, mean
        self.car, self.memory, self.inputs = own.car, own.memory, own.inputs
        self.names, self.sensors = own.names, own.sensors

    def start(self, belief: Gaussian) -> None:
        self.own.start(belief)
        self._copy()

    def _copy(self) -> None:
        """Give the exported one all that this one has."""
        car, parts = self.car, self.other.parts
        kept = numbers_kept(len(car.mean), len(self.names) - len(car.names))
        common = car.mean.size + car.inputs.size + car.covariance.size + car.effects.size + car.linearization.size
        common += car.parameters.size + kept
        self.other.memory[:common] = self.memory[:common]
        parts["reversion_mean"][:] = car.reversion_mean
        if "surveyed" in parts:
            parts["surveyed"][:] = car.surveyed
        self.difference.placed += 1
        self._mean_there[:] = car.mean

    def _follow(self) -> None:
        if not np.array_equal(self._mean_there, self.car.mean):
            self._copy()
        self.other.parts["inputs"][:] = self.inputs

    def _compare(self) -> None:
        difference, (state, covariance) = self.difference, self.own.belief()
        their_state, their_covariance = self.other.belief()
        size, deviation = np.abs(state), np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        size[FORCE] = size[FORCE].max()
        apart = relative(their_state, state, np.maximum(1.0, size))
        difference.state = max(difference.state, apart)
        apart = relative(their_covariance, covariance, np.outer(deviation, deviation))
        difference.covariance = max(difference.covariance, apart)
        self._mean_there[:] = self.car.mean

    def linearize(self) -> None:
        parts = self.other.parts
        if "surveyed" in parts and not np.array_equal(parts["surveyed"], self.car.surveyed):
            parts["inputs"][:] = self.inputs
            self.other.survey()  # the road was looked up, at the end of which is a linearisation
            self.difference.surveyed += 1
            self.own.linearize()
        else:
            self._follow()
            self.own.linearize()
            self.other.linearize()
        self._compare()

    def predict(self, h: float) -> None:
        self._follow()
        self.own.predict(h)
        self.other.predict(h)
        self.other.linearize()
        self.difference.predictions += 1
        self._compare()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        self._follow()
        innovation = self.own.correct(sensor, value, variance, limit, scale)
        theirs = self.other.correct(sensor, value, variance, limit, scale)
        self.difference.corrections += 1
        apart = relative(np.array(theirs), np.array(innovation.nis))
        self.difference.innovation = max(self.difference.innovation, apart)
        self._compare()
        return innovation

    def set_element(self, index: int, value: float, deviation: float) -> None:
        self._follow()
        self.own.set_element(index, value, deviation)
        self.other.place(index, value, deviation)
        self._mean_there[:] = self.car.mean

    def belief(self) -> Gaussian:
        return self.own.belief()

    def is_valid(self) -> bool:
        return self.own.is_valid()

    def inflate(self) -> None:
        self.own.inflate()
        self._copy()

    def compare_outputs(self) -> None:
        """Accelerations, forces and slips at the present state."""
        self._follow()
        accelerations, wheels = self.car.present()
        others, their_wheels = self.other.present()
        largest = np.maximum(np.abs(wheels).max(axis=1, keepdims=True), 1.0)
        apart = max(relative(others, accelerations), relative(their_wheels, wheels, largest))
        self.difference.outputs = max(self.difference.outputs or 0.0, apart)


def _twin(
    library: ctypes.CDLL,
    difference: Difference,
    vehicle: Vehicle,
    sensors: dict[str, SensorBase],
    prior: Prior | None = None,
) -> _Twin:
    """The filter of a vehicle and the exported one, in one memory."""
    size, count = layout(sensors).size, len(vehicle.observer.parameters)
    struct = sum(c.Observer.of(vehicle).fields().values())
    kept = numbers_kept(size, count)
    car = CarBlocks(vehicle, sensors, extra=kept + struct + size, prior=prior)
    own = Spi(car, FILTERS[vehicle.observer.parameter_filter]) if count else ErrorEkf(car)
    theirs, mean = car.extra[kept : kept + struct], car.extra[kept + struct :]
    return _Twin(own, Exported(vehicle, library, theirs), difference, mean)


def relative(found: Array, expected: Array, unit: Array | None = None) -> float:
    """Largest difference, relative to what was expected where that is above one; infinite where one is no number."""
    apart = np.abs(found - expected) / (np.maximum(1.0, np.abs(expected)) if unit is None else unit)
    return float(
        np.max(np.where(np.isnan(found) & np.isnan(expected), 0.0, np.nan_to_num(apart, nan=np.inf)), initial=0.0)
    )


def compare(
    vehicle: Vehicle,
    library: ctypes.CDLL,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
) -> Difference:
    """Run the observer on a recording with the exported one beside it, which gets the same calls and nothing else."""
    origin, difference = c.Observer.of(vehicle).map_origin or recording.map_origin, Difference()
    observer = Observer(vehicle, origin, partial(_twin, library, difference))
    twin = observer.filter
    assert isinstance(twin, _Twin)
    topics = tuple(topic for topic in observer.topics if topic in recording)
    total = sum(len(recording[topic]) for topic in topics)
    for i, sample in enumerate(recording.samples(topics)):
        observer.add(sample)
        if observer.started and i % 100 == 0:
            observer.snapshot()
            twin.compare_outputs()
            if progress is not None:
                progress(i / total)
    if not observer.started:
        raise InputError(f"{recording.name or 'recording'}: the observer never started, there is nothing to compare")
    difference.returns = sum(health.late for health in observer.health)
    return difference


def _deepest(stack: dict[str, int]) -> int:
    """Bytes of the deepest call, from those of each function; what was inlined is in its caller's."""

    def size(*names: str) -> int:
        return sum(stack.get(name, 0) for name in names)

    products = size("combine_rows")
    moving = [size("transition", "invert"), size("propagate", "propagate_velocities", "propagate_coordinates")]
    moving = [depth + products for depth in moving] + [size("advance"), size("kinematics")]
    moving += [size("spread", "parameters_predict")]
    correcting = [size("correct", "update", "project") + products, size("learn", "parameters_learn")]
    correcting += [size("learn") + depth for name, depth in stack.items() if name.startswith("seen_")]
    calls = max(depth for name, depth in stack.items() if name.startswith("vsense_correct_"))
    return max(size("vsense_predict", "filter_predict") + max(moving), calls + size("filter_measure") + max(correcting))


def measure(folder: Path) -> dict[str, str]:
    """How large and how fast the sources in `folder` are here: for the README that is written with them."""
    compiler = codegen.compiler()
    assert compiler is not None
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "example"
        sources = [str(folder.resolve() / name) for name in ("example.c", "vsense.c")]
        command = [compiler, *FLAGS, *sources, "-o", str(target), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        told = subprocess.run([str(target), "--time"], check=True, capture_output=True, text=True).stdout
        subprocess.run(
            [compiler, *FLAGS, "-fstack-usage", "-c", sources[1], "-o", "vsense.o"],
            check=True,
            capture_output=True,
            cwd=place,
        )
        sizes = subprocess.run(["size", "vsense.o"], check=True, capture_output=True, text=True, cwd=place).stdout
        lines = (Path(place) / "vsense.su").read_text(encoding="utf-8").splitlines()
        stack: dict[str, int] = {}
        for where, depth, _ in (line.split("\t") for line in lines):
            name = where.rpartition(":")[2].partition(".")[0]  # without what the compiler says of a copy it made
            stack[name] = max(stack.get(name, 0), int(depth))
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    step = re.search(r"step +([\d.]+) us", told)
    assert step is not None
    return {
        "compiler": version,
        "flags": " ".join(FLAGS),
        "machine": f"{platform.machine()}, {platform.system()}",
        "text_kb": f"{int(sizes.splitlines()[1].split()[0]) / 1024:.0f}",
        "stack_kb": f"{_deepest(stack) / 1024:.0f}",
        "step_us": step[1],
    }
