"""The `vsense` command as its users meet it: exit codes, messages, files."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.demo import Job, run_demo
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder
from vsense_ros.files.schema import json_schema, parameter_rows
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Channel, Recording

START = 1_700_000_000_000_000_000
SPEED = 15.0  # [m/s]


def vsense(*arguments: object, **environment: str) -> Result:
    return CliRunner(env=environment).invoke(main, [str(argument) for argument in arguments])


def straight_drive(seconds: float = 3.0) -> Recording:
    """East at constant speed: IMU, GNSS, wheel speeds, steering, and the reference."""
    random = np.random.default_rng(1)

    def channel(topic: str, kind: str, rate: float, frame: str, names=(), child="", **columns) -> Channel:
        count = int(seconds * rate)
        stamp = START + (np.arange(count) / rate * 1e9).astype(np.int64)
        filled = {name: np.array([make(t) for t in np.arange(count) / rate], float) for name, make in columns.items()}
        return Channel(topic, kind, stamp, stamp, filled, frame, names, child)

    wheels = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    level = [0.0, 0.0, 0.0, 1.0]
    degrees = 360.0 / (2.0 * np.pi * 6_378_137.0)
    channels = [
        channel(
            "imu/data",
            "sensor_msgs/msg/Imu",
            100.0,
            "imu_link",
            orientation=lambda t: level,
            orientation_covariance=lambda t: [-1.0] + [0.0] * 8,
            angular_velocity=lambda t: random.normal(0.0, 1e-3, 3),
            angular_velocity_covariance=lambda t: [0.0] * 9,
            linear_acceleration=lambda t: random.normal([0.0, 0.0, 9.81], 0.02),
            linear_acceleration_covariance=lambda t: [0.0] * 9,
        ),
        channel(
            "vehicle/wheel_speeds",
            "sensor_msgs/msg/JointState",
            50.0,
            "",
            wheels,
            position=lambda t: [],
            velocity=lambda t: [SPEED / 0.35] * 4,
            effort=lambda t: [],
        ),
        channel(
            "vehicle/steering",
            "sensor_msgs/msg/JointState",
            50.0,
            "",
            ("steering_wheel",),
            position=lambda t: [0.0],
            velocity=lambda t: [],
            effort=lambda t: [],
        ),
        channel(
            "gps/fix",
            "sensor_msgs/msg/NavSatFix",
            10.0,
            "gnss_link",
            status=lambda t: [0.0],
            service=lambda t: [1.0],
            latitude=lambda t: [0.0],
            longitude=lambda t: [SPEED * t * degrees],
            altitude=lambda t: [0.0],
            position_covariance=lambda t: np.eye(3).ravel(),
            position_covariance_type=lambda t: [2.0],
        ),
        channel(
            "gps/velocity",
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            10.0,
            "map",
            linear=lambda t: [SPEED, 0.0, 0.0],
            angular=lambda t: [0.0] * 3,
            covariance=lambda t: (np.eye(6) * 0.01).ravel(),
        ),
        channel(
            "reference/odometry",
            "nav_msgs/msg/Odometry",
            50.0,
            "map",
            child="cog",
            position=lambda t: [SPEED * t, 0.0, 0.0],
            orientation=lambda t: level,
            pose_covariance=lambda t: [0.0] * 36,
            linear=lambda t: [SPEED, 0.0, 0.0],
            angular=lambda t: [0.0] * 3,
            twist_covariance=lambda t: [0.0] * 36,
        ),
    ]
    return Recording({found.topic: found for found in channels}, name="straight")


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "straight"
    write_bag(path, straight_drive())
    return path


def refused(result: Result, *words: str) -> None:
    """One message on stderr, exit code 2."""
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert result.stderr.count("vsense: ") == 1
    for word in words:
        assert word in result.stderr


def test_help_loads_nothing_heavy():
    check = "import sys; import vsense_ros.cli; print(*sorted({'numpy', 'casadi', 'rich', 'yaml'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == ""


def test_every_command_explains_itself_with_examples():
    for name, command in main.commands.items():
        result = vsense(name, "--help")
        assert result.exit_code == 0
        assert re.search(r"Examples:\s+vsense", result.output), name
        assert command.get_short_help_str(), name


def test_the_version_is_told():
    assert re.fullmatch(r"vsense (\d+\.\d+\.\d+|.*sources.*)\n", vsense("--version").output)


def test_a_run_leaves_bag_summary_picture_and_report(bag, tmp_path):
    result = vsense("run", bag, "--vehicle", "rav4", "--out", tmp_path / "out", "--report")
    assert result.exit_code == 0, result.output
    assert "longitudinal velocity" in result.stdout
    assert "real-time factor" in result.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "output",
        "summary.json",
        "picture.png",
        "picture.svg",
        "report.html",
    }
    assert "vsense/odometry" in read_bag(tmp_path / "out" / "output")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (drive,) = summary.values()
    assert drive["signals"]["speed"]["rmse"] < 0.5
    assert drive["signals"]["speed"]["unit"] == "m/s"


def test_a_vehicle_that_is_not_there_is_named_with_those_that_are(bag):
    refused(vsense("run", bag, "--vehicle", "tractor"), "tractor", "rav4")


def test_a_bad_vehicle_file_is_told_with_file_line_and_key(bag, tmp_path):
    text = (shared_folder("config") / "vehicles" / "rav4.yaml").read_text()
    broken = tmp_path / "broken.yaml"
    broken.write_text(re.sub(r"\bmass: [0-9.]+", "mass: -5.0", text, count=1))
    refused(vsense("run", bag, "--vehicle", broken), "broken.yaml:", "mass", "-5")


def test_what_is_no_recording_is_refused_with_the_formats_that_are(tmp_path):
    nonsense = tmp_path / "letter.odt"
    nonsense.write_text("Dear reader,\n")
    refused(vsense("info", nonsense), "letter.odt", "mcap")


def test_an_empty_bag_is_refused_by_a_run(tmp_path):
    write_bag(tmp_path / "empty", Recording({}))
    refused(vsense("run", tmp_path / "empty", "--vehicle", "rav4", "--out", tmp_path / "out"))


def test_a_damaged_bag_is_used_and_its_losses_are_told(bag, tmp_path):
    data = next(bag.glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(0.7 * len(data))])
    result = vsense("info", tmp_path / "cut.mcap")
    assert result.exit_code == 0, result.output
    assert "Note: " in result.output


def test_an_import_writes_a_bag_and_does_not_replace_one_unasked(bag, tmp_path):
    assert vsense("import", bag, tmp_path / "copy").exit_code == 0
    assert set(read_bag(tmp_path / "copy").channels) == set(straight_drive().channels)
    refused(vsense("import", bag, tmp_path / "copy"), "copy")
    assert vsense("import", bag, tmp_path / "copy", "--overwrite").exit_code == 0


def test_an_option_that_the_importer_does_not_know_is_refused(bag, tmp_path):
    refused(vsense("import", bag, tmp_path / "copy", "--option", "colour=red"), "colour")
    result = vsense("import", bag, tmp_path / "copy", "--option", "colour")
    assert result.exit_code == 2
    assert "KEY=VALUE" in result.output


def test_a_folder_that_cannot_be_written_is_named(bag, tmp_path):
    (tmp_path / "file").write_text("")
    refused(vsense("run", bag, "--vehicle", "rav4", "--out", tmp_path / "file" / "out"), str(tmp_path / "file"))


def test_a_folder_where_a_file_is_to_be_written_is_refused_before_any_work(tmp_path):
    result = vsense("faults", "--out", tmp_path)
    assert result.exit_code == 2
    assert "is a directory" in result.output


def test_info_names_what_looks_wrong(tmp_path):
    drive = straight_drive()
    drive["vehicle/wheel_speeds"].columns["velocity"][:] *= 3.6
    write_bag(tmp_path / "kph", drive)
    result = vsense("info", tmp_path / "kph")
    assert result.exit_code == 0
    assert "Look at vehicle/wheel_speeds" in result.output
    assert "100 Hz" in result.output


def test_a_simulated_manoeuvre_is_a_bag_with_its_truth(tmp_path):
    out = tmp_path / "step_steer"
    result = vsense("simulate", "step_steer", "--vehicle", "prototype_real", "--out", out)
    assert result.exit_code == 0, result.output
    assert {"imu/data", "vehicle/steering", "reference/odometry", "reference/wheel_force/rr"} <= set(
        read_bag(out).channels
    )


def test_an_unknown_manoeuvre_lists_the_known_ones(tmp_path):
    result = vsense("simulate", "handstand", "--vehicle", "prototype_real", "--out", tmp_path / "bag")
    refused(result, "handstand", "step_steer")


def test_a_car_that_the_model_cannot_follow_is_told_in_one_sentence(tmp_path, monkeypatch):
    def overturned(*_, **__):
        raise FloatingPointError("Prototype: the motion left the model's range at 2.5 s")

    monkeypatch.setattr("vsense_ros.manoeuvre.simulate", overturned)
    result = vsense("simulate", "step_steer", "--vehicle", "prototype_real", "--out", tmp_path / "bag")
    refused(result, "Prototype: the motion left the model's range at 2.5 s of step_steer", "vehicle file")
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_that_cannot_be_is_refused_before_the_car_drives(seed, tmp_path, monkeypatch):
    monkeypatch.setattr("vsense_ros.manoeuvre.generate", lambda *_: pytest.fail("it drove"))
    result = vsense("simulate", "step_steer", "--vehicle", "prototype_real", "--out", tmp_path / "bag", "--seed", seed)
    assert result.exit_code == 2
    assert f"{seed} is not in the range 0<=x<=4294967295" in result.stderr


def test_suspension_tables_are_written_into_a_vehicle_file_whose_other_lines_stay(tmp_path):
    source = shared_folder("config") / "vehicles" / "prototype_real.yaml"
    target = tmp_path / "car.yaml"
    result = vsense("suspension", source, "--output", target, "--bump", 0.05, "--rebound", 0.04)
    assert result.exit_code == 0, result.output
    assert re.search(r"front +toe +\d+ +\d\.\d µrad", result.output)
    assert load_vehicle(target).suspension.travel == (-0.04, 0.05)
    written = target.read_text(encoding="utf-8")
    comments = [line for line in source.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert comments
    assert all(comment in written for comment in comments)
    plain, tabled = load_vehicle(source), load_vehicle(target)
    assert tabled.model_copy(update={"suspension": None}) == plain.model_copy(update={"suspension": None})


def test_suspension_tables_of_a_vehicle_without_linkages_are_refused(tmp_path):
    result = vsense("suspension", "rav4", "--output", tmp_path / "car.yaml")
    assert result.exit_code == 2
    assert "has no section `linkage`" in result.output
    assert not (tmp_path / "car.yaml").exists()


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("    tie_rod: {", "    tie_rod_length: 0.9\n    tie_rod: {", "linkage 'front' does not close: .* tie rod by"),
        ("[-0.14, -0.352, -0.0654]", "[-0.09, -0.32, 0.0996]", "12 constraints of which only .* are independent"),
        ("    steered: true\n", "", "cannot be steered: set `steered: true`"),
    ],
)
def test_suspension_tables_of_a_linkage_that_cannot_be_are_refused(tmp_path, old, new, complaint):
    text = (shared_folder("config") / "vehicles" / "prototype_real.yaml").read_text(encoding="utf-8")
    assert old in text
    text = text.replace(old, new, 1)
    if "-0.0654" in old:  # the fifth link where the fourth one is already
        text = text.replace("outer: [-0.14, -0.065, -0.068]", "outer: [-0.015, -0.085, 0.125]", 1)
    (tmp_path / "car.yaml").write_text(text, encoding="utf-8")
    result = vsense("suspension", tmp_path / "car.yaml")
    assert result.exit_code == 2
    assert re.search(complaint, result.output), result.output
    assert (tmp_path / "car.yaml").read_text(encoding="utf-8") == text


def test_datasets_that_are_not_here_are_listed_as_such(tmp_path):
    result = vsense("datasets", VSENSE_DATA=str(tmp_path))
    assert result.exit_code == 0
    assert re.search(r"genesis_oxts_can\s+no\s+MIT", result.output)
    refused(vsense("datasets", "fetch", "unknown", VSENSE_DATA=str(tmp_path)), "unknown", "genesis_oxts_can")


def expanded(key: str) -> set[str]:
    """`{a, b}.c` → a.c, b.c; the alternatives of a tagged union lose their tag."""
    parts = re.split(r"\{([^}]*)\}", re.sub(r" \([^)]*\)", "", key))
    choices = [[part] if index % 2 == 0 else part.split(", ") for index, part in enumerate(parts)]
    return {"".join(combination) for combination in itertools.product(*choices)}


def test_the_schema_has_every_number_of_a_vehicle_with_its_unit():
    vehicle = load_vehicle(shared_folder("config") / "vehicles" / "rav4.yaml")
    keys = {key: row for row in parameter_rows() for key in expanded(row.key)}
    for name in vehicle.values():
        assert keys[f"physics.{name}"].unit, name
    assert vsense("schema").output.count("\n") == len(parameter_rows()) + 2


def test_the_json_schema_accepts_what_a_vehicle_is_and_requires_what_it_needs():
    schema = json.loads(vsense("schema", "--json").stdout)
    assert schema == json.loads(json.dumps(json_schema()))
    assert {"name", "physics"} <= set(schema["required"])
    assert schema["additionalProperties"] is False


def missing() -> Path:
    raise InputError("the recording is at the bottom of the sea")


def test_the_demo_runs_what_it_can_and_says_what_it_left_out(bag, tmp_path):
    console = Console(record=True, width=110)
    jobs = (Job("gone", "A drive that is gone", "rav4", missing), Job("here", "A drive", "rav4", lambda: bag))
    drives = run_demo(tmp_path, console, through_ros=False, jobs=jobs)
    text = console.export_text()
    assert [drive.name for drive in drives] == ["here"]
    assert "A drive that is gone is left out: the recording is at the bottom of the sea" in text
    assert "without ROS" in text
    assert list(json.loads((tmp_path / "summary.json").read_text())) == ["here"]
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "here.png").exists()
    assert "vsense/odometry" in read_bag(tmp_path / "here")


def test_a_demo_of_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match="no drive"):
        run_demo(tmp_path, Console(record=True), through_ros=False, jobs=(Job("gone", "Gone", "rav4", missing),))


def test_processes_that_fail_are_told_at_the_end_and_the_drive_is_shown_without_them(bag, tmp_path, monkeypatch):
    def fail(**_: object) -> None:
        raise InputError("node observer ended with 1")

    monkeypatch.setattr("vsense_ros.demo.find_spec", lambda name: object())
    monkeypatch.setattr("vsense_ros.demo.run_through_ros", fail)
    job = Job("here", "A drive", "rav4", lambda: bag)
    with pytest.raises(InputError, match=r"here: its ROS processes failed.*node observer ended"):
        run_demo(tmp_path, Console(record=True), jobs=(job,))
    assert list(json.loads((tmp_path / "summary.json").read_text())) == ["here"]


def test_a_machine_without_ros_is_told_so(bag, tmp_path, monkeypatch):
    monkeypatch.setattr("vsense_ros.demo.find_spec", lambda name: None)
    console = Console(record=True, width=110)
    run_demo(tmp_path, console, jobs=(Job("here", "A drive", "rav4", lambda: bag),))
    assert "There is no ROS 2 on this machine" in console.export_text()
