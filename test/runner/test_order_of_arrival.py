"""A heading that is worse than a few degrees bends a velocity; by how much does not depend on when that arrives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag.importers import import_recording
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Sample
from vsense_ros.model.coordinates import YAW
from vsense_ros.runner import Runner

DOUBTED, END = 3.0, 4.5  # [s]


def state_after(delay: float) -> NDArray[np.float64]:
    """Means and covariance at the end, where GNSS velocities arrive so late [s] once the heading is doubtful."""
    recording = import_recording(shared_folder("bags") / "hills").between(0.0, END)
    runner = Runner(load_vehicle(vehicle_path("prototype_model")), recording.map_origin)
    by_stamp = sorted(recording.samples(tuple(runner.topics)), key=lambda one: one.stamp)
    doubted = recording.start + round(1e9 * DOUBTED)

    def arrives(one: Sample) -> int:
        return one.stamp + (round(1e9 * delay) if one.topic == "gps/velocity" else 0)

    for sample in (one for one in by_stamp if one.stamp < doubted):
        runner.add(replace(sample, received=sample.stamp))
    runner.snapshot()
    car = runner.adapter.filter.car
    runner.adapter.filter.set_element(YAW, car.mean.item(YAW) + 0.1, 0.2)
    runner._timeline.forget_past()
    for sample in sorted((one for one in by_stamp if one.stamp >= doubted), key=arrives):
        runner.add(replace(sample, received=arrives(sample)))
    runner.snapshot_at(recording.start + round(1e9 * END))
    return np.concatenate([car.mean, car.covariance.ravel()])


def test_a_doubtful_heading_is_corrected_alike_by_velocities_that_arrive_at_once_and_late() -> None:
    np.testing.assert_array_equal(state_after(0.3), state_after(0.0))
