"""A fleet of vehicles: what stands where, that nothing stops the rest, that nothing is done twice, what is told."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from distributed import Client
from rich.console import Console

from hidden import driven, having, prototype, wrong
from synthetic_findings import effect, finding, located, segment
from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.fleet import fleet
from vsense_ros.fleet import report as fleet_report
from vsense_ros.fleet.fleet import RecordingUse, Result
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.answer_schema import Answer
from vsense_ros.mismatch.explain import Explanation
from vsense_ros.model.vehicle import Vehicle

Progress = Callable[[float], None]


@pytest.fixture
def client() -> Iterator[Client]:
    with Client(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as client:
        yield client


def folder_of(root: Path, name: str, *recordings: str, vehicle: bool = True) -> Path:
    """A vehicle's folder whose recordings are unreadable."""
    folder = root / name
    folder.mkdir()
    if vehicle:
        save_vehicle(folder / "vehicle.yaml", prototype())
    for recording in recordings:
        (folder / recording).parent.mkdir(exist_ok=True)
        (folder / recording).write_bytes(b"not a bag")
    return folder


def result_of(member: fleet.Member, found: Answer, key: str = "", **reasons: str) -> Result:
    uses = [RecordingUse(name=n, role=role, reason=reasons.get(n, "")) for n, role, _ in member.recordings]
    return Result(key=key, vehicle=member.name, recordings=uses, outcome=found)


def test_each_folder_is_a_vehicle_with_its_recordings_and_those_it_is_proven_on(tmp_path):
    folder_of(tmp_path, "van", "a.mcap", "b.mcap", "held_out/c.mcap", "notes.txt")
    folder_of(tmp_path, "car", "a.mcap", vehicle=False)
    (tmp_path / ".cache").mkdir()
    (tmp_path / "empty").mkdir()
    car, van = fleet.members(tmp_path)
    assert (car.name, car.vehicle, list(car.training)) == ("car", None, ["a.mcap"])
    assert van.vehicle == tmp_path / "van" / "vehicle.yaml"
    assert van.recordings == [
        ("a.mcap", "training", tmp_path / "van/a.mcap"),
        ("b.mcap", "training", tmp_path / "van/b.mcap"),
        ("held_out/c.mcap", "held_out", tmp_path / "van/held_out/c.mcap"),
    ]


def test_a_vehicle_file_beside_the_folders_is_for_all_that_have_none(tmp_path):
    save_vehicle(tmp_path / "vehicle.yaml", prototype())
    folder_of(tmp_path, "one", "a.mcap", vehicle=False)
    folder_of(tmp_path, "two", "a.mcap")
    one, two = fleet.members(tmp_path)
    assert one.vehicle == tmp_path / "vehicle.yaml"
    assert two.vehicle == tmp_path / "two" / "vehicle.yaml"


@pytest.mark.parametrize("name", ["", "missing"])
def test_a_folder_without_vehicles_is_refused_with_what_was_expected(tmp_path, name):
    with pytest.raises(InputError, match=r"one folder for each vehicle.*vehicle\.yaml.*held_out"):
        fleet.members(tmp_path / name)


@pytest.mark.parametrize("place", [".", "out", "out/explain", "van"])
def test_results_are_refused_among_the_vehicles_of_which_they_would_be_one_the_next_time(tmp_path, place):
    cars = tmp_path / "cars"
    cars.mkdir()
    folder_of(cars, "van", "a.mcap")
    refused = CliRunner().invoke(main, ["explain", "--fleet", str(cars), "--report", str(cars / place)])
    assert refused.exit_code == 2
    assert f"{cars / place}: expected a folder outside of {cars}" in refused.stderr
    assert "--report" in refused.stderr
    assert {path.name for path in cars.rglob("*")} == {"van", "vehicle.yaml", "a.mcap"}


@pytest.mark.parametrize("place", ["out", "out/explain"])
def test_results_that_lie_among_the_vehicles_are_no_vehicle(tmp_path, place):
    folder_of(tmp_path, "van", "a.mcap")
    fleet_report.write([], tmp_path / place)
    with pytest.raises(InputError, match=r"out: expected a vehicle, found results of a fleet .* move them elsewhere"):
        fleet.members(tmp_path)


def test_a_report_that_cannot_be_written_is_told_before_the_search(tmp_path):
    (tmp_path / "cars").mkdir()
    folder_of(tmp_path / "cars", "van", "a.mcap")
    (tmp_path / "file").write_text("", encoding="utf-8")
    for place in ("file", "file/out"):
        with pytest.raises(InputError, match=f"{place}: expected a folder that results can be written to"):
            fleet.make_room(tmp_path / place, tmp_path / "cars")


def test_a_vehicle_whose_results_cannot_be_written_is_a_row_with_its_reason_and_is_not_searched(
    tmp_path, client, monkeypatch
):
    folder_of(tmp_path, "car", "a.mcap")
    (car,) = fleet.members(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "car").write_text("a file", encoding="utf-8")
    searched: list[int] = []
    monkeypatch.setattr(
        fleet, "explain_recordings", lambda *_, **__: searched.append(1) or Explanation(finding("no_mismatch"))
    )
    (result,) = fleet.explain_fleet([car], tmp_path / "out", client)
    assert result.outcome.verdict == "failed"
    assert "out/car: expected a folder that results can be written to" in result.outcome.sentence
    assert not searched


def test_what_fails_and_cannot_be_written_down_is_done_once(tmp_path, client):
    folder_of(tmp_path, "car", "a.mcap")

    def work(member: fleet.Member, out: Path, progress: Progress) -> Result:
        with (tmp_path / "done").open("a", encoding="utf-8") as file:
            file.write("once\n")
        out.parent.mkdir(exist_ok=True)
        out.write_text("a file in its place", encoding="utf-8")
        raise OSError("no space left")

    (result,) = fleet.explain_fleet(fleet.members(tmp_path), tmp_path / "out", client, work)
    assert result.outcome.verdict == "failed"
    assert result.outcome.sentence == "OSError: no space left"
    assert (tmp_path / "done").read_text(encoding="utf-8") == "once\n"


def test_what_happens_with_one_vehicle_does_not_stop_the_others_and_results_keep_their_order(tmp_path, client):
    for name in ("a", "b", "c"):
        folder_of(tmp_path, name, "drive.mcap")
    members = fleet.members(tmp_path)

    def work(member: fleet.Member, out: Path, progress: Progress) -> Result:
        progress(0.5)
        if member.name == "b":
            raise ZeroDivisionError("by chance")
        return result_of(member, finding("no_mismatch"))

    shares: list[float] = []
    results = fleet.explain_fleet(members, tmp_path / "out", client, work, shares.append)
    assert [result.vehicle for result in results] == ["a", "b", "c"]
    assert [result.outcome.verdict for result in results] == ["no_mismatch", "failed", "no_mismatch"]
    assert "ZeroDivisionError: by chance" in results[1].outcome.sentence
    assert "ZeroDivisionError" in (tmp_path / "out" / "b" / "fault.txt").read_text(encoding="utf-8")
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


@pytest.mark.exam
def test_a_process_that_dies_costs_its_own_vehicle_alone(tmp_path):
    for name in ("a", "b"):
        folder_of(tmp_path, name, "drive.mcap")
    members = fleet.members(tmp_path)

    def work(member: fleet.Member, out: Path, progress: Progress) -> Result:
        if member.name == "a":
            os._exit(11)
        threads = os.environ["OMP_NUM_THREADS"]
        return result_of(member, finding("no_mismatch", sentence=f"threads: {threads}"))

    with fleet.workers(None, 1) as client:
        dead, alive = fleet.explain_fleet(members, tmp_path / "out", client, work)
    assert dead.outcome.verdict == "failed"
    assert "died" in dead.outcome.sentence
    assert alive.outcome.sentence == "threads: 1"


def test_an_absent_scheduler_is_one_message():
    with pytest.raises(InputError, match="no Dask scheduler at nonsense"), fleet.workers("nonsense"):
        pass


def test_a_vehicle_without_a_file_and_one_with_a_bad_file_are_not_assessable(tmp_path):
    folder_of(tmp_path, "bad", "a.mcap")
    (tmp_path / "bad" / "vehicle.yaml").write_text("name: [", encoding="utf-8")
    folder_of(tmp_path, "none", "a.mcap", vehicle=False)
    bad, none = (fleet.explain_member(member, tmp_path / "out" / member.name) for member in fleet.members(tmp_path))
    assert bad.outcome.verdict == none.outcome.verdict == "not_assessable"
    assert "not valid YAML" in bad.outcome.sentence
    assert "no vehicle.yaml" in none.outcome.sentence


def test_an_unreadable_recording_is_a_row_with_its_reason(tmp_path):
    folder_of(tmp_path, "car", "broken.mcap")
    (member,) = fleet.members(tmp_path)
    result = fleet.explain_member(member, tmp_path / "out" / "car")
    assert result.outcome.verdict == "not_assessable"
    vehicle, recording = fleet_report.rows([result])
    assert vehicle["recording"] is None
    assert recording["recording"] == "broken.mcap"
    assert "broken.mcap" in recording["reason"]


def test_what_was_done_of_the_same_files_is_taken_and_of_changed_ones_done_again(tmp_path, monkeypatch):
    folder = folder_of(tmp_path, "car", "broken.mcap")
    (member,) = fleet.members(tmp_path)
    out = tmp_path / "out" / "car"
    first = fleet.explain_member(member, out)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("done again")

    with monkeypatch.context() as patched:
        patched.setattr(fleet, "explain_recordings", never)
        assert fleet.explain_member(member, out) == first
        (folder / "broken.mcap").write_bytes(b"another bad bag")
        with pytest.raises(AssertionError, match="done again"):
            fleet.explain_member(member, out)
    (out / "result.json").write_text("{", encoding="utf-8")
    assert fleet.explain_member(member, out).key != first.key, "a damaged result is made anew"


def test_a_result_is_not_taken_together_with_the_report_of_other_recordings(tmp_path, monkeypatch):
    """A run that was stopped behind its report leaves no earlier result beside it."""
    folder = folder_of(tmp_path, "car", "lap")
    (member,) = fleet.members(tmp_path)
    out = tmp_path / "out"
    monkeypatch.setattr(fleet, "import_recording", lambda path: Recording({}, path.name))
    verdicts = iter(("no_mismatch", "ambiguous", "no_mismatch"))
    monkeypatch.setattr(fleet, "explain_recordings", lambda *_, **__: Explanation(finding(next(verdicts))))

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(fleet, "designed", stopped)
    fleet.explain_member(member, out)
    (folder / "lap").write_bytes(b"other")
    with pytest.raises(KeyboardInterrupt):
        fleet.explain_member(member, out)
    (folder / "lap").write_bytes(b"not a bag")
    assert fleet.explain_member(member, out).outcome.verdict == "no_mismatch"
    assert json.loads((out / "explain.json").read_text(encoding="utf-8"))["verdict"] == "no_mismatch"


def test_a_table_is_looked_at_again_when_it_is_said_anew_which_column_is_what(tmp_path):
    folder = folder_of(tmp_path, "car", "lap.csv")
    (folder / "lap.yaml").write_text("sign: 1", encoding="utf-8")
    (member,) = fleet.members(tmp_path)
    first = fleet.explain_member(member, tmp_path / "out").key
    assert fleet.explain_member(member, tmp_path / "out").key == first
    (folder / "lap.yaml").write_text("sign: -1", encoding="utf-8")
    assert fleet.explain_member(member, tmp_path / "out").key != first


def test_a_remark_on_a_part_of_a_recording_does_not_make_it_unused(tmp_path, monkeypatch):
    folder_of(tmp_path, "car", "lap", "lap_2")
    (member,) = fleet.members(tmp_path)
    remarks = ["lap: left out from 10 to 20 s: it spins", "lap_2: no steering angle; the recording is left out"]
    monkeypatch.setattr(fleet, "import_recording", lambda path: Recording({}, path.name))
    found = Explanation(finding("no_mismatch", remarks=remarks))
    monkeypatch.setattr(fleet, "explain_recordings", lambda *_, **__: found)
    reasons = {use.name: use.reason for use in fleet.explain_member(member, tmp_path / "out").recordings}
    assert reasons == {"lap": "", "lap_2": "no steering angle; the recording is left out"}


def test_a_recording_that_spoils_what_the_others_say_is_left_out_with_its_reason(tmp_path, monkeypatch):
    folder_of(tmp_path, "car", "lap", "lap_2", "held_out/lap")
    (member,) = fleet.members(tmp_path)

    def explain(
        training: list[Recording], car: Vehicle, held_out: list[Recording], progress: Progress, observe: bool
    ) -> Explanation:
        if any(recording.name == "lap_2" for recording in training):
            spun = "Nothing can be said: the car spins in lap_2."
            return Explanation(finding("not_assessable", sentence=spun, remarks=[]))
        return Explanation(finding("no_mismatch"))

    monkeypatch.setattr(fleet, "import_recording", lambda path: Recording({}, path.name))
    monkeypatch.setattr(fleet, "explain_recordings", explain)
    result = fleet.explain_member(member, tmp_path / "out")
    assert result.outcome.verdict == "no_mismatch"
    reasons = {use.name: use.reason for use in result.recordings}
    assert "spins" in reasons.pop("lap_2")
    assert set(reasons) == {"lap", "held_out/lap"}
    assert "spins" not in "".join(reasons.values())


def fleet_of_findings(root: Path) -> list[Result]:
    for name in ("a", "b", "c", "d"):
        folder_of(root, name, "one.mcap", "two.mcap", "held_out/three.mcap")
    a, b, c, d = fleet.members(root)
    segments = [
        segment("one.mcap", 0.0, 9.0, 0.5),
        segment("one.mcap", 9.0, 19.0, 0.25),
        segment("two.mcap", 0.0, 9.0, 0.25),
    ]
    named = finding("named", located=located("named").with_(segments=segments))
    return [
        result_of(a, named),
        result_of(b, finding("ambiguous"), **{"two.mcap": "no steering angle"}),
        result_of(c, finding("no_mismatch")),
        fleet._failed(d, "the process that worked on it died"),
    ]


def test_the_table_has_a_row_for_each_vehicle_and_for_each_recording_and_effect(tmp_path):
    fleet_report.write(fleet_of_findings(tmp_path), tmp_path / "out")
    rows = pq.read_table(tmp_path / "out" / "fleet.parquet").to_pylist()
    of_a = [row for row in rows if row["vehicle"] == "a"]
    assert [(row["recording"], row["effect"]) for row in of_a] == [
        (None, None),
        ("one.mcap", "imu_roll_misalignment"),
        ("two.mcap", "imu_roll_misalignment"),
        ("held_out/three.mcap", "imu_roll_misalignment"),
    ]
    assert of_a[1]["error_share"] == pytest.approx(0.75)
    assert of_a[1]["parameters"] == [{"name": "angle", "unit": "rad", "value": 0.0123, "low": 0.0110, "high": 0.0136}]
    of_b = [(row["recording"], row["effect"]) for row in rows if row["vehicle"] == "b"]
    effects = ("imu_roll_misalignment", "accelerometer_bias")
    assert of_b == [
        (None, None),
        *(("one.mcap", effect) for effect in effects),
        ("two.mcap", None),
        *(("held_out/three.mcap", effect) for effect in effects),
    ]
    assert {row["verdict"] for row in rows if row["vehicle"] == "d"} == {"failed"}


def test_the_summary_says_which_effect_on_which_vehicle(tmp_path):
    results = fleet_of_findings(tmp_path)
    fleet_report.write(results, tmp_path / "out")
    with (tmp_path / "out" / "fleet.csv").open(encoding="utf-8") as file:
        sheet = {line["vehicle"]: line for line in csv.DictReader(file)}
    assert sheet["a"]["effects"].startswith("imu_roll_misalignment")
    assert (sheet["b"]["recordings"], sheet["b"]["unused"]) == ("3", "1")
    page = (tmp_path / "out" / "fleet.html").read_text(encoding="utf-8")
    assert "4 vehicles: 1 named, 1 ambiguous, 1 no mismatch, 1 failed" in page
    assert "no steering angle" in page
    console = Console(record=True, width=110, file=open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    fleet_report.printed(results, console)
    said = console.export_text()
    assert "imu_roll_misalignment: 2 of 4 vehicles (a, b)" in said
    assert "Not used: b/two.mcap: no steering angle" in said


def test_a_vehicle_that_was_not_explained_is_not_linked_to_the_report_of_an_earlier_run(tmp_path):
    folder_of(tmp_path, "failed", "drive.mcap")
    folder_of(tmp_path, "found", "drive.mcap")
    folder_of(tmp_path, "refused", "drive.mcap", vehicle=False)
    failed, found, refused = fleet.members(tmp_path)
    out = tmp_path / "out"
    for member in (failed, found, refused):
        (out / member.name).mkdir(parents=True)
        (out / member.name / "report.html").write_text("an earlier one", encoding="utf-8")
    results = [
        fleet._failed(failed, "the process that worked on it died"),
        result_of(found, finding("no_mismatch"), key="of its files"),
        fleet.explain_member(refused, out / "refused"),
    ]
    fleet_report.write(results, out)
    assert re.findall('href="(.*report.html)"', (out / "fleet.html").read_text(encoding="utf-8")) == [
        "found/report.html"
    ]


def test_form_and_range_of_an_effect_are_told_of_a_fleet(tmp_path):
    folder_of(tmp_path, "a", "one.mcap", "two.mcap")
    (a,) = fleet.members(tmp_path)
    places = [{"stretch": 0.0, "distance": d, "value": v, "interval_90": [v, v]} for d, v in ((0, -0.08), (50, 0.06))]
    bank = effect("road_bank", 0.5, accepted=True, form="on a plane", profile=places)
    results = [result_of(a, finding("named", effects=[bank]))]
    fleet_report.write(results, tmp_path / "out")
    told = "road_bank on a plane (angle between −3.9° and +4.1° along the road)"
    assert told in (tmp_path / "out" / "fleet.html").read_text(encoding="utf-8")
    assert told in (tmp_path / "out" / "fleet.csv").read_text(encoding="utf-8")
    row = pq.read_table(tmp_path / "out" / "fleet.parquet").to_pylist()[1]
    assert (row["effect"], row["place"]) == ("road_bank", "on a plane")


@pytest.mark.exam
def test_a_fleet_with_a_dragging_brake_and_a_bad_bag_is_explained_and_then_known(tmp_path):
    dragging = having(prototype(), brake_drag={"fl": 30.0})
    for name, true in (("dragging", dragging), ("sound", prototype())):
        folder = tmp_path / "fleet" / name
        folder.mkdir(parents=True)
        save_vehicle(folder / "vehicle.yaml", wrong(prototype()))
        for manoeuvre in ("sweep", "slalom"):
            write_bag(folder / manoeuvre, driven(true, manoeuvre))
        write_bag(folder / "held_out" / "brake", driven(true, "brake"))
    broken = tmp_path / "fleet" / "dragging" / "broken"
    shutil.copytree(tmp_path / "fleet" / "dragging" / "slalom", broken)
    for bag in broken.glob("*.mcap"):
        bag.write_bytes(bag.read_bytes()[:100])
    members = fleet.members(tmp_path / "fleet")
    with fleet.workers(None, 2) as client:
        results = fleet.explain_fleet(members, tmp_path / "out", client)
        again = fleet.explain_fleet(members, tmp_path / "out", client)
    assert again == results
    found, sound = (result.outcome for result in results)
    assert (found.verdict, sound.verdict) == ("named", "no_mismatch")
    (effect,) = found.in_answer
    assert (effect.id, effect.wheel) == ("brake_drag", "fl")
    assert {use.name for use in results[0].recordings if use.reason} == {"broken"}
    assert (tmp_path / "out" / "dragging" / "vehicle.extended.yaml").is_file()


def test_processes_of_this_machine_take_work_from_nobody_without_the_key_of_the_run() -> None:
    with fleet.workers(None, 1) as client:
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises(OSError, match=r"scheduler|connect|Timed out|closed"):
            Client(address.replace("tls://", "tcp://"), timeout="2s")
        port = client.scheduler_info()["services"]["dashboard"]
        with pytest.raises(HTTPError, match="404"):  # of the HTTP server, which asks for no key
            urlopen(f"http://127.0.0.1:{port}/info/main/workers.html", timeout=5.0)
