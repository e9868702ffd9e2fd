"""A unit on a recording, beside the same C called directly and the observer in Python."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import largest_nis
from vsense_ros.estimation.intake import Intake, by_topic
from vsense_ros.estimation.reading import Map
from vsense_ros.export import check
from vsense_ros.export.fmu import FIRST_INTEGER, OPTIMISED, Unit
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import default_filter
from vsense_ros.observer.observer import sensors_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """What was measured at one time [s since the first], values by the name of the sensor."""

    time: float
    measured: dict[str, Array]


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


def moments(vehicle: Vehicle, recording: Recording) -> Iterator[Moment]:
    """What the sensors of a vehicle measured, in order of time: as if nothing came late."""
    sensors = sensors_of(vehicle)
    names, listening = list(sensors), by_topic(tuple(sensors.values()))
    intake = Intake(sensors, Map(recording.map_origin), 1e9, lambda: True)
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
    for stamp, together in groupby(events, key=lambda e: e[0]):
        yield Moment((stamp - first) * 1e-9, {names[index]: value for _, index, value in together})


def start_of(vehicle: Vehicle, drive: list[Moment]) -> tuple[float, float]:
    """Speed [m/s] and heading [rad] at the start, from the first velocity on the map, else 20 m/s towards east."""
    kinds = {name: sensor.kind for name, sensor in sensors_of(vehicle).items()}
    for moment in drive:
        for name, value in moment.measured.items():
            if kinds[name] == "gnss_velocity" and np.all(np.isfinite(value[:2])):
                return float(np.hypot(*value[:2])), float(np.arctan2(value[1], value[0]))
    return 20.0, 0.0


class Running:
    """One instance of a unit, by FMPy."""

    def __init__(self, path: Path, unit: Unit, version: int, speed: float = 20.0, yaw: float = 0.0) -> None:
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
            self.slave.setReal([1000 * place + k for k in range(len(given))], given)
        else:
            self.slave.setFloat64([place], given)

    def get(self, name: str) -> Array:
        """All elements of a variable."""
        place = self._places[name]
        size = self.unit.variables[place].size
        if self.version == 2:
            return np.array(self.slave.getReal([1000 * place + k for k in range(size)]))
        return np.array(self.slave.getFloat64([place], nValues=size))

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
) -> Agreement:
    """Validate a unit, and run it on a recording beside the C export and the filter in Python."""
    import fmpy
    from fmpy.validation import validate_fmu

    found = Agreement(version, list(validate_fmu(str(path))))
    unit = Unit(vehicle)
    drive = list(moments(vehicle, recording))
    speed, yaw = start_of(vehicle, drive)
    sensors = sensors_of(vehicle)
    own = default_filter(vehicle)(vehicle, sensors)
    belief = own.car.rolling(speed)
    belief.mean[YAW] = yaw
    own.car.forget()
    own.start(belief)
    own.linearize()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(fmpy.extract(str(path), place))
        library = check.build(folder / "sources", (optimised, "-std=c99"))
        exported = check.Exported(vehicle, library)
        exported.start(speed)
        exported.parts["state"][YAW] = yaw
        exported.linearize()
        running = Running(path, unit, version, speed, yaw)
        try:
            for i, state in enumerate(drive_unit(running, vehicle, drive)):
                now, later = drive[i], drive[i + 1]
                for name, value in now.measured.items():  # inputs first, as a unit gets all before it steps
                    if (part := sensors[name].inputs) is not None:
                        own.inputs[part] = exported.parts["inputs"][part] = np.nan_to_num(value)
                for name, value in now.measured.items():
                    sensor = sensors[name]
                    if sensor.is_input:
                        continue
                    variance = sensor.deviations() ** 2
                    limit = largest_nis(sensor.gate, len(variance))
                    # Offsets go on and off again, so that both get what the unit gets.
                    given = (value + sensor.offsets()) - sensor.offsets()
                    exported.correct(name, given, variance, limit)
                    own.correct(name, given, variance, limit)
                h = later.time - now.time
                count = max(1, int(np.ceil(h / vehicle.observer.longest_step - 1e-9)))
                for _ in range(count):
                    exported.predict(h / count)
                    exported.linearize()
                    own.predict(h / count)
                found.steps += 1
                found.bitwise &= bool(np.array_equal(state, exported.parts["state"]))
                mean = own.belief().mean[: len(state)]
                size = np.maximum(1.0, np.abs(mean))
                size[28:42] = max(1.0, float(np.abs(mean[28:42]).max()))
                found.python = max(found.python, float(np.max(np.abs(state - mean) / size)))
                if progress is not None and i % 50 == 0:
                    progress(i / len(drive))
        finally:
            running.close()
    return found
