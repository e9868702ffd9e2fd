"""`vsense explain` as its users call it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hidden import driven, having, prototype, wrong
from vsense_ros.api.recording import read
from vsense_ros.api.stretch import Stretch, distinct_names
from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.cli.common import STRETCH
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.mismatch.explain import explain_recordings


@pytest.fixture
def called(tmp_path, monkeypatch):
    """The result of `vsense explain` for manoeuvres and further words, in a folder with these bags and car.yaml."""
    monkeypatch.chdir(tmp_path)
    save_vehicle(tmp_path / "car.yaml", prototype())

    def call(manoeuvres: tuple[str, ...], *words: str):
        for name in manoeuvres:
            write_bag(tmp_path / name, driven(prototype(), name))
        return CliRunner().invoke(main, ["explain", *manoeuvres, "--vehicle", "car.yaml", "--report", "answer", *words])

    return call


def test_recordings_that_tell_nothing_give_an_answer_that_says_why(called, tmp_path):
    result = called(("straight",), "--next")
    assert result.exit_code == 0
    assert "straight ahead at constant speed" in result.output
    assert "No next test" in result.output
    assert json.loads((tmp_path / "answer/explain.json").read_text())["verdict"] == "not_assessable"
    assert "straight ahead" in (tmp_path / "answer/report.html").read_text()
    assert not (tmp_path / "answer/vehicle.extended.yaml").exists()


@pytest.mark.exam
def test_an_answer_that_leaves_something_open_says_which_test_would_tell(called, tmp_path):
    """A drive in other directions shows whether rolling or a slope holds the car back."""
    rolling_hard = having(prototype(), rolling_resistance={"coefficient": 0.012})
    for name in ("sweep", "slalom"):
        write_bag(tmp_path / name, driven(rolling_hard, name))
    save_vehicle(tmp_path / "believed.yaml", wrong(prototype()))
    result = called((), "sweep", "slalom", "--vehicle", "believed.yaml", "--next")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "answer/explain.json").read_text())
    assert {"rolling_resistance", "road_grade"} <= set(found["answer_set"])
    best, second, *_ = json.loads((tmp_path / "answer/next.json").read_text())["tests"]
    assert (best["id"], best["opposite"]) == ("accelerate_and_brake", True)
    assert best["d_prime"] > 2 * second["d_prime"]
    assert found["would_separate"] == best
    assert f"Drive: {best['manoeuvre']}" in result.output
    assert [one["id"] for one in found["effects"] if one["would_separate"]] == found["answer_set"]
    assert f"{best['manoeuvre']}; watch the" in (tmp_path / "answer/report.html").read_text()


def test_a_recording_that_proves_itself_is_refused(called):
    assert "hold the same measurements" in called(("slalom",), "--hold-out", "slalom").output


@pytest.mark.parametrize("command", ["explain", "tune"])
def test_everything_behind_hold_out_is_held_out_as_a_shell_writes_out_a_pattern(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in "abcdefg":
        (tmp_path / name).touch()
    line = ["a", "--hold-out", "b", "c", "--vehicle", "car.yaml", "d", "--hold-out", "e", "--hold-out=f", "g"]
    line += ["--output", "tuned.yaml"] if command == "tune" else []
    params = main.commands[command].make_context(command, line).params
    assert [path.name for path in params["recordings"]] == ["a", "d"]
    assert [path.name for path in params["held_out"]] == ["b", "c", "e", "f", "g"]


def test_what_cannot_be_read_is_an_error_without_a_traceback(called, tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    result = called((), "broken.mcap")
    assert result.exit_code != 0
    assert isinstance(result.exception, SystemExit)
    assert "broken.mcap" in result.output


def test_a_report_that_cannot_be_written_is_said_before_anything_is_searched(called, tmp_path):
    (tmp_path / "taken").touch()
    result = called(("slalom",), "--report", "taken")
    assert isinstance(result.exception, SystemExit)
    assert "Directory 'taken' is a file" in result.output
    assert "searching" not in result.output


def test_recordings_that_are_called_alike_are_told_apart_by_their_folders():
    names = distinct_names([Stretch(Path(path)) for path in ("monday/lap", "tuesday/lap.mcap", "tuesday/other")])
    assert names == {Path("monday/lap"): "monday/lap", Path("tuesday/lap.mcap"): "tuesday/lap.mcap"}


@pytest.mark.parametrize(
    ("given", "begin", "end"),
    [("lap.mcap@207:310", 207.0, 310.0), ("lap.mcap@:12.5", None, 12.5), ("lap.mcap@3:", 3.0, None)],
)
def test_a_recording_may_be_a_part_of_one(given, begin, end, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lap.mcap").touch()
    Path("odd@name").touch()
    assert STRETCH.convert(given, None, None) == Stretch(Path("lap.mcap"), begin, end)
    assert STRETCH.convert("odd@name", None, None) == Stretch(Path("odd@name"))
    for impossible in ("lap.mcap@a:b", "lap.mcap@5:2", "none.mcap@1:2"):
        with pytest.raises(click.BadParameter):
            STRETCH.convert(impossible, None, None)


def test_of_a_part_of_a_recording_nothing_else_is_read(tmp_path):
    path = tmp_path / "slalom"
    write_bag(path, driven(prototype(), "slalom"))
    part = read(Stretch(path, 3.0, 9.0))
    assert part.name == "slalom@3:9"
    assert part.duration == pytest.approx(6.0, abs=0.3)
    with pytest.raises(InputError, match="nothing was recorded then; slalom lasts from 0 to 13"):
        read(f"{path}@100:")


def test_what_would_mend_a_recording_is_told_and_done_when_the_user_agrees(tmp_path):
    recording = driven(prototype(), "sweep", duration=15.0)
    imu = recording["imu/data"]
    columns = {**imu.columns, "linear_acceleration": imu.columns["linear_acceleration"] * [1.0, -1.0, 1.0]}
    wrong = replace(recording, channels={**recording.channels, "imu/data": replace(imu, columns=columns)})
    found = explain_recordings([wrong], prototype(), assume=["imu_roll_misalignment"]).answer
    assert "Left out of the comparison: in sweep, imu/data: the lateral acceleration is against" in found.sentence
    assert "lateral_acceleration" not in found.fit
    assert any("left is −y" in remark and "--mend" in remark for remark in found.remarks)
    mended = explain_recordings([wrong], prototype(), assume=["imu_roll_misalignment"], mend=True).answer
    assert "lateral_acceleration" in mended.fit
    assert "Left out" not in mended.sentence
