"""What is said of real cars, held against what the tool was not given."""

from __future__ import annotations

import pytest

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.mismatch.explain import answer
from vsense_ros.shared_files import vehicle_path
from vsense_ros.vehicle_file import load_vehicle


@pytest.mark.slow
def test_on_a_motorway_with_a_phone_for_an_imu_no_effect_is_named():
    """CAN and IMU of the RAV4 alone: a minute on a motorway, a phone behind the windscreen. Nothing in the channels
    that are left out speaks of an effect that could be known from these, so that any name would be wrong."""
    folder = datasets.find("comma2k19_rav4")
    if folder is None:
        pytest.skip("the RAV4's recording is not there: `vsense datasets fetch comma2k19_rav4`")
    car = load_vehicle(vehicle_path("rav4"))
    seen = {name: sensor for name, sensor in car.sensors.items() if not sensor.kind.startswith("gnss")}
    found = answer([import_recording(folder)], car.model_copy(update={"sensors": seen})).found
    assert found["verdict"] in ("no_mismatch", "unknown")
    assert not [effect for effect in found["effects"] if effect["accepted"]]
    assert {entry["id"] for entry in found["out_of_reach"]} >= {"aero_drag", "crosswind", "gnss_lever_arm"}
