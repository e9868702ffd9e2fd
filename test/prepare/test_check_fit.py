"""A vehicle file against a recording of the car: the RAV4's fits its own, and a wrong radius or tilt does not."""

from __future__ import annotations

import pytest

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.recording_check import FitCheck, check_fit


@pytest.fixture(scope="module")
def segment() -> Recording:
    folder = datasets.find("comma2k19_rav4")
    if folder is None:
        pytest.skip("the RAV4's recording is not there: `vsense datasets fetch comma2k19_rav4`")
    return import_recording(folder)


def rav4() -> Vehicle:
    return load_vehicle(vehicle_path("rav4"))


def test_nothing_is_found_where_file_and_recording_are_of_one_car(segment):
    assert check_fit(rav4(), [segment]) == FitCheck([])


def test_a_radius_of_larger_wheels_is_found_by_gnss(segment):
    wrong = rav4().with_parameters({"front.unloaded_radius": 0.41, "rear.unloaded_radius": 0.41})
    keys = {key for finding in check_fit(wrong, [segment]).findings for key in finding.keys}
    assert keys == {"physics.front.unloaded_radius", "physics.rear.unloaded_radius"}


def test_a_sensor_that_leans_otherwise_than_the_file_says_is_found_by_gravity_and_turns(segment):
    car = rav4()
    leaning = car.sensors["imu"].model_copy(update={"attitude": (0.012, -0.2, 0.0)})
    wrong = car.model_copy(update={"sensors": {**car.sensors, "imu": leaning}})
    keys = {key for finding in check_fit(wrong, [segment]).findings for key in finding.keys}
    assert "sensors.imu.attitude.1" in keys
