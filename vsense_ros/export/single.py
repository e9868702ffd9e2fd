"""The exported observer in single precision beside that in double precision, on a recording."""

from __future__ import annotations

import ctypes
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import largest_nis
from vsense_ros.export import c, check
from vsense_ros.export.fmu_check import moments, start_of
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.observer import sensors_of

Array = NDArray[np.float64]
_SHOWN = ((14, "forward speed", "m/s"), (15, "lateral velocity", "m/s"), (19, "yaw rate", "rad/s"), (3, "roll", "rad"))


class _Single:
    """The library in single precision, as `check.Exported` is that in double precision."""

    def __init__(self, vehicle: Vehicle, library: ctypes.CDLL) -> None:
        fields = c.Observer.of(vehicle).fields()
        self.memory = np.zeros(sum(fields.values()), np.float32)
        ends = np.cumsum(list(fields.values())).tolist()
        self.parts = dict(zip(fields, np.split(self.memory, ends[:-1]), strict=True))
        self._library, self._struct = library, ctypes.c_void_p(self.memory.ctypes.data)

    def start(self, speed: float) -> None:
        self._library.vsense_init(self._struct, ctypes.c_float(speed))

    def linearize(self) -> None:
        self._library.vsense_linearize(self._struct)

    def predict(self, h: float) -> None:
        self._library.vsense_predict(self._struct, ctypes.c_float(h))

    def correct(self, sensor: str, value: Array, variance: Array, limit: float) -> None:
        given = [np.ascontiguousarray(a, np.float32) for a in (value, variance)]
        call = self._library[f"vsense_correct_{c.identifier(sensor)}"]
        call.restype = ctypes.c_float
        places = [ctypes.c_void_p(a.ctypes.data) for a in given]
        call(self._struct, *places, ctypes.c_float(limit), ctypes.c_float(1.0))


def compare_single(vehicle: Vehicle, recording: Recording) -> list[tuple[str, str, float, float]]:
    """Name, unit, largest difference and largest amount of what users look at.

    Raises `InputError` without a compiler."""
    drive, sensors = list(moments(vehicle, recording)), sensors_of(vehicle)
    speed, yaw = start_of(vehicle, drive)
    with tempfile.TemporaryDirectory() as place:
        built = []
        for single in (False, True):
            folder = Path(place) / str(single)
            c.write(vehicle, folder, single=single)
            built.append(check.build(folder, ("-O2", "-std=c99")))
        pair: tuple[check.Exported | _Single, ...] = (check.Exported(vehicle, built[0]), _Single(vehicle, built[1]))
        for one in pair:
            one.start(speed)
            one.parts["state"][YAW] = yaw
            one.linearize()
        states: list[list[Array]] = [[], []]
        for now, later in pairwise(drive):
            h = later.time - now.time
            count = max(1, int(np.ceil(h / vehicle.observer.longest_step - 1e-9)))
            for one, kept in zip(pair, states, strict=True):
                for name, value in now.measured.items():
                    sensor = sensors[name]
                    if sensor.inputs is not None:
                        one.parts["inputs"][sensor.inputs] = np.nan_to_num(value)
                        continue
                    variance = sensor.deviations() ** 2
                    one.correct(name, value, variance, largest_nis(sensor.gate, len(variance)))
                for _ in range(count):
                    one.predict(h / count)
                    one.linearize()
                kept.append(one.parts["state"][:28].astype(float))
    double, found = (np.array(kept) for kept in states)
    return [
        (name, unit, float(np.abs(found[:, i] - double[:, i]).max()), float(np.abs(double[:, i]).max()))
        for i, name, unit in _SHOWN
    ]
