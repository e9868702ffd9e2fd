"""Pitch and roll by gyros and base lines between GNSS antennas, on hills."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.bag import read_bag
from vsense_ros.evaluate.consistency import errors_of
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.sensors.gnss_attitude import GnssAttitude
from vsense_ros.model.sensors.gnss_tilt import GnssTilt
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.run import run

ROOT = Path(__file__).parents[2]
NOISE = 0.005  # [rad]


@pytest.fixture(scope="module")
def hills() -> Recording:
    """The bag with a receiver of three antennas: how far the front one is above the rear one, and the left one above
    the right one, by the rotation of the reference."""
    drive = read_bag(ROOT / "bags/hills")
    reference, random = drive.channels["reference/odometry"], np.random.default_rng(5)
    turned = Rotation.from_quat(reference.columns["orientation"][::10])
    stamp, count = reference.stamp[::10], len(reference.stamp[::10])
    front, left = (turned.apply(axis) for axis in ([1.0, 0, 0], [0, 1.0, 0]))
    heading = np.arctan2(front[:, 1], front[:, 0])
    pitch, roll = -np.arcsin(front[:, 2]), np.arcsin(left[:, 2])
    angles = np.column_stack([heading, pitch, roll]) + NOISE * random.standard_normal((count, 3))
    absent, covariance = np.tile([-1.0, *[0.0] * 8], (count, 1)), np.diag([NOISE**2] * 3).ravel()
    columns = {
        "orientation": Rotation.from_euler("ZYX", angles).as_quat(),
        "orientation_covariance": np.tile(covariance, (count, 1)),
        "angular_velocity": np.zeros((count, 3)),
        "angular_velocity_covariance": absent,
        "linear_acceleration": np.zeros((count, 3)),
        "linear_acceleration_covariance": absent,
    }
    antennas = Channel("gps/attitude", "sensor_msgs/msg/Imu", stamp, stamp, columns, "gnss_link")
    return Recording({**drive.channels, antennas.topic: antennas}, name="hills", metadata=drive.metadata)


@pytest.fixture(scope="module")
def car() -> Vehicle:
    plain = load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")
    antennas = {"tilt": GnssTilt(slow_error=0.0), "antennas": GnssAttitude()}
    return plain.model_copy(update={"sensors": plain.sensors | antennas})


@pytest.mark.parametrize("angle", ["pitch", "roll"])
def test_a_tilt_filter_is_better_than_its_antennas_and_knows_by_how_much(
    hills: Recording, car: Vehicle, angle: str
) -> None:
    error = errors_of(run(hills, car, f"{angle}_kkf").output, hills)[angle]
    assert error.rmse < 0.8 * NOISE
    assert 0.3 < error.nees < 2.0
    assert error.inside > 0.9


def test_the_attitude_filter_takes_pitch_and_roll_from_base_lines_where_there_are_any(
    hills: Recording, car: Vehicle
) -> None:
    with_lines = errors_of(run(hills, car, "attitude_ekf").output, hills)
    without = car.model_copy(update={"sensors": {n: s for n, s in car.sensors.items() if n != "tilt"}})
    blind = errors_of(run(hills, without, "attitude_ekf").output, hills)
    for angle in ("pitch", "roll"):
        assert with_lines[angle].rmse < 0.5 * blind[angle].rmse
    assert with_lines["pitch"].rmse < 0.5 * NOISE


@pytest.mark.parametrize(("base_lines", "absent"), [("along", 0), ("across", 1)])
def test_an_angle_without_a_base_line_or_without_a_known_variance_is_absent(base_lines: str, absent: int) -> None:
    orientation = Rotation.from_euler("ZYX", [1.0, 0.02, -0.03]).as_quat()
    for sensor, covariance in (
        (GnssTilt(base_lines=base_lines), np.diag([1e-4] * 3)),
        (GnssTilt(), np.diag([1e6 if i == absent else 1e-4 for i in range(3)])),
    ):
        value, variance = np.zeros(2), np.zeros(2)
        sensor.read((), {"orientation": orientation, "orientation_covariance": covariance.ravel()}, value, variance)
        assert np.flatnonzero(np.isnan(value)).tolist() == [absent]
        assert value[1 - absent] == pytest.approx([-0.03, 0.02][1 - absent], rel=1e-3)
        assert variance[1 - absent] == 1e-4


@pytest.mark.exam
def test_the_observer_takes_the_slope_of_the_road_from_base_lines(hills: Recording, car: Vehicle) -> None:
    """Its pitch is that of body and road: hills of 3.6° are no longer a guess from height and accelerometers."""
    with_lines = errors_of(run(hills, car, "error_ekf").output, hills)["pitch"]
    without = car.model_copy(update={"sensors": {n: s for n, s in car.sensors.items() if n != "tilt"}})
    blind = errors_of(run(hills, without, "error_ekf").output, hills)["pitch"]
    assert with_lines.rmse < 0.8 * blind.rmse
    assert with_lines.inside > 0.9
