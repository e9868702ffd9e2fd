"""A unit on a recording, beside the same C called directly and the observer in Python."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.reading import Map
from vsense_ros.export import c, check
from vsense_ros.export.fmu import ELEMENTS, FIRST_INTEGER, OPTIMISED, START_SPEED, Unit
from vsense_ros.export.same_calls import Moment, drive_together, moments, relative, start_of
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import default_filter
from vsense_ros.observer.road_map import RoadMap
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import FORCE

Array = NDArray[np.float64]


@dataclass
class Agreement:
    """What a check found."""

    version: int
    remarks: list[str] = field(default_factory=list)  # of FMPy's validation
    steps: int = 0
    bitwise: bool = True  # states equal to those of the C export to the last bit
    python: float = 0.0  # largest difference of a state from Python's, relative where it is above one

    def in_words(self) -> list[str]:
        """For the terminal."""
        valid = "valid, without a remark" if not self.remarks else f"{len(self.remarks)} remarks: {self.remarks[0]}"
        bits = "the same bits as" if self.bitwise else "NOT the same bits as"
        return [
            f"FMI {self.version}: {valid}; {self.steps} steps with {bits} the C export, "
            f"within {self.python:.1e} of the observer in Python"
        ]


class Running:
    """One instance of a unit, by FMPy."""

    def __init__(self, path: Path, unit: Unit, version: int, speed: float = START_SPEED, yaw: float = 0.0) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.unit, self.version = unit, version
        self._folder = fmpy.extract(str(path))
        description = fmpy.read_model_description(str(path))
        self._places = {v.name: i for i, v in enumerate(unit.variables)}
        self._counts = [0] * len(unit.sensors)
        common = {
            "unzipDirectory": self._folder, "modelIdentifier": description.coSimulation.modelIdentifier,
            "instanceName": "checked", "guid": description.guid,
        }  # fmt: skip
        self.slave: Any = (FMU2Slave if version == 2 else FMU3Slave)(**common)
        self.slave.instantiate()
        self.set("start_speed", [speed])
        self.set("start_yaw", [yaw])
        if version == 2:
            self.slave.setupExperiment(startTime=0.0)
            self.slave.enterInitializationMode()
        else:
            self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def set(self, name: str, values: Any) -> None:
        """All elements of a variable."""
        place, given = self._places[name], [float(v) for v in values]
        if self.version == 2:
            self.slave.setReal(self._elements(place), given)
        elif self.unit.scalars:
            self.slave.setFloat64(self._elements(place), given)
        else:
            self.slave.setFloat64([place], given)

    def get(self, name: str) -> Array:
        """All elements of a variable."""
        place = self._places[name]
        size = self.unit.variables[place].size
        if self.version == 2:
            return np.array(self.slave.getReal(self._elements(place)))
        if self.unit.scalars:
            return np.array(self.slave.getFloat64(self._elements(place)))
        return np.array(self.slave.getFloat64([place], nValues=size))

    def _elements(self, place: int) -> list[int]:
        """Value references of the elements of a variable, where they are scalars."""
        return [ELEMENTS * place + k for k in range(self.unit.variables[place].size)]

    def measured(self, index: int, value: Array) -> None:
        """A new measurement of a sensor that corrects."""
        self._counts[index] += 1
        self.set(self.unit.sensors[index].name, value)
        reference, count = [FIRST_INTEGER + index], [self._counts[index]]
        if self.version == 2:
            self.slave.setInteger(reference, count)
        else:
            self.slave.setInt32(reference, count)

    def step(self, time: float, h: float) -> None:
        self.slave.doStep(time, h)

    def save(self) -> bytes:
        """The state, as it can be given to another process."""
        if self.version == 2:
            state = self.slave.getFMUstate()
            data = self.slave.serializeFMUstate(state)
            self.slave.freeFMUstate(state)
        else:
            state = self.slave.getFMUState()
            data = self.slave.serializeFMUState(state)
            self.slave.freeFMUState(state)
        return bytes(data) + bytes(np.array(self._counts, np.int32))

    def restore(self, data: bytes) -> None:
        size = 4 * len(self._counts)
        own, counts = (data[:-size], data[-size:]) if size else (data, b"")
        self._counts = np.frombuffer(counts, np.int32).tolist()
        if self.version == 2:
            self.slave.setFMUstate(self.slave.deSerializeFMUstate(own))
        else:
            self.slave.setFMUState(self.slave.deserializeFMUState(own))

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)


def drive_unit(running: Running, vehicle: Vehicle, drive: list[Moment], begin: int = 0) -> Iterator[Array]:
    """The state after each step between the moments of a drive, from the one `begin` on."""
    sensors = sensors_of(vehicle)
    order = {name: i for i, name in enumerate(n for n, s in sensors.items() if not s.is_input)}
    inputs = running.get("input")
    for now, later in zip(drive[begin:-1], drive[begin + 1 :], strict=True):
        for name, value in now.measured.items():
            sensor = sensors[name]
            if sensor.inputs is not None:
                inputs[sensor.inputs] = np.nan_to_num(value)
                running.set("input", inputs)
            else:
                running.measured(order[name], value + sensor.offsets())
        running.step(now.time, later.time - now.time)
        yield running.get("state")


def compare(
    vehicle: Vehicle,
    path: Path,
    version: int,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
    optimised: str = OPTIMISED,
    *,
    scalars: bool = False,
) -> Agreement:
    """Validate a unit, and run it on a recording beside the C export and the filter in Python."""
    from fmpy.validation import validate_fmu

    agreement = Agreement(version, list(validate_fmu(str(path))))
    sensors, drive = sensors_of(vehicle), moments(vehicle, recording)
    speed, yaw = start_of(vehicle, drive)
    own = InPython(vehicle, sensors, speed, yaw)
    with tempfile.TemporaryDirectory() as place:
        c.write(vehicle, Path(place))
        library = check.build(Path(place), (optimised, "-std=c99"))
        exported = check.Exported(vehicle, library)
        exported.start(speed, yaw)
        running = Running(path, Unit(vehicle, scalars=scalars), version, speed, yaw)
        together = drive_together(vehicle, sensors, drive, (exported, own), as_a_unit_gets)
        try:
            for i, (state, _) in enumerate(zip(drive_unit(running, vehicle, drive), together, strict=True)):
                agreement.steps += 1
                agreement.bitwise &= bool(np.array_equal(state, exported.parts["state"]))
                mean = own.filter.belief().mean[: len(state)]
                size = np.maximum(1.0, np.abs(mean))
                size[FORCE] = max(1.0, float(np.abs(mean[FORCE]).max()))
                agreement.python = max(agreement.python, relative(state, mean, size))
                if progress is not None and i % 50 == 0:
                    progress(i / len(drive))
        finally:
            running.close()
    return agreement


class InPython:
    """The vehicle's own filter, as `drive_together` drives it."""

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], speed: float, yaw: float) -> None:
        self._road = RoadMap.of(vehicle, Map(c.Observer.of(vehicle).map_origin))
        self.filter = default_filter(vehicle)(vehicle, sensors)
        self.inputs = self.filter.inputs
        self.correct, self.advance = self.filter.correct, self.filter.predict
        belief = self.filter.car.rolling(speed)
        belief.mean[YAW] = yaw
        self.filter.car.forget()
        self.filter.start(belief)
        self.filter.linearize()

    def look(self) -> None:
        """Look up the road, where the vehicle file knows it."""
        if self._road is not None:
            self._road.follow(self.filter)


def as_a_unit_gets(sensor: SensorBase, value: Array) -> Array:
    """Offsets go on and off again, as in a unit, so that all get the same bits."""
    return (value + sensor.offsets()) - sensor.offsets()
