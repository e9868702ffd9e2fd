"""A GNSS receiver that states a tenth of its noise: said, and its position no more certain than it is."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.runner import run

SAID = "positions are noisier than stated"


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_positions_are_within_three_deviations_whatever_the_receiver_states(share: float) -> None:
    recording = import_recording(shared_folder("bags") / "hills").between(0.0, 12.0)
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    position = vehicle.sensors["position"]
    stated = position.model_copy(update={"noise": 1.35 * share, "noise_from_message": False})
    vehicle = vehicle.model_copy(update={"sensors": {**vehicle.sensors, "position": stated}})
    done = run(recording, vehicle, rate=50.0)
    estimate, truth = (
        read_signals(one, what)["position"] for one, what in ((done.output, "vsense"), (recording, "reference"))
    )
    found = align(estimate, truth)
    settled = found.stamp > recording.start + 2_000_000_000
    ratios = np.abs(found.error[settled]) / found.deviation[settled, None]
    assert np.mean(ratios < 3) > 0.97
    assert (SAID in " ".join(line.message for line in done.diagnostics)) == (share < 1)
