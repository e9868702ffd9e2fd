"""The project folder and its jobs: nothing is lost, nothing is computed twice, nothing outside is read."""

from __future__ import annotations

import json
import os
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.studio import actions
from vsense_ros.studio.jobs import Job, Jobs, Status
from vsense_ros.studio.project import Drive, Project
from vsense_ros.studio.worker import run_job

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "step_steer"


def test_the_state_survives_a_restart(tmp_path: Path) -> None:
    project = Project(tmp_path)
    project.state.drives.append(Drive(str(BAG), held_out=True))
    project.remember("estimate", "abc")
    again = Project(tmp_path)
    assert again.state.drives == [Drive(str(BAG), held_out=True)]
    assert again.state.results == {"estimate": ["abc"]}


def test_a_state_that_cannot_be_read_is_kept_and_said(tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("{ no json", encoding="utf-8")
    project = Project(tmp_path)
    assert "could not be read" in project.state.settings["notice"]
    assert (tmp_path / "state.unreadable.json").read_text(encoding="utf-8") == "{ no json"


@pytest.mark.parametrize("path", ["/etc/passwd", "../../etc/passwd", "link"])
def test_files_outside_of_the_opened_folders_are_refused(tmp_path: Path, path: str) -> None:
    project = Project(tmp_path / "project", [tmp_path / "opened"])
    (tmp_path / "opened").mkdir()
    (tmp_path / "opened" / "link").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="not in a folder that was opened"):
        project.inside(tmp_path / "opened" / path if path != "/etc/passwd" else path)


def test_an_upload_lands_in_the_project_whatever_its_name_is(tmp_path: Path) -> None:
    project = Project(tmp_path / "project")
    for name in ("../../evil.csv", "/tmp/evil.csv", "..\\evil.csv"):
        assert project.upload_path(name).parent == project.folder / "uploads"


def test_the_key_of_a_job_follows_the_content_of_its_files(tmp_path: Path) -> None:
    jobs = Jobs(Project(tmp_path / "project"))
    file = tmp_path / "a.csv"
    file.write_text("1", encoding="utf-8")
    first = jobs.key("read", {}, {"a": file})
    assert jobs.key("read", {}, {"a": file}) == first
    file.write_text("2", encoding="utf-8")
    os.utime(file, ns=(1, 1))
    assert jobs.key("read", {}, {"a": file}) != first
    assert jobs.key("read", {"b": 1}, {"a": file}) != jobs.key("read", {}, {"a": file})


def test_a_folder_without_rights_offers_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(folder: Path) -> Iterator[Path]:
        if folder.name == "closed":  # as for everybody but root
            raise PermissionError(13, "Permission denied")
        return listed(folder)

    listed = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", refused)
    (tmp_path / "closed").mkdir()
    assert not any("closed" in path for path in Project(tmp_path / "project", [tmp_path / "closed"]).recordings())


@pytest.mark.slow
def test_a_log_that_cannot_be_read_is_not_read_again_and_again_but_when_it_is_asked_for(tmp_path: Path) -> None:
    jobs = Jobs(Project(tmp_path / "project"))
    file = tmp_path / "notes.txt"
    file.write_text("hello", encoding="utf-8")
    try:
        job = jobs.start("read", {"path": str(file)}, {"recording": file})
        while job.status is Status.RUNNING:
            time.sleep(0.05)
        assert job.status is Status.FAILED
        assert jobs.start("read", {"path": str(file)}, {"recording": file}, again=False).status is Status.FAILED
        assert jobs.start("read", {"path": str(file)}, {"recording": file}).status is Status.RUNNING
    finally:
        jobs.close()


def _job(tmp_path: Path, kind: str, options: dict[str, object]) -> Job:
    folder = tmp_path / "job"
    folder.mkdir()
    (folder / "task.json").write_text(json.dumps({"kind": kind, "options": options}), encoding="utf-8")
    return Job(folder)


def test_a_recording_is_read_into_curves_topics_and_path(tmp_path: Path) -> None:
    job = _job(tmp_path, "read", {"path": str(BAG)})
    run_job(job.folder)
    assert job.status is Status.DONE, job.error
    assert {"imu/data", "gps/fix"} <= {one["topic"] for one in job.result["topics"]}


def test_a_job_that_fails_says_a_sentence_and_no_traceback(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("hello", encoding="utf-8")
    job = _job(tmp_path, "read", {"path": str(file)})
    run_job(job.folder)
    assert job.status is Status.FAILED
    assert "Traceback" not in job.error
    assert "notes.txt" in job.error


@pytest.mark.slow
def test_a_cancelled_job_ends_and_can_be_started_again(tmp_path: Path) -> None:
    project = Project(tmp_path / "project")
    jobs = Jobs(project)
    car = project.examples[0] / "prototype_model.yaml"
    options = {"recording": {"path": str(BAG)}, "vehicle": str(car), "filter": "error_ekf"}
    try:
        job = jobs.start("estimate", options, {"recording": BAG, "vehicle": car})
        assert job.status is Status.RUNNING
        job.cancel()
        assert job.status is Status.FAILED
        assert "Cancelled" in job.error
        assert jobs.start("estimate", options, {"recording": BAG, "vehicle": car}).key == job.key
        assert job.status is Status.RUNNING
        job.cancel()
    finally:
        jobs.close()


@pytest.mark.slow
def test_a_worker_that_is_killed_from_outside_leaves_an_interrupted_job(tmp_path: Path) -> None:
    project = Project(tmp_path / "project")
    jobs = Jobs(project)
    try:
        job = jobs.start("read", {"path": str(BAG)}, {"recording": BAG})
        os.kill(int((job.folder / "pid").read_text()), 9)
        for _ in range(100):
            if job.status is not Status.RUNNING:
                break
            time.sleep(0.05)
        assert job.status in (Status.INTERRUPTED, Status.DONE)
    finally:
        jobs.close()


def test_every_command_line_that_the_page_shows_is_one_that_the_command_takes(tmp_path: Path) -> None:
    drive, car = Drive(str(BAG)), "genesis"
    for name in ("log.csv", "car.dbc", "map.yaml"):
        (tmp_path / name).write_text("", encoding="utf-8")
    (tmp_path / "log").mkdir()  # as if the log had been imported
    mapped = Drive(str(tmp_path / "log.csv"), mapping=str(tmp_path / "map.yaml"), database=str(tmp_path / "car.dbc"))
    shown = [
        actions.new_vehicle(str(tmp_path / "car.yaml"), {"mass": 1395.0, "tyre": "205/55R16 91V", "driven": "front"}),
        actions.check_vehicle(car, [drive]),
        actions.info(drive),
        actions.join([drive, drive], str(tmp_path / "out")),
        actions.calibrate(car, [drive], str(tmp_path / "new.yaml")),
        actions.observability(car, drive, "integrated"),
        actions.run(car, drive, "error_ekf", mend=True, smooth=True),
        actions.identify(car, [drive], [drive], "best"),
        actions.explain(car, [drive], [drive], by_lap=True, mend=True, observe=False),
        actions.identify(car, [mapped], [drive], "single_track"),
    ]
    for action in shown:
        for line in action.command.splitlines():
            program, name, *arguments = shlex.split(line)
            assert program == "vsense"
            command = main.commands[name]
            with command.make_context(name, list(arguments)):
                pass  # it was parsed: every option is known and every file is there
        compile(action.python, "action", "exec")


def test_an_action_as_python_and_as_a_command_line_does_what_it_says(tmp_path: Path) -> None:
    values = {"name": "Hatch", "mass": 1395.0, "wheelbase": 2.63, "track": 1.54, "tyre": "205/55R16 91V"}
    by_python, by_command = tmp_path / "python.yaml", tmp_path / "command.yaml"
    exec(actions.new_vehicle(str(by_python), values).python, {})
    arguments = shlex.split(actions.new_vehicle(str(by_command), values).command)[1:]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    python, command = (vs.load_vehicle(path).model_dump(exclude={"source"}) for path in (by_python, by_command))
    assert python == command
    checked = CliRunner().invoke(main, shlex.split(actions.check_vehicle(str(by_python)).command)[1:])
    assert checked.exit_code in (0, 1), checked.output
