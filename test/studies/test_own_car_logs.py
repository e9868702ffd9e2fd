"""The logs of the study of an own car are read by the commands of a newcomer to what the sensors measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies.own_car_logs import FORMATS
from vsense_ros.api.can import survey_can
from vsense_ros.api.recording import read
from vsense_ros.bag.importers.guess import guess
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.recorded import signals
from vsense_ros.messages.recording import Recording

BAG = Path(__file__).parents[2] / "bags" / "hills"
RADIUS = 0.31  # [m] of the control unit that reports wheel speeds in km/h


@pytest.fixture(scope="module")
def drive() -> Recording:
    return read(BAG)


def imported(drive: Recording, name: str, folder: Path) -> Recording:
    """The drive written in a format, and read with the mapping that the project proposes for it."""
    log_format = FORMATS[name]
    log, mapping = folder / f"log{log_format.suffix}", folder / "mapping.yaml"
    log_format.write(drive, log, RADIUS)
    options = {}
    if log_format.database:
        database = folder / "car.dbc"
        database.write_text(log_format.database, encoding="utf-8")
        mapping.write_text(survey_can(log, [database]).mapping(), encoding="utf-8")
        options["dbc"] = database
    else:
        mapping.write_text(guess(log).text, encoding="utf-8")
    return read(log, mapping=mapping, **options)


def series(recording: Recording, topic: str, field: str, column: int) -> tuple[np.ndarray, np.ndarray]:
    channel = recording[topic]
    values = channel.measured[field][:, column]
    good = np.isfinite(values)
    return channel.stamp[good] - recording["imu/data"].stamp[0], values[good]


@pytest.mark.parametrize("name", FORMATS)
def test_a_foreign_log_is_read_with_the_proposed_mapping(drive: Recording, name: str, tmp_path: Path) -> None:
    found = imported(drive, name, tmp_path)
    for topic, field, column, tolerance in (
        ("imu/data", "angular_velocity", 2, 0.01),
        ("imu/data", "linear_acceleration", 1, 0.2),
        ("vehicle/steering", "position", 0, 0.01),
        ("gps/velocity", "linear", 0, 0.05),
        ("gps/velocity", "linear", 1, 0.05),
        ("gps/fix", "latitude", 0, 1e-6),
        ("gps/fix", "longitude", 0, 1e-6),
    ):
        time, values = series(found, topic, field, column)
        expected_time, expected = series(drive, topic, field, column)
        late = drive[topic].received[0] - drive[topic].stamp[0] - (
            drive["imu/data"].received[0] - drive["imu/data"].stamp[0]
        )  # fmt: skip
        late = late if FORMATS[name].logs_arrival else 0
        error = values - np.interp(time, expected_time + late, expected)
        assert len(values) > 0.9 * len(expected), topic
        assert np.sqrt(np.mean(error**2)) < tolerance, (topic, field, column)


@pytest.mark.parametrize("name", FORMATS)
def test_wheel_speeds_of_a_foreign_log_agree_up_to_the_rolling_radius(
    drive: Recording, name: str, tmp_path: Path
) -> None:
    spin = imported(drive, name, tmp_path)["vehicle/wheel_speeds"].columns["velocity"]
    expected = drive["vehicle/wheel_speeds"].columns["velocity"]
    ratio = np.nanmean(spin, axis=0) / expected.mean(axis=0)
    assert ratio == pytest.approx(ratio[0], rel=0.01)
    assert 0.9 < ratio[0] < 1.1


def test_rates_and_accelerations_in_two_frames_of_one_time_identify_a_car(drive: Recording, tmp_path: Path) -> None:
    """The American log has the yaw rate in one frame and the accelerations in another, with the same time."""
    found = signals(imported(drive, "American CAN", tmp_path), load_vehicle(vehicle_path("prototype_model")))
    expected = signals(drive, load_vehicle(vehicle_path("prototype_model")))
    assert np.isfinite(found.rates[:, 2]).all()
    assert np.isfinite(found.forces[:, :2]).all()
    assert found.rates[:, 2].std() == pytest.approx(expected.rates[:, 2].std(), rel=0.02)
