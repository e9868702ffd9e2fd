"""Folders of public data sets, written as their documentation says, give the motion that was written."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import find_importer, import_recording
from vsense_ros.checks.inspect import inspect
from vsense_ros.errors import InputError

SPEED, RATE, RADIUS = 12.0, 0.3, 40.0  # [m/s, rad/s, m] of a circle to the left
ORIGIN = (49.0, 8.4, 115.0)
T = np.arange(0, 12, 0.1)
YAW = RATE * T - 0.5
EAST, NORTH = RADIUS * np.sin(YAW), -RADIUS * np.cos(YAW)
VELOCITY = SPEED * np.column_stack([np.cos(YAW), np.sin(YAW), 0 * YAW])
LATITUDE, LONGITUDE, HEIGHT = pymap3d.enu2geodetic(EAST, NORTH, 0 * EAST, *ORIGIN)
FORCE = np.column_stack([0 * T, SPEED * RATE + 0 * T, 9.81 + 0 * T])
UNIX = datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp()


def kitti(folder: Path) -> Path:
    data = folder / "2011_09_26_drive_0001_sync" / "oxts" / "data"
    data.mkdir(parents=True)
    times = []
    for i, t in enumerate(T):
        row = np.zeros(30)
        row[:6] = LATITUDE[i], LONGITUDE[i], HEIGHT[i], 0.0, 0.0, (YAW[i] + np.pi) % (2 * np.pi) - np.pi
        row[6:11] = VELOCITY[i, 1], VELOCITY[i, 0], SPEED, 0.0, 0.0
        row[11:17] = *FORCE[i], *FORCE[i]
        row[17:23] = 0, 0, RATE, 0, 0, RATE
        row[23:25] = 0.05, 0.02
        (data / f"{i:010d}.txt").write_text(" ".join(f"{value:.14g}" for value in row))
        times.append(f"2011-09-26 13:02:{25 + int(t):02d}.{round(t % 1 * 1e9):09d}")
    (data.parent / "timestamps.txt").write_text("\n".join(times) + "\n")
    return data.parent.parent


def nclt(folder: Path) -> Path:
    stamps = np.round((UNIX + T) * 1e6)[:, None]
    down = np.array([1.0, -1.0, -1.0])
    rates = np.column_stack([0 * T, 0 * T, RATE + 0 * T])
    stamps = stamps.astype(np.int64)
    with (folder / "ms25.csv").open("w") as file:
        for stamp, force, rate in zip(stamps[:, 0], FORCE * down, rates * down, strict=True):
            file.write(f"{stamp},0.1,0.2,0.3,{','.join(f'{v:.9g}' for v in (*force, *rate))}\n")
    track = (np.pi / 2 - YAW) % (2 * np.pi)
    with (folder / "gps.csv").open("w") as file:
        for i, stamp in enumerate(stamps[:, 0]):
            file.write(f"{stamp},3,9,{np.radians(LATITUDE[i]):.14f},{np.radians(LONGITUDE[i]):.14f},")
            file.write(f"{HEIGHT[i]:.3f},{track[i]:.9f},{SPEED}\n")
    with (folder / "wheels.csv").open("w") as file:
        file.writelines(f"{stamp},{SPEED - 0.1},{SPEED + 0.1}\n" for stamp in stamps[:, 0])
    with (folder / "groundtruth_2013-01-10.csv").open("w") as file:
        for i, stamp in enumerate(stamps[:, 0]):
            file.write(f"{stamp},{NORTH[i]:.6f},{EAST[i]:.6f},0,0,0,{np.pi / 2 - YAW[i]:.9f}\n")
    return folder


def ppc(folder: Path) -> Path:
    week, tow = 2325, 100_000.0 + T
    with (folder / "imu.csv").open("w") as file:
        file.write("GPS TOW (s), GPS Week, Acc X (m/s^2), Acc Y (m/s^2), Acc Z (m/s^2), Ang Rate X (deg/s),")
        file.write("  Ang Rate Y (deg/s),  Ang Rate Z (deg/s)\n")
        for i, t in enumerate(tow):
            x, y, z = FORCE[i]
            file.write(f"{t:.3f}, {week}, {x:.6f}, {-y:.6f}, {-z:.6f}, 0, 0, {-np.degrees(RATE):.6f}\n")
    with (folder / "reference.csv").open("w") as file:
        file.write(
            "GPS TOW (s), GPS Week, Latitude (deg), Longitude (deg), Ellipsoid Height (m), ECEF X (m), ECEF Y (m), "
        )
        file.write("ECEF Z (m), Roll (deg), Pitch (deg), Heading (deg), East Velocity (m/s), North Velocity (m/s), ")
        file.write("Up Velocity (m/s)\n")
        for i, t in enumerate(tow):
            file.write(f"{t:.3f}, {week}, {LATITUDE[i]:.12f}, {LONGITUDE[i]:.12f}, {HEIGHT[i]:.4f}, 0, 0, 0, 0, 0, ")
            file.write(f"{np.degrees(np.pi / 2 - YAW[i]) % 360:.8f}, {VELOCITY[i, 0]:.8f}, {VELOCITY[i, 1]:.8f}, 0\n")
    return folder


def smartloc(folder: Path) -> Path:
    names = (
        "GPSWeek [weeks];GPSSecondsOfWeek [s];Longitude (GT Lon) [deg];Longitude Cov (GT Lon) [deg];"
        "Latitude (GT Lat) [deg];"
        "Latitude Cov (GT Lat) [deg];Height above ellipsoid (GT Height) [m];Height above ellipsoid Cov (GT Height) [m];"
        "Heading (0° = East, counterclockwise) - (GT Heading) [rad];"
        "Heading Cov (0° = East, counterclockwise) - (GT Heading) [rad];Acceleration (GT Acceleration) [ms^2];"
        "Velocity (GT Velocity) [m/s];Velocity Cov (GT Velocity) [m/s];Yaw-Rate (GT Yaw-rate) [rad/s];"
        "GPS time of week of the navigation epoch (iTOW) [ms];Longitude (lon) [deg];Latitude (lat) [deg];"
        "Height above ellipsoid (height) [m];Height above mean sea level (hMSL) [m];"
        "Horizontal accuracy estimate (hAcc) [m];Vertical accuracy estimate (vAcc) [m]"
    )
    lines = [names]
    for i, t in enumerate(T):
        place = f"{LONGITUDE[i]:.10f};0;{LATITUDE[i]:.10f};0;{HEIGHT[i]:.4f};0"
        receiver = f"{LONGITUDE[i]:.7f};{LATITUDE[i]:.7f};{HEIGHT[i]:.3f};80;1.5;2.5"
        lines.append(f"1900;{126641.5 + t:.2f};{place};{YAW[i]:.8f};0;0;{SPEED};0;{RATE};0;{receiver}")
    (folder / "NAV-POSLLH.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


SETS = {"kitti": kitti, "nclt": nclt, "ppc": ppc, "smartloc": smartloc}


@pytest.mark.parametrize("name", SETS)
def test_a_data_set_is_known_and_its_reference_is_the_circle(name: str, tmp_path: Path) -> None:
    path = SETS[name](tmp_path)
    assert find_importer(path).name == name
    recording = import_recording(path)
    reference = recording["reference/odometry"]
    yaw = Rotation.from_quat(reference.columns["orientation"]).as_euler("ZYX")
    assert np.unwrap(yaw[:, 0]) == pytest.approx(YAW, abs=1e-6)
    assert yaw[:, 1:] == pytest.approx(0, abs=1e-4)
    moved = reference.columns["position"] - reference.columns["position"][0]
    assert moved[:, 0] == pytest.approx(EAST - EAST[0], abs=1e-3)
    assert moved[:, 1] == pytest.approx(NORTH - NORTH[0], abs=1e-3)
    assert reference.seconds - reference.seconds[0] == pytest.approx(T, abs=1e-5)
    linear = reference.columns["linear"]
    if np.isfinite(linear).any():
        assert linear[:, 0] == pytest.approx(SPEED, abs=1e-3)
        assert linear[:, 1] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("name", ["kitti", "nclt", "ppc"])
def test_its_imu_has_axes_forward_left_up(name: str, tmp_path: Path) -> None:
    imu = import_recording(SETS[name](tmp_path))["imu/data"]
    assert imu.columns["angular_velocity"][:, 2] == pytest.approx(RATE, abs=1e-6)
    assert imu.columns["linear_acceleration"] == pytest.approx(FORCE, abs=1e-5)


@pytest.mark.parametrize("name", ["kitti", "nclt", "smartloc"])
def test_its_fixes_are_where_the_circle_is(name: str, tmp_path: Path) -> None:
    fix = import_recording(SETS[name](tmp_path))["gps/fix"]
    assert fix.columns["latitude"][:, 0] == pytest.approx(LATITUDE, abs=1e-7)
    assert fix.columns["longitude"][:, 0] == pytest.approx(LONGITUDE, abs=1e-7)


@pytest.mark.parametrize("name", ["kitti", "nclt"])
def test_nothing_in_it_contradicts_anything(name: str, tmp_path: Path) -> None:
    recording = import_recording(SETS[name](tmp_path))
    assert recording["gps/velocity"].columns["linear"][:, :2] == pytest.approx(VELOCITY[:, :2], abs=1e-6)
    assert inspect(recording).findings == ()


def test_times_of_gps_are_less_their_leap_seconds(tmp_path: Path) -> None:
    stamp = import_recording(ppc(tmp_path))["imu/data"].stamp[0]
    assert stamp * 1e-9 == pytest.approx(315_964_800 + 2325 * 604_800 + 100_000 - 18, abs=1e-3)


def test_a_moment_whose_file_was_cut_costs_itself_alone(tmp_path: Path) -> None:
    path = kitti(tmp_path)
    (path / "oxts" / "data" / "0000000003.txt").write_text("49.0 8.4")
    recording = import_recording(path)
    assert len(recording["imu/data"]) == len(T) - 1
    assert "1 moments" in recording.notes[0]


@pytest.mark.parametrize(("name", "file"), [("nclt", "ms25.csv"), ("ppc", "imu.csv"), ("smartloc", "NAV-POSLLH.csv")])
def test_a_table_of_another_kind_is_refused_in_a_sentence(name: str, file: str, tmp_path: Path) -> None:
    path = SETS[name](tmp_path)
    first = (path / file).read_text(encoding="utf-8").splitlines()[0]
    (path / file).write_text(("" if name == "nclt" else first + "\n") + "prose, not numbers\n", encoding="utf-8")
    with pytest.raises(InputError):
        import_recording(path)
