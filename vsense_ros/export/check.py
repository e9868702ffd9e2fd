"""The exported observer beside the one in Python: the same calls to both, on a recording."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros import cache, codegen
from vsense_ros.estimation.filter import Gaussian, Innovation
from vsense_ros.export import c
from vsense_ros.export.same_calls import Difference, ExportedFilter, lead, relative, require_start
from vsense_ros.export.sources import compile_library
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.spi import FILTERS, Spi, numbers_kept
from vsense_ros.observer.state import FORCE, Prior, layout
from vsense_ros.runner import Runner

Array = NDArray[np.float64]

FLAGS = ("-O3", "-std=c99", "-Wall", "-Wextra", "-pedantic")
WARNINGS = ("-Wconversion", "-Wdouble-promotion", "-Wfloat-equal")  # of which the sources cause none, either


def build(folder: Path, flags: tuple[str, ...] = FLAGS, sources: Sequence[Path] = ()) -> ctypes.CDLL:
    """Library made of the `sources` in `folder`, by default vsense.c; kept in the cache, by its content.

    Raises `InputError` where there is no compiler, or where it complains.
    """

    def make(place: Path) -> Path:
        compile_library(
            sources or (folder / "vsense.c",), place / "vsense.so", ("-fPIC", *flags), ", which a check needs"
        )
        return place / "vsense.so"

    texts = [file.read_text(encoding="utf-8") for file in sorted(folder.rglob("*.[ch]"))]
    names = [source.name for source in sources]
    try:
        return ctypes.CDLL(str(cache.kept("export", (codegen.compiler() or "", *flags, *names, *texts), make)))
    except OSError:  # nowhere to keep it
        with tempfile.TemporaryDirectory() as place:
            return ctypes.CDLL(str(make(Path(place))))


class Exported(ExportedFilter):
    """The exported observer, called from Python. `memory` is its struct, if it has a place already; its `number` is
    that of the sources, double or single precision."""

    def __init__(
        self,
        vehicle: Vehicle,
        library: ctypes.CDLL,
        memory: NDArray[Any] | None = None,
        number: type[np.floating] = np.float64,
    ) -> None:
        exported = c.Observer.of(vehicle)
        fields = exported.fields()
        super().__init__(
            library,
            np.zeros(sum(fields.values()), number) if memory is None else memory,
            tuple(exported.correcting),
        )
        ends = np.cumsum(list(fields.values())).tolist()
        self.parts = dict(zip(fields, np.split(self.memory, ends[:-1]), strict=True))
        address = ctypes.c_void_p
        self._initialize = self.function("init", None, [address, self.number])
        self._place = self.function("place", None, [address, ctypes.c_int, self.number, self.number])
        self._linearize = self.function("linearize", None, [address])
        self._present = self.function("present", None, [address] * 3)
        self._survey = self.function("survey", ctypes.c_int, [address]) if exported.map_origin is not None else None
        self.start(0.0)

    @property
    def inputs(self) -> NDArray[Any]:
        """What drives the model (6,), in the struct."""
        return self.parts["inputs"]

    @property
    def covariance(self) -> Array:
        """Covariance of the errors of the state (n, n), in the struct."""
        size = len(self.parts["state"])
        return self.parts["covariance"].reshape(size, size)

    def belief(self) -> Gaussian:
        """State and parameters, and the covariance of their errors, as `Filter.belief`."""
        state = self.parts["state"]
        if "estimates" not in self.parts:
            return Gaussian(state, self.covariance)
        values = self.parts["estimates"]
        m = self.parts["parameter_covariance"].reshape(len(values), -1)
        s = self.parts["sensitivity"].reshape(len(values), -1).T
        across = s @ m
        return Gaussian(np.append(state, values), np.block([[self.covariance + across @ s.T, across], [across.T, m]]))

    def start(self, speed: float, yaw: float | None = None) -> None:
        """Begin as a car that rolls straight ahead at `speed` [m/s], towards `yaw` [rad] where that is known."""
        self._initialize(self._struct, speed)
        if yaw is not None:
            self.parts["state"][YAW] = yaw
            self.linearize()

    def place(self, index: int, value: float, deviation: float) -> None:
        """Set one element of the state, whose error then has this standard deviation and no correlation."""
        self._place(self._struct, index, value, deviation)

    def linearize(self) -> None:
        """Linearise the model at the present state."""
        self._linearize(self._struct)

    def advance(self, h: float) -> None:
        """Go on by `h` [s], and linearise."""
        self.predict(h)
        self.linearize()

    def survey(self) -> bool:
        """Look up the road at the present place; False where nothing is known of it."""
        assert self._survey is not None, "its file knows no road"
        return bool(self._survey(self._struct))

    def look(self) -> None:
        """Look up the road, where the vehicle file knows it."""
        if self._survey is not None:
            self.survey()

    def present(self) -> tuple[Array, Array]:
        """Derivatives of the velocities (14,), and forces and slips of the wheels (7, 4), at the present state."""
        acceleration, wheels = np.zeros(14), np.zeros((7, 4))
        self._present(self._struct, acceleration.ctypes.data, wheels.ctypes.data)
        return acceleration, wheels


class _Twin(CarFilter):
    """A filter whose every call is made to the exported one as well, and the results compared.

    The struct of the exported one stands in the memory of the filter's car, so that both go back together for a late
    measurement. What is written directly is copied: into the mean, at the start and where the car stands, and into the
    covariance, where the observer takes a sensor to be less certain than it says. `seen` (n + n²,) has both as they
    were after the newest call.
    """

    def __init__(self, own: ErrorEkf | Spi, other: Exported, difference: Difference, seen: Array) -> None:
        self.own, self.other, self.difference = own, other, difference
        size = len(own.car.mean)
        self._mean_seen, self._covariance_seen = seen[:size], seen[size:].reshape(size, size)
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
        self._see()

    def _see(self) -> None:
        self._mean_seen[:], self._covariance_seen[:] = self.car.mean, self.car.covariance

    def _follow(self) -> None:
        if not np.array_equal(self._mean_seen, self.car.mean):
            self._copy()
        elif not np.array_equal(self._covariance_seen, self.car.covariance):
            self.other.covariance[:] = self.car.covariance
            self.difference.widened += 1
        self.other.parts["inputs"][:] = self.inputs

    def _compare(self) -> None:
        ours, theirs = self.own.belief(), self.other.belief()
        size = np.abs(ours.mean)
        size[FORCE] = size[FORCE].max()
        self.difference.compare(theirs, ours, np.maximum(1.0, size))
        self._see()

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
        self.difference.corrected(self.other.correct(sensor, value, variance, limit, scale), innovation)
        self._compare()
        return innovation

    def set_element(self, index: int, value: float, deviation: float) -> None:
        self._follow()
        self.own.set_element(index, value, deviation)
        self.other.place(index, value, deviation)
        self._see()

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
    car = CarBlocks(vehicle, sensors, extra=kept + struct + size + size**2, prior=prior)
    own = Spi(car, FILTERS[vehicle.observer.parameter_filter]) if count else ErrorEkf(car)
    theirs, seen = car.extra[kept : kept + struct], car.extra[kept + struct :]
    return _Twin(own, Exported(vehicle, library, theirs), difference, seen)


def compare(
    vehicle: Vehicle,
    library: ctypes.CDLL,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
) -> Difference:
    """Run the observer on a recording with the exported one beside it, which gets the same calls and nothing else."""
    origin, difference = c.Observer.of(vehicle).map_origin or recording.map_origin, Difference()
    observer = Runner(vehicle, origin, partial(_twin, library, difference))
    twin = observer.filter
    assert isinstance(twin, _Twin)

    def look() -> None:
        observer.snapshot()
        twin.compare_outputs()

    lead(observer, recording, look, progress)
    require_start(observer, recording)
    difference.returns = sum(health.late for health in observer.health)
    return difference
