"""What a Python prompt and `print` show of answers, as somebody at a terminal or in a notebook reads them."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.cli import main

BAG = Path(__file__).parents[2] / "bags" / "step_steer"
LINE = 400  # characters, more than which nobody reads at a prompt


@pytest.fixture(scope="module")
def recording() -> vs.Recording:
    return vs.read(BAG)


@pytest.fixture(scope="module")
def car() -> vs.Vehicle:
    return vs.load_vehicle("prototype_model")


def test_a_prompt_shows_one_line_of_a_recording_a_channel_a_vehicle_and_answers(recording, car):
    shown = [repr(one) for one in (recording, recording["imu/data"], car, vs.info(recording), vs.check(car))]
    assert all(len(text) < LINE and "\n" not in text for text in shown), shown
    assert shown[0].startswith("<Recording: step_steer, ")
    assert shown[1].startswith("<Channel: imu/data, sensor_msgs/msg/Imu, ")
    assert shown[2] == f"<Vehicle: {car.name}>"


def test_print_shows_an_answer_as_its_command_does(recording):
    for command, answer in (("info", vs.info(recording)), ("check", vs.check("prototype_model", recording))):
        arguments = ["prototype_model", str(BAG)] if command == "check" else [str(BAG)]
        printed = CliRunner().invoke(main, [command, *arguments]).output
        assert str(answer).strip() == printed.strip(), command


def test_one_recording_is_taken_where_several_are(recording, car):
    of_one, of_list = vs.check(car, recording), vs.check(car, [recording])
    assert of_one.as_dict() == of_list.as_dict()
    assert vs.check(car, str(BAG)).as_dict() == of_list.as_dict()


def test_a_recording_can_be_walked_through_by_topics(recording):
    assert list(recording) == list(recording.channels)
    assert all(recording[topic].topic == topic for topic in recording)
