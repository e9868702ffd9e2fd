"""A real car without GNSS for half a minute: where it is by its wheels and inertial sensors."""

from __future__ import annotations

import numpy as np
import pytest

from marks import exam_except
from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate.faults import FIX, VELOCITY, Fault, silent
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.runner import run as run_observer
from vsense_ros.runner.run import run

OUTAGE = 30.0  # [s]
CASES = (("error_ekf", 10.0), ("strapdown", 10.0), ("strapdown", 20.0), ("strapdown", 29.0))  # filter, begin [s]


@pytest.fixture(scope="module")
def drive() -> Recording:
    try:
        return import_recording(datasets.fetch("comma2k19_rav4"))
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "begin"), exam_except(CASES, ("strapdown", 20.0)))
def test_half_a_minute_without_gnss_costs_a_hundredth_of_the_way_and_the_heading_is_known_in_ten_seconds(
    drive: Recording, name: str, begin: float
) -> None:
    car, end = load_vehicle(vehicle_path("rav4")), begin + OUTAGE
    seen = Fault("no GNSS", (FIX, VELOCITY), silent, begin, end).of(drive)
    output = run_observer(seen, car).output if name == "error_ekf" else run(seen, car, name).output
    mine, reference = read_signals(at_reference(output, car), "vsense"), read_signals(drive, "reference")

    place = align(mine["position"], reference["position"])
    t = (place.stamp - drive.start) * 1e-9
    off = np.linalg.norm(place.error[(t > begin) & (t < end)][-1])
    true = reference["position"]
    at = (true.stamp - drive.start) * 1e-9
    way = np.linalg.norm(np.diff(true.value[(at > begin) & (at < end)], axis=0), axis=1).sum()
    assert off < 0.01 * way

    heading = align(mine["yaw"], reference["yaw"])
    t = (heading.stamp - drive.start) * 1e-9
    assert np.degrees(np.abs(heading.error[t > 10.0])).max() < 2.0
