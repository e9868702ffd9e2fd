"""What the planar INS says of its own errors, where these are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from marks import exam_except
from sine_drive import SineDrive
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.run import run


@pytest.fixture(scope="module")
def car() -> Vehicle:
    """Whose sensors are mounted at cog."""
    found = load_vehicle(vehicle_path("prototype_model"))
    sensors = {
        name: sensor.model_copy(update={"position": (0.0, 0.0, 0.0)} if hasattr(sensor, "position") else {})
        for name, sensor in found.sensors.items()
    }
    return found.model_copy(update={"sensors": sensors})


def with_gyro_scale(recording: Recording, scale: float) -> Recording:
    """The recording by a gyro that tells too much by this share."""
    channel = recording["imu/data"]
    rates = channel.columns["angular_velocity"] * (1 + scale)
    changed = replace(channel, columns={**channel.columns, "angular_velocity": rates})
    return replace(recording, channels={**recording.channels, "imu/data": changed})


@pytest.mark.parametrize("scale", exam_except([-0.01, 0.0, 0.007], 0.007))
def test_the_scale_of_a_gyro_is_learnt_by_turning(car: Vehicle, scale: float) -> None:
    found = run(with_gyro_scale(SineDrive(60.0).recording(20), scale), car, "inertial", rate=20.0)
    value, deviation = found.parameters["gyro_scale"]
    assert deviation < 0.004
    assert abs(value - scale) < 3 * deviation


def test_a_gyro_of_which_nothing_is_told_keeps_the_deviation_of_its_scale(car: Vehicle) -> None:
    """Eight seconds straight ahead."""
    found = run(SineDrive(8.0).recording(20), car, "inertial", rate=20.0)
    assert found.parameters["gyro_scale"][1] > 0.009


def test_errors_of_side_slip_are_within_what_is_stated(car: Vehicle) -> None:
    drive = with_gyro_scale(SineDrive(60.0).recording(100), 0.007)
    mine = read_signals(run(drive, car, "inertial", rate=20.0).output, "vsense")["side_slip"]
    true = read_signals(drive, "reference")["side_slip"]
    late = (mine.stamp - true.stamp[0]) * 1e-9 > 20.0
    error = mine.value[late, 0] - np.interp(mine.stamp[late], true.stamp, true.value[:, 0])
    assert mine.deviation is not None
    assert np.mean((error / mine.deviation[late]) ** 2) < 2.0
    assert np.degrees(np.sqrt(np.mean(mine.deviation[late] ** 2))) < 0.5
