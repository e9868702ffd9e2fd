"""A sensor that is far noisier than stated is right, and is not left out for its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drives import IMU, changed, feed, messages, seconds
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

NOISE = 4.0  # [m/s²] as of an accelerometer beside an engine, forty times what is stated


def test_a_noisy_accelerometer_is_believed_as_far_as_its_noise_lets_it_and_is_reported(
    vehicle: Vehicle, lane_change: Recording
) -> None:
    rng = np.random.default_rng(4)

    def noisy(sample: Sample) -> Sample:
        if sample.topic != IMU:
            return sample
        force = sample.values["linear_acceleration"] + np.array([0.0, NOISE * rng.standard_normal(), 0.0])
        return replace(sample, values={**sample.values, "linear_acceleration": force})

    observer = Runner(vehicle, lane_change.map_origin)
    left_out: set[str] = set()
    for sample in map(noisy, messages(lane_change, 7.0)):
        feed(observer, [sample])
        left_out |= {axes.name(axis) for axes, axis, _ in observer.vote.out}
    assert not left_out
    imu = next(line for line in observer.diagnostics() if line.name == "imu")
    assert "noise of lateral acceleration" in imu.message
    truth = lane_change["reference/odometry"]
    lateral = np.interp(observer.stamp, truth.stamp, truth.columns["linear"][:, 1])
    odometry = observer.estimate()[0].values
    deviation = odometry["twist_covariance"].reshape(6, 6)[1, 1] ** 0.5
    assert abs(odometry["linear"][1] - lateral) < max(0.1, 3 * deviation)


@pytest.mark.parametrize(("hertz", "rate"), [(9.0, 0.02), (12.0, 0.1)])
def test_an_inertial_sensor_that_vibrates_is_right_as_soon_as_that_is_known(
    vehicle: Vehicle, lane_change: Recording, hertz: float, rate: float
) -> None:
    def shaken(sample: Sample) -> Sample:
        if sample.topic != IMU:
            return sample
        wave = np.sin(2 * np.pi * hertz * seconds(lane_change, sample) + np.arange(6))
        turning, force = sample.values["angular_velocity"], sample.values["linear_acceleration"]
        return changed(sample, angular_velocity=turning + rate * wave[:3], linear_acceleration=force + 1.5 * wave[3:])

    observer = Runner(vehicle, lane_change.map_origin)
    left_out: set[str] = set()
    for sample in map(shaken, messages(lane_change, 5.0)):
        feed(observer, [sample])
        if seconds(lane_change, sample) > 2.0:
            left_out |= {axes.name(axis) for axes, axis, _ in observer.vote.out}
    assert not left_out
