"""The path to one's own car with bad input: each step ends with a sentence and leaves the files as they were."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.prepare.calibration import calibrate
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle, write_new_vehicle
from vsense_ros.prepare.recording_check import check_fit

BAG = Path(__file__).parents[2] / "bags" / "hills"
CATALOGUE = {"mass": 1395.0, "wheelbase": 2.63, "track": 1.54, "axle_load_front": 820.0, "tyre": "205/55R16 91V"}
STOPPED = 130


@cache
def standing() -> Recording:
    """A recording of a car that stands: nothing turns or moves, and the accelerometer measures gravity."""
    drive = read_bag(BAG)
    names = ("imu/data", "vehicle/wheel_speeds", "vehicle/steering", "gps/fix", "gps/velocity")
    return Recording({name: _at_rest(drive[name]) for name in names}, name="standing")


def _at_rest(channel: Channel) -> Channel:
    rest = {"linear": 0.0, "angular": 0.0, "velocity": 0.0, "angular_velocity": 0.0, "position": 0.0}
    columns = {
        name: np.full_like(values, rest[name]) if name in rest else values for name, values in channel.columns.items()
    }
    if "linear_acceleration" in columns:
        columns["linear_acceleration"] = np.tile([0.0, 0.0, 9.81], (len(channel), 1))
    return replace(channel, columns=columns)


def vsense(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(one) for one in arguments])


def is_one_sentence(result: Result, *words: str) -> bool:
    lines = result.stderr.strip().splitlines()
    return result.exit_code == 2 and len(lines) == 1 and all(word in lines[0] for word in words)


def test_a_recording_of_a_standing_car_calibrates_nothing_and_says_so() -> None:
    with pytest.raises(InputError, match=r"standing: the car drives faster than 4 m/s for 0 s only"):
        calibrate([standing()], new_vehicle(catalogue_values(**CATALOGUE)).vehicle)


def test_a_check_says_that_a_standing_car_was_not_compared(tmp_path: Path) -> None:
    write_new_vehicle(tmp_path / "car.yaml", new_vehicle(catalogue_values(**CATALOGUE)))
    write_bag(tmp_path / "standing", standing())
    fit = check_fit(new_vehicle(catalogue_values(**CATALOGUE)).vehicle, [standing()])
    assert "standing" in fit.not_compared
    said = vsense("check", tmp_path / "car.yaml", tmp_path / "standing").stdout
    assert "not compared" in said
    assert "4 m/s" in " ".join(said.split())


def test_a_folder_that_does_not_exist_is_named_with_what_to_do(tmp_path: Path) -> None:
    options = [part for key, value in CATALOGUE.items() for part in (f"--{key.replace('_', '-')}", value)]
    result = vsense("new-vehicle", tmp_path / "nowhere" / "car.yaml", *options)
    assert is_one_sentence(result, "there is no folder", "create it first")


def test_an_empty_folder_is_called_empty_by_every_step(tmp_path: Path) -> None:
    write_new_vehicle(tmp_path / "car.yaml", new_vehicle(catalogue_values(**CATALOGUE)))
    (tmp_path / "drive").mkdir()
    car, drive = tmp_path / "car.yaml", tmp_path / "drive"
    for arguments in (
        ("import", drive, tmp_path / "bag"), ("check", car, drive), ("calibrate", drive, "--vehicle", car),
        ("identify", drive, "--vehicle", car), ("run", drive, "--vehicle", car),
    ):  # fmt: skip
        assert is_one_sentence(vsense(*arguments), "the folder is empty"), arguments


def test_a_command_that_the_user_stops_ends_with_a_sentence_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    write_new_vehicle(tmp_path / "car.yaml", new_vehicle(catalogue_values(**CATALOGUE)))
    monkeypatch.setattr("vsense_ros.prepare.calibration.drive_of", stopped)
    target = tmp_path / "calibrated.yaml"
    result = vsense("calibrate", BAG, "--vehicle", tmp_path / "car.yaml", "--output", target)
    assert result.exit_code == STOPPED
    assert "stopped" in result.stderr
    assert "Traceback" not in result.output
    assert not target.exists()
