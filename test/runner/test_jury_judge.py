"""Whole sensors that are wrong, while an axis of an inertial sensor seems to be."""

from __future__ import annotations

import numpy as np

from drives import IMU, WHEELS, feed, messages, seconds
from vsense_ros.evaluate import faults
from vsense_ros.evaluate.faults import ACCELEROMETER, GYRO, Change, Fault
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner


def lines(runner: Runner) -> dict[str, str]:
    """What is said of each sensor."""
    return {line.name: line.message for line in runner.diagnostics()}


def broken(recording: Recording, topic: str, begin: float, end: float, *changes: Change) -> Recording:
    """The drive with changes of a topic from one time to another [s]."""
    for change in changes:
        recording = Fault("", (topic,), change, begin, end).of(recording)
    return recording


def lateral_error(runner: Runner, truth: Recording) -> float:
    """Error of the lateral velocity now [m/s]."""
    reference = truth["reference/odometry"]
    there = np.interp(runner.stamp, reference.stamp, reference.columns["linear"][:, 1])
    return float(abs(runner.snapshot().velocity[1] - there))


def test_four_wheels_that_stand_still_in_a_bend_are_left_out_and_no_gyro_and_are_believed_again(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    stuck = faults.held("velocity", (0, 1, 2, 3), 0.05)
    drive = broken(lane_change, WHEELS, 3.5, 5.0, stuck)
    stream = messages(drive, 7.5)
    runner = Runner(vehicle, drive.map_origin)
    feed(runner, (s for s in stream if seconds(drive, s) < 4.9))
    assert lines(runner)["wheel_speeds"].startswith("not believed")
    assert not list(runner.vote.out)
    assert lateral_error(runner, drive) < 0.2
    feed(runner, (s for s in stream if seconds(drive, s) >= 4.9))
    assert lines(runner)["wheel_speeds"] == "in use"
    assert lateral_error(runner, drive) < 0.2


def test_an_inertial_sensor_of_which_all_axes_are_wrong_is_left_out_as_a_whole(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    axes = (0, 1, 2)
    drive = broken(lane_change, IMU, 0.0, np.inf, faults.added(GYRO, axes, 0.5), faults.added(ACCELEROMETER, axes, 5.0))
    runner = feed(Runner(vehicle, drive.map_origin), messages(drive, 4.5))
    assert len(list(runner.vote.out)) == 6
    assert lateral_error(runner, drive) < 0.3
    assert "wheel_speeds" not in lines(runner)["observer"]


def test_wheels_that_slip_are_not_accused_of_what_an_inertial_sensor_that_is_turned_reads() -> None:
    plant, model = (load_vehicle(vehicle_path(f"prototype_{name}")) for name in ("real", "model"))
    turned = (faults.turned(field, (1, 0, 2), (1.0, -1.0, 1.0)) for field in (GYRO, ACCELEROMETER))
    drive = broken(generate("accelerate_and_brake", plant, 46), IMU, 5.0, np.inf, *turned)
    stream, runner, heard = messages(drive, 13.0), Runner(model, drive.map_origin), 0.0
    for end in (9.0, 11.5, 13.0):  # full throttle, at which wheels slip; coasting; braking
        feed(runner, (s for s in stream if heard <= seconds(drive, s) < end))
        heard = end
        assert lines(runner)["wheel_speeds"] == "in use"
        assert lateral_error(runner, drive) < 0.5
        assert "turned around" not in lines(runner)["observer"]


def test_a_gyro_that_drifts_away_is_left_out_before_the_force_that_it_makes_speaks_for_it(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    drive = broken(lane_change, IMU, 3.5, np.inf, faults.added(GYRO, (2,), 0.3, rise=2.0))
    stream, runner = messages(drive, 9.0), Runner(vehicle, drive.map_origin)
    feed(runner, (s for s in stream if seconds(drive, s) < 4.4))
    assert "without imu yaw rate" in lines(runner)["observer"]
    assert lateral_error(runner, drive) < 0.1
    feed(runner, (s for s in stream if seconds(drive, s) >= 4.4))
    assert "lateral tyre forces" not in lines(runner)["observer"]
    assert lateral_error(runner, drive) < 0.1


def test_wheels_that_are_as_fast_as_gnss_are_not_accused_while_an_inertial_sensor_is_turned(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    turned = (faults.turned(field, (1, 0, 2), (1.0, -1.0, 1.0)) for field in (GYRO, ACCELEROMETER))
    drive = broken(lane_change, IMU, 0.0, 5.0, *turned)
    stream, runner, heard = messages(drive, 7.0), Runner(vehicle, drive.map_origin), 0.0
    for end in np.arange(3.0, 7.0, 0.25):
        feed(runner, (s for s in stream if heard <= seconds(drive, s) < end))
        heard = end
        assert lines(runner)["wheel_speeds"] == "in use"
        assert lateral_error(runner, drive) < 1.0
    assert lateral_error(runner, drive) < 0.3


def test_wheels_that_are_half_as_fast_as_gnss_are_left_out_and_no_axis() -> None:
    plant, model = (load_vehicle(vehicle_path(f"prototype_{name}")) for name in ("real", "model"))
    drive = broken(
        generate("accelerate_and_brake", plant, 46), WHEELS, 5.0, np.inf, faults.scaled("velocity", (0, 1, 2, 3), 0.5)
    )
    runner = feed(Runner(model, drive.map_origin), messages(drive, 6.0))
    assert lines(runner)["wheel_speeds"].startswith("not believed")
    assert not list(runner.vote.out)
