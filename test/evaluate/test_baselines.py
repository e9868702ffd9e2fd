"""The simpler ways, on drives for which they are exact."""

from __future__ import annotations

import numpy as np
import pytest

from synthetic_drives import channel, odometry, recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate import baselines
from vsense_ros.messages.recording import Recording

COEFFICIENTS = np.array([0.02, -0.008, 1.6, -0.0035])


def lap(slowest: float, *, coefficients=COEFFICIENTS, rear: float | None = None) -> Recording:
    """A winding road on which the lateral velocity follows the formula."""
    seconds = np.arange(0.0, 30.0, 0.02)
    yaw_rate = 0.25 * np.sin(0.7 * seconds) * np.cos(0.11 * seconds)
    speed = slowest + 6.0 * np.sin(0.3 * seconds) ** 2
    lateral = coefficients @ np.array([np.ones_like(speed), speed, yaw_rate, yaw_rate * speed**2])
    if rear is not None:
        lateral = rear * yaw_rate
    zero = np.zeros_like(seconds)
    imu = channel(
        "imu/data",
        "sensor_msgs/msg/Imu",
        seconds,
        {"angular_velocity": np.column_stack([zero, zero, yaw_rate])},
    )
    return recording(
        imu,
        odometry("reference/odometry", seconds, vx=np.sqrt(speed**2 - lateral**2), vy=lateral, yaw_rate=yaw_rate),
        channel(
            "vehicle/wheel_speeds",
            "sensor_msgs/msg/JointState",
            seconds,
            {"velocity": np.column_stack([speed + 0.1, speed - 0.1, speed, speed]) / 0.3},
            names=("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"),
        ),
    )


def test_the_regression_finds_the_formula_and_predicts_another_lap():
    found = baselines.fit_regression([lap(8.0), lap(14.0)])
    assert found == pytest.approx(COEFFICIENTS, rel=1e-6)
    scores = baselines.score_all(baselines.regression(lap(11.0), found), lap(11.0))
    assert scores["lateral_velocity"].rmse == pytest.approx(0.0, abs=1e-9)
    assert scores["side_slip"].rmse == pytest.approx(0.0, abs=1e-9)


def test_the_kinematic_estimate_is_exact_for_wheels_that_do_not_slip():
    scores = baselines.score_all(baselines.kinematic(lap(10.0, rear=1.4), 1.4), lap(10.0, rear=1.4))
    assert scores["side_slip"].rmse == pytest.approx(0.0, abs=1e-9)
    assert baselines.score_all(baselines.kinematic(lap(10.0), 1.4), lap(10.0))["side_slip"].rmse > 0.005


def test_raw_sensors_are_scored_as_they_are():
    drive = lap(10.0)
    assert baselines.score_all(baselines.wheel_speed(drive, 0.3), drive)["speed"].rmse == pytest.approx(0.0, abs=1e-9)
    assert baselines.score_all(baselines.wheel_speed(drive, 0.33), drive)["speed"].bias > 1.0
    assert baselines.score_all(baselines.gyro(drive), drive)["yaw_rate"].rmse == pytest.approx(0.0, abs=1e-9)


def test_a_recording_without_the_sensor_has_no_baseline():
    empty = Recording({}, name="empty")
    assert baselines.by_label(("raw gyro", baselines.score_all(baselines.gyro(empty), empty))) == {}
    with pytest.raises(InputError, match=r"empty.*imu/data"):
        baselines.fit_regression([empty])


def test_what_costs_nothing_is_the_last_reading_or_zero_or_the_mean():
    seconds = np.arange(0.0, 10.0, 0.01)
    speed = 10.0 + seconds
    fixes = np.arange(0.0, 10.0, 0.5)
    velocity = channel(
        "gps/velocity",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        fixes,
        {"linear": np.column_stack([0.6 * (10.0 + fixes), 0.8 * (10.0 + fixes), np.zeros(len(fixes))])},
    )
    truth = odometry("reference/odometry", seconds, vx=speed, vy=np.full(len(seconds), 0.4), yaw_rate=0.1 * seconds)
    found = baselines.trivial(recording(truth, velocity))
    label, speed_error = found["longitudinal_velocity"]
    assert label == "GNSS"
    assert speed_error.rmse == pytest.approx(0.5 / 3**0.5, rel=0.03)  # a ramp of 1 m/s², held for half a second
    assert found["lateral_velocity"][0] == "zero"
    assert found["lateral_velocity"][1].rmse == pytest.approx(0.4)
    assert found["yaw_rate"][0] == "mean"
    assert found["yaw_rate"][1].rmse == pytest.approx(1.0 / 12**0.5, rel=0.01)
