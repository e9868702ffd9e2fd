"""The exported observer in single precision beside that in double precision, on a recording."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.export import c, check
from vsense_ros.export.same_calls import drive_together, moments, start_of
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import FORCE

Array = NDArray[np.float64]
_SHOWN = ((14, "forward speed", "m/s"), (15, "lateral velocity", "m/s"), (19, "yaw rate", "rad/s"), (3, "roll", "rad"))


def compare_single(vehicle: Vehicle, recording: Recording) -> list[tuple[str, str, float, float]]:
    """Name, unit, largest difference and largest amount of what users look at.

    Raises `InputError` without a compiler."""
    drive, sensors = moments(vehicle, recording), sensors_of(vehicle)
    speed, yaw = start_of(vehicle, drive)
    pair = []
    with tempfile.TemporaryDirectory() as place:
        for number in (np.float64, np.float32):
            folder = Path(place) / number.__name__
            c.write(vehicle, folder, single=number is np.float32)
            exported = check.Exported(vehicle, check.build(folder, ("-O2", "-std=c99")), number=number)
            exported.start(speed, yaw)
            pair.append(exported)
        states: list[list[Array]] = [
            [one.parts["state"][: FORCE.start].astype(float) for one in pair]
            for _ in drive_together(vehicle, sensors, drive, pair, lambda sensor, value: value)
        ]
    double, single = np.array(states).transpose(1, 0, 2)
    return [
        (name, unit, float(np.abs(single[:, i] - double[:, i]).max()), float(np.abs(double[:, i]).max()))
        for i, name, unit in _SHOWN
    ]
