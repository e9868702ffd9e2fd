"""Recordings from which a car cannot be identified: each is answered by a sentence that says why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.identification import identify
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

pytestmark = pytest.mark.slow

Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(vehicle_path("jaguar_saloon"))


@pytest.fixture(scope="module")
def lane_change(car: Vehicle) -> Recording:
    return record(drive(MANOEUVRES["double_lane_change"], car), car, 1, name="lane change")


def scaled(topic: str, column: str, factor: np.ndarray | float) -> Change:
    def change(recording: Recording) -> Recording:
        channel = recording[topic]
        columns = {**channel.columns, column: channel.columns[column] * factor}
        return replace(recording, channels={**recording.channels, topic: replace(channel, columns=columns)})

    return change


def without(topic: str) -> Change:
    return lambda recording: replace(recording, channels={k: c for k, c in recording.channels.items() if k != topic})


@pytest.mark.parametrize(
    ("change", "model", "said"),
    [
        (scaled("vehicle/steering", "position", -1.0), "best", "the steering angle goes against yaw rate times speed"),
        (
            scaled("imu/data", "angular_velocity", np.array([1.0, 1.0, -1.0])), "best",
            "the lateral acceleration goes against yaw rate times speed",
        ),
        (without("vehicle/steering"), "best", "expected a steering angle"),
        (without("vehicle/wheel_speeds"), "best", "needs the speeds of all four wheels; use --model single_track"),
        (lambda recording: recording.between(0.0, 5.0), "best", "nowhere 10 s of driving"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_recording_is_said_and_not_identified_around(
    car: Vehicle, lane_change: Recording, change: Change, model: str, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        identify([change(lane_change)], car, model)  # type: ignore[arg-type]


@pytest.mark.parametrize(("free", "said"), [("front_stifness", "nearest are front_stiffness"), ("x", "no parameter")])
def test_a_parameter_that_is_not_there_is_refused_with_the_nearest_names(
    car: Vehicle, lane_change: Recording, free: str, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        identify([lane_change], car, "best", free=(free,))


@pytest.mark.exam
def test_drives_of_two_cars_are_not_taken_for_one(car: Vehicle, lane_change: Recording) -> None:
    other = car.with_parameters({"chassis.mass": 2400.0, "chassis.yaw_inertia": 5500.0, "front.cornering_scale": 0.7})
    second = record(drive(MANOEUVRES["double_lane_change"], other), other, 2, name="another car")
    with pytest.raises(InputError, match="are not of one car, or not with the same tyres"):
        identify([lane_change, second], car, "single_track")


@pytest.mark.exam
def test_what_a_gentle_drive_does_not_tell_is_refused_by_name_with_the_driving_that_would_tell_it(car: Vehicle) -> None:
    gentle = record(drive(MANOEUVRES["lane_change_25"], car), car, 1, name="gentle")
    found = identify([gentle], car, "single_track", free=("front_stiffness", "front_peak", "front_curvature"))
    refused = {one.name for one in found.refused}
    assert {"front_peak", "front_curvature"} <= refused
    sentences = " ".join(found.sentences())
    assert "drive bends" in sentences
    for name in ("front_peak", "front_curvature"):
        assert found.values[name] == found.start[name]


def test_the_command_says_it_in_one_line_and_leaves_nothing_half_written(
    tmp_path: Path, car: Vehicle, lane_change: Recording
) -> None:
    write_bag(tmp_path / "wrong", scaled("vehicle/steering", "position", -1.0)(lane_change))
    folder = tmp_path / "report"
    options = ["identify", str(tmp_path / "wrong"), "--vehicle", "jaguar_saloon", "--report", str(folder)]
    result = CliRunner().invoke(main, options)
    assert result.exit_code != 0
    assert "wrong sign" in result.output
    assert "Traceback" not in result.output
    assert not list(folder.glob("*"))
