"""CSV and MDF4 by a column mapping."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError

MAPPING = """
time: {column: t, unit: ms, start: 2020-01-01T00:00:00Z}
delimiter: ";"
decimal: ","
topics:
  imu/data:
    angular_velocity: [null, null, {column: yaw_rate, unit: deg/s, sign: -1}]
    linear_acceleration: [{column: ax, unit: g}, null, null]
  vehicle/wheel_speeds:
    velocity:
      wheel_fl: {column: v_fl, unit: km/h, radius: 0.25}
      wheel_rr: {column: n_rr, unit: rpm}
  vehicle/steering:
    position: {steering_wheel: {column: delta, unit: deg, scale: 2, offset: -10}}
  gps/fix: {latitude: {column: lat, unit: deg}, longitude: {column: lon, unit: min}, altitude: null}
  gps/velocity: {speed: {column: v, unit: km/h}, course: {column: heading, unit: deg}}
  reference/odometry: {yaw: {column: heading, unit: deg}, linear: [{column: v, unit: km/h}, null, null]}
"""
TABLE = """t;yaw_rate;ax;v_fl;n_rr;delta;lat;lon;v;heading
0;90,0;0,5;9;60;5;48,5;660;36;90
10;-90,0;1;18;120;50;;;;
20;0;0;0;0;0;49;661;72;180
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    file = tmp_path / "drive.csv"
    file.write_text(TABLE)
    (tmp_path / "drive.yaml").write_text(MAPPING)
    return file


def test_units_signs_scales_and_offsets_become_si(table: Path) -> None:
    recording = import_recording(table)
    imu = recording["imu/data"].columns
    np.testing.assert_allclose(imu["angular_velocity"][:, 2], [-np.pi / 2, np.pi / 2, 0])
    np.testing.assert_allclose(imu["linear_acceleration"][:, 0], [4.903325, 9.80665, 0])
    assert np.isnan(imu["angular_velocity"][:, 0]).all()
    wheels = recording["vehicle/wheel_speeds"]
    assert wheels.names == ("wheel_fl", "wheel_rr")
    np.testing.assert_allclose(wheels.columns["velocity"], [[10, 2 * np.pi], [20, 4 * np.pi], [0, 0]])
    np.testing.assert_allclose(recording["vehicle/steering"].columns["position"][:, 0], np.radians([0.0, 90.0, -10.0]))
    assert recording["imu/data"].stamp.tolist() == [1_577_836_800_000_000_000 + i * 10_000_000 for i in range(3)]


def test_rows_without_a_value_of_a_topic_are_no_message_of_it(table: Path) -> None:
    recording = import_recording(table)
    assert len(recording["gps/fix"]) == len(recording["gps/velocity"]) == 2
    np.testing.assert_allclose(recording["gps/fix"].columns["longitude"][:, 0], [11.0, 661 / 60])
    np.testing.assert_allclose(recording["gps/velocity"].columns["linear"][:, :2], [[10, 0], [0, -20]], atol=1e-12)
    assert np.isnan(recording["gps/fix"].columns["altitude"]).all()


def test_a_yaw_angle_becomes_an_orientation(table: Path) -> None:
    orientation = import_recording(table)["reference/odometry"].columns["orientation"]
    np.testing.assert_allclose(orientation[0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("unit: deg/s", "unit: furlong", r"'yaw_rate' has unit 'furlong', expected an angular velocity: rad/s, deg/s"),
        ("unit: g}", "unit: deg}", r"imu/data.linear_acceleration: column 'ax' has unit 'deg', expected an accel"),
        (", radius: 0.25", "", "or a speed with a radius"),
        ("radius: 0.25", "radius: -1", r"topics.vehicle/wheel_speeds.velocity.wheel_fl.radius: .* greater than 0"),
        ("sign: -1", "sign: 2", r"topics\.imu/data\.angular_velocity\.2\.sign: .*found 2"),
        ("column: ax, ", "", r"topics.imu/data.linear_acceleration.0.column: Field required"),
        ("wheel_fl:", "wheel_front:", "unknown 'wheel_front'; known: wheel_fl, wheel_fr"),
        ("imu/data:", "imu:", r"'imu' is no topic of this project; known: imu/data"),
        ("column: v_fl", "column: speed_fl", r"no column 'speed_fl'; found: t, yaw_rate"),
        ("column: t, ", "", "names no time column"),
        ("unit: ms", "unit: fortnight", "'fortnight' is no unit of time"),
        ('delimiter: ";"', 'delimiter: ","', r"no column .*\(delimiter ','\)"),
        ("topics:", "themes:", "Field required"),
        ("time: {", "time: {{", "not valid YAML"),
    ],
)
def test_a_wrong_mapping_says_where_and_what_is_allowed(table: Path, old: str, new: str, message: str) -> None:
    mapping = table.with_suffix(".yaml")
    assert old in MAPPING
    mapping.write_text(MAPPING.replace(old, new))
    with pytest.raises(InputError, match=message):
        import_recording(table)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (TABLE.replace("-90,0", "left"), r"drive\.csv, line 3, column 'yaw_rate': expected a number, found 'left'"),
        (TABLE.replace("\n10;", "\n;"), r"line 3: the time column 't' is empty"),
        ("", "the file is empty"),
        (TABLE.splitlines()[0] + "\n", "no rows below the header"),
    ],
)
def test_a_bad_cell_is_named_with_line_and_column(table: Path, content: str, message: str) -> None:
    table.write_text(content)
    with pytest.raises(InputError, match=message):
        import_recording(table)


def test_a_table_without_mapping_says_what_is_needed(table: Path) -> None:
    table.with_suffix(".yaml").unlink()
    with pytest.raises(InputError, match=r"Expected a mapping file drive\.yaml beside it"):
        import_recording(table)


def measurement(path: Path, signals: dict[str, tuple[Any, Any]]) -> Path:
    asammdf = pytest.importorskip("asammdf")
    from datetime import UTC, datetime

    with asammdf.MDF(version="4.10") as file:
        file.header.start_time = datetime(2020, 1, 1, tzinfo=UTC)
        for name, (time, values) in signals.items():
            file.append(asammdf.Signal(np.asarray(values, float), np.asarray(time, float), name=name))
        file.save(path)
    return path


def test_mdf4_channels_become_topics_at_the_time_of_the_measurement(tmp_path: Path) -> None:
    file = measurement(
        tmp_path / "drive.mf4",
        {"Yaw": ([0, 0.1, 0.2], [10, 20, 30]), "Ax": ([0, 0.1, 0.2], [0, 1, 2]), "Delta": ([0, 0.05], [90, 180])},
    )
    mapping = {
        "topics": {
            "imu/data": {
                "angular_velocity": [None, None, {"column": "Yaw", "unit": "deg/s"}],
                "linear_acceleration": [{"column": "Ax", "unit": "m/s²"}, None, None],
            },
            "vehicle/steering": {"position": {"steering_wheel": {"column": "Delta", "unit": "deg"}}},
        }
    }
    recording = import_recording(file, mapping=mapping)
    np.testing.assert_allclose(recording["imu/data"].columns["angular_velocity"][:, 2], np.radians([10, 20, 30]))
    np.testing.assert_allclose(recording["vehicle/steering"].columns["position"][:, 0], [np.pi / 2, np.pi])
    assert recording["vehicle/steering"].stamp.tolist() == [1_577_836_800_000_000_000, 1_577_836_800_050_000_000]
    bad = {"topics": {"vehicle/steering": {"position": {"steering_wheel": {"column": "Yaww", "unit": "deg"}}}}}
    with pytest.raises(InputError, match=r"no channel 'Yaww'"):
        import_recording(file, mapping=bad)


def test_mdf4_channels_of_different_rates_in_one_topic_are_brought_to_one_time_and_noted(tmp_path: Path) -> None:
    file = measurement(
        tmp_path / "drive.mf4", {"Fast": (np.arange(5) * 0.1, np.arange(5)), "Slow": ([0, 0.2, 0.4], [0, 20, 40])}
    )
    wheels = {"wheel_fl": {"column": "Fast", "unit": "rad/s"}, "wheel_fr": {"column": "Slow", "unit": "rad/s"}}
    recording = import_recording(file, mapping={"topics": {"vehicle/wheel_speeds": {"velocity": wheels}}})
    np.testing.assert_allclose(
        recording["vehicle/wheel_speeds"].columns["velocity"], np.column_stack([np.arange(5), np.arange(5) * 10])
    )
    assert "interpolated to those of 'Fast'" in recording.notes[0]


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2 * np.pi)])
def test_a_course_through_north_at_other_times_than_the_speed_stays_a_course_to_the_north(
    tmp_path: Path, unit: str, turn: float
) -> None:
    swaying = np.array([1.0, -1.0, 1.0, -1.0, 1.0]) * turn / 360
    file = measurement(
        tmp_path / "drive.mf4",
        {"V": (np.arange(9) * 0.05, [20.0] * 9), "Course": (np.arange(5) * 0.09, swaying % turn)},
    )
    angle = {"column": "Course", "unit": unit}
    topics = {
        "gps/velocity": {"speed": {"column": "V", "unit": "m/s"}, "course": angle},
        "reference/odometry": {"yaw": angle, "linear": [{"column": "V", "unit": "m/s"}, None, None]},
    }
    recording = import_recording(file, mapping={"topics": topics})
    north = recording["gps/velocity"].columns["linear"][:-1, 1]
    assert north.min() >= 20.0 * np.cos(np.radians(1.0))
    orientation = recording["reference/odometry"].columns["orientation"][:-1]
    assert np.abs(orientation[:, 2]).max() <= np.sin(np.radians(0.5)) + 1e-12


def test_a_broken_mdf4_file_is_an_input_error(tmp_path: Path) -> None:
    file = tmp_path / "drive.mf4"
    file.write_bytes(b"MDF     4.10    " + bytes(200))
    with pytest.raises(InputError, match="damaged: no measurement header at byte 64"):
        import_recording(file, mapping={"topics": {}})


def test_an_mdf4_file_whose_channel_lies_beyond_its_record_is_an_input_error_and_no_crash(tmp_path: Path) -> None:
    """In a process of its own, which reading beyond the data would end."""
    file = measurement(tmp_path / "drive.mf4", {"Delta": (np.arange(2000) * 0.01, np.ones(2000))})
    data = bytearray(file.read_bytes())
    at = -1
    while (at := data.find(b"##CN", at + 1)) >= 0:  # each channel: links, four bytes, then where it is in a record
        links = int.from_bytes(data[at + 16 : at + 24], "little")
        place = at + 24 + 8 * links + 4
        data[place : place + 4] = (2**28).to_bytes(4, "little")
    file.write_bytes(data)
    code = f"""
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
angle = {{"column": "Delta", "unit": "deg"}}
wanted = {{"topics": {{"vehicle/steering": {{"position": {{"steering_wheel": angle}}}}}}}}
try:
    import_recording({str(file)!r}, mapping=wanted)
except InputError as error:
    print("refused:", error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr[-500:]
    assert "refused:" in done.stdout


@pytest.mark.parametrize("ending", ["csv", "mat"])
def test_rows_without_times_follow_each_other_at_a_stated_rate(ending, tmp_path):
    speed = np.linspace(10.0, 12.0, 41)
    path = tmp_path / f"log.{ending}"
    if ending == "csv":
        path.write_text("v\n" + "\n".join(map(str, speed)))
    else:
        scipy.io.savemat(path, {"v": speed})
    mapping = {
        "time": {"rate": 20, "start": "2024-01-01T00:00:00Z"},
        "topics": {"vehicle/velocity": {"speed": {"column": "v", "unit": "m/s"}}},
    }
    found = import_recording(path, mapping=mapping)["vehicle/velocity"]
    assert found.columns["linear"][:, 0] == pytest.approx(speed)
    assert (found.stamp - found.stamp[0]) * 1e-9 == pytest.approx(np.arange(41) / 20)
    del mapping["time"]["start"]
    assert any("no date" in note for note in import_recording(path, mapping=mapping).notes)
    mapping["time"]["column"] = "t"
    with pytest.raises(InputError, match="a column or a rate, found both"):
        import_recording(path, mapping=mapping)
    mapping["time"] = {}
    with pytest.raises(InputError, match=r"{rate: …} where there is none"):
        import_recording(path, mapping=mapping)
