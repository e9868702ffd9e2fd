"""The RAV4's minute, against facts that the importer does not use."""

from __future__ import annotations

import shutil
from pathlib import Path

import can
import cantools
import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import comma2k19, import_recording
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]


def at(stamp: NDArray[np.int64], channel: Channel, values: Array) -> Array:
    zero = int(stamp[0])
    return np.interp((stamp - zero) * 1e-9, (channel.stamp - zero) * 1e-9, values)


def smooth(values: Array, width: int = 11) -> Array:
    return np.convolve(values, np.ones(width) / width, "same")


def test_the_drive_is_on_the_afternoon_that_the_folder_name_says(rav4: Recording) -> None:
    """The route is named 2018-08-02--08-34-47 in Pacific time; the segment is its minute 40."""
    begun = np.datetime64("2018-08-02T15:34:47") + np.timedelta64(40, "m")
    assert abs(np.datetime64(rav4.start, "ns") - begun) < np.timedelta64(30, "s")
    assert rav4.duration == pytest.approx(60.0, abs=0.2)


def test_specific_force_points_up_and_is_gravity_on_average(rav4: Recording) -> None:
    force = rav4["imu/data"].columns["linear_acceleration"].mean(axis=0)
    assert force[2] == pytest.approx(9.7, abs=0.15)
    assert np.abs(force[:2]).max() < 0.8  # the phone's own inclination


def test_the_velocity_of_the_reference_is_the_derivative_of_its_position(rav4: Recording) -> None:
    odometry = rav4["reference/odometry"]
    body = Rotation.from_quat(odometry.columns["orientation"])
    enu = body.apply(odometry.columns["linear"])
    derivative = np.gradient(odometry.columns["position"], odometry.seconds, axis=0)
    assert np.sqrt(np.mean((derivative - enu) ** 2, axis=0)).max() < 0.01


def test_the_reference_drives_forward_and_level_on_its_own_wheels(rav4: Recording) -> None:
    linear = rav4["reference/odometry"].columns["linear"]
    assert linear[:, 0].min() > 7.0
    assert np.abs(linear[:, 1:].mean(axis=0)).max() < 0.02
    assert np.abs(linear[:, 1]).max() < 0.3


def test_gyro_and_reference_turn_the_same_way_at_the_same_time(rav4: Recording) -> None:
    imu, odometry = rav4["imu/data"], rav4["reference/odometry"]
    mounting = Rotation.from_euler(
        "ZY", [float(rav4.metadata["imu_mount_yaw_rad"]), float(rav4.metadata["imu_mount_pitch_rad"])]
    )
    body_rates = mounting.apply(imu.columns["angular_velocity"])
    for axis in range(3):
        gyro = at(odometry.stamp, imu, smooth(body_rates[:, axis]))
        assert np.corrcoef(gyro[5:-5], odometry.columns["angular"][5:-5, axis])[0, 1] > 0.9
    assert np.degrees(np.std(gyro - odometry.columns["angular"][:, 2])) < 0.12


def test_gnss_velocity_integrates_to_the_track_of_the_fixes(rav4: Recording) -> None:
    fix, velocity = rav4["gps/fix"], rav4["gps/velocity"]
    latitude, longitude, altitude = (fix.columns[name][:, 0] for name in ("latitude", "longitude", "altitude"))
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, altitude, latitude[0], longitude[0], altitude[0])
    step = np.diff(velocity.seconds)[:, None]
    linear = velocity.columns["linear"][:, :2]
    track = np.concatenate([np.zeros((1, 2)), np.cumsum((linear[1:] + linear[:-1]) / 2 * step, axis=0)])
    assert np.abs(track - np.column_stack([east, north])).max() < 3.0  # over 1 km
    assert np.isnan(velocity.columns["linear"][:, 2]).all()


def test_fixes_are_stamped_with_their_own_utc_and_arrive_a_fifth_of_a_second_later(rav4: Recording) -> None:
    fix = rav4["gps/fix"]
    latency = (fix.received - fix.stamp) * 1e-9
    assert 0.15 < latency.min() < latency.max() < 0.3
    assert set(np.unique(np.diff(fix.stamp))) <= {100_000_000, 200_000_000}


def test_steering_is_positive_to_the_left(rav4: Recording) -> None:
    steering, odometry = rav4["vehicle/steering"], rav4["reference/odometry"]
    assert steering.names == ("steering_wheel",)
    angle = at(odometry.stamp, steering, steering.columns["position"][:, 0])
    assert np.corrcoef(angle, odometry.columns["angular"][:, 2])[0, 1] > 0.7


def test_wheel_speeds_times_rolling_radius_are_the_speed_of_the_reference(rav4: Recording) -> None:
    wheels, odometry = rav4["vehicle/wheel_speeds"], rav4["reference/odometry"]
    assert wheels.names == ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    speed = at(odometry.stamp, wheels, wheels.columns["velocity"].mean(axis=1)) * comma2k19.ROLLING_RADIUS
    ratio = speed / np.linalg.norm(odometry.columns["linear"], axis=1)
    assert np.median(ratio) == pytest.approx(0.991, abs=0.004)


def test_uncalibrated_gyro_differs_by_a_constant_bias(rav4: Recording, rav4_path: Path) -> None:
    raw = import_recording(rav4_path, calibrated_gyro=False)["imu/data"].columns["angular_velocity"]
    difference = raw - rav4["imu/data"].columns["angular_velocity"]
    assert np.ptp(difference, axis=0).max() < 1e-9
    assert 0.01 < np.linalg.norm(difference[0]) < 0.1


def test_the_can_log_decodes_to_the_processed_signals(rav4: Recording, rav4_path: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    count = comma2k19.write_can_log(rav4_path, log)
    frames = list(can.CanutilsLogReader(log))
    assert len(frames) == count == 135_468
    assert {frame.channel for frame in frames} == {"can0", "can1"}
    database = cantools.database.load_file(rav4_path.parent / "toyota_rav4_2017_pt_generated.dbc", strict=False)
    received = [frame for frame in frames if frame.channel == "can0" and frame.is_rx]
    speeds = np.array(
        [
            [decoded[f"WHEEL_SPEED_{wheel}"] for wheel in ("FL", "FR", "RL", "RR")]
            for frame in received
            if frame.arbitration_id == 0xAA
            for decoded in [database.decode_message(0xAA, frame.data)]
        ]
    )
    wheels = rav4["vehicle/wheel_speeds"]
    np.testing.assert_allclose(speeds / 3.6 / comma2k19.ROLLING_RADIUS, wheels.columns["velocity"], atol=1e-12)
    times = [frame.timestamp for frame in received if frame.arbitration_id == 0xAA]
    np.testing.assert_allclose(times, wheels.stamp * 1e-9, atol=2e-6)
    angles = [
        np.radians(decoded["STEER_ANGLE"] + decoded["STEER_FRACTION"])
        for frame in received
        if frame.arbitration_id == 0x25
        for decoded in [database.decode_message(0x25, frame.data)]
    ]
    np.testing.assert_allclose(angles, rav4["vehicle/steering"].columns["position"][:, 0], atol=1e-12)


def test_frames_of_the_can_log_have_the_length_of_the_dbc_and_right_checksums(rav4_path: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    comma2k19.write_can_log(rav4_path, log)
    lengths: dict[int, set[int]] = {}
    for frame in can.CanutilsLogReader(log):
        if frame.channel != "can0" or not frame.is_rx:
            continue
        lengths.setdefault(frame.arbitration_id, set()).add(frame.dlc)
        if frame.arbitration_id in (0x25, 0xB4, 0x260, 0x262):
            total = frame.arbitration_id % 256 + frame.arbitration_id // 256 + frame.dlc + sum(frame.data[:-1])
            assert frame.data[-1] == total % 256
    assert lengths[0x262] == {5}
    assert lengths[0xAA] == lengths[0x620] == {8}


def test_a_folder_with_a_missing_array_is_an_input_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "processed_log").mkdir()
    with pytest.raises(InputError, match="frame_times: missing"):
        import_recording(tmp_path)


def test_a_car_without_wheel_speeds_on_a_route_without_poses_is_read_by_its_speed_and_the_utc_of_fixes(
    rav4_path: Path, rav4: Recording, tmp_path: Path
) -> None:
    shutil.copytree(rav4_path / "processed_log", tmp_path / "processed_log")
    shutil.rmtree(tmp_path / "processed_log" / "CAN" / "wheel_speed")
    other = import_recording(tmp_path)
    assert "vehicle/wheel_speeds" not in other
    assert "reference/odometry" not in other
    speed = other["vehicle/velocity"]
    wheels = rav4["vehicle/wheel_speeds"]
    of_wheels = wheels.columns["velocity"].mean(axis=1) * comma2k19.ROLLING_RADIUS
    assert at(speed.stamp, wheels, of_wheels) == pytest.approx(speed.columns["linear"][:, 0], rel=0.03)
    for topic in ("imu/data", "gps/fix", "vehicle/steering"):
        assert np.abs(other[topic].stamp - rav4[topic].stamp).max() < 30e6
    assert any("by the UTC of the fixes" in note for note in other.notes)
    shutil.rmtree(tmp_path / "processed_log" / "GNSS")
    assert any("count from 1970" in note for note in import_recording(tmp_path).notes)


def test_an_unknown_option_is_an_input_error_that_lists_the_known_ones(rav4_path: Path) -> None:
    with pytest.raises(InputError, match="no option 'colour'; it has: rolling_radius, calibrated_gyro"):
        import_recording(rav4_path, colour="red")


def test_the_segment_survives_a_bag(rav4: Recording, tmp_path: Path) -> None:
    from vsense_ros.bag import read_bag, write_bag

    write_bag(tmp_path / "rav4", rav4)
    found = read_bag(tmp_path / "rav4")
    assert found.metadata == rav4.metadata
    assert found.notes == rav4.notes
    for topic, channel in rav4.channels.items():
        np.testing.assert_array_equal(found[topic].stamp, channel.stamp)
        for field, column in channel.columns.items():
            np.testing.assert_array_equal(found[topic].columns[field], column)
