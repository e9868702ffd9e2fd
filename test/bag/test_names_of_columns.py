"""Columns are taken for what their loggers mean by them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.guess import guess
from vsense_ros.bag.importers.guess_names import heading, meanings

LOGGERS = {
    # Stanford P1, headings of a structure in MATLAB
    "a yaw angle beside a yaw rate": (
        ("time", "yaw", "yaw_rate", "axG", "ayG", "delta_L", "delta_HW"),
        {
            "position.steering_wheel": "delta_HW", "angular_velocity.2": "yaw_rate", "linear_acceleration.0": "axG",
            "linear_acceleration.1": "ayG",
        },
    ),
    "a yaw rate that is called yaw": (("t", "Yaw"), {"angular_velocity.2": "Yaw"}),
    # BMW M235i, a logger of laps
    "places as X and Y, accelerations in Gs": (
        ("Latitude / Y Position", "Longitude / X Position", "Lateral Gs", "Acceleration Gs"),
        {
            "latitude": "Latitude / Y Position", "longitude": "Longitude / X Position",
            "linear_acceleration.1": "Lateral Gs", "linear_acceleration.0": "Acceleration Gs",
        },
    ),
    # BMW M8 of a proving ground: an inertial system beside the speeds of the wheels
    "velocities beside wheel speeds are a reference": (
        ("Velocity_X", "Velocity_Y", "Velocity_Z", "v_wheel_fl", "v_wheel_fr", "v_wheel_rl", "v_wheel_rr"),
        {"forward": "Velocity_X", "left": "Velocity_Y", "velocity.wheel_rl": "v_wheel_rl", "speed": None},
    ),
    # Volkswagen GTI of Stanford, in the letters of textbooks
    "the letters of textbooks with units": (
        ("Ux_mps", "Uy_mps", "ax_mps2", "ay_mps2", "r_radps", "delta_rad"),
        {
            "forward": "Ux_mps", "left": "Uy_mps", "linear_acceleration.0": "ax_mps2",
            "linear_acceleration.1": "ay_mps2", "angular_velocity.2": "r_radps",
            "position.road_wheel_front": "delta_rad",
        },
    ),
    "a velocity forward alone is a speed": (("t", "vx", "wz"), {"speed": "vx", "forward": None}),
}  # fmt: skip


@pytest.mark.parametrize("logger", LOGGERS)
def test_columns_mean_what_the_logger_means(logger: str) -> None:
    columns, expected = LOGGERS[logger]
    found = {field: name for (_, field), name in meanings({name: heading(name) for name in columns}).items()}
    assert {field: found.get(field) for field in expected} == expected


def test_accelerations_without_gravity_are_proposed_with_it(tmp_path: Path) -> None:
    time = np.arange(0, 20, 0.02)
    rate = 0.3 * np.sin(0.2 * np.pi * time)
    rng = np.random.default_rng(3)
    table = np.column_stack([time, 0 * time, 15 * rate, 0.02 * rng.standard_normal(len(time)), rate, 15 + 0 * time])
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", fmt="%.5f", header="t,ax,ay,az,yaw_rate,vx", comments="")
    proposal = guess(tmp_path / "drive.csv")
    (tmp_path / "drive.yaml").write_text(proposal.text, encoding="utf-8")
    forces = import_recording(tmp_path / "drive.csv")["imu/data"].columns["linear_acceleration"]
    assert forces[:, 2].mean() == pytest.approx(9.80665, abs=0.01)
    assert forces[:, 1] == pytest.approx(15 * rate, abs=1e-4)
    assert any("gravity is added" in remark for remark in proposal.remarks)


def test_times_that_begin_before_zero_are_proposed_to_count_from_a_date(tmp_path: Path) -> None:
    time = np.arange(-3, 3, 0.02)
    table = np.column_stack([time, 0.1 * np.sin(time), 15 + 0 * time])
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", fmt="%.5f", header="t,yaw_rate,vx", comments="")
    (tmp_path / "drive.yaml").write_text(guess(tmp_path / "drive.csv").text, encoding="utf-8")
    stamps = import_recording(tmp_path / "drive.csv")["imu/data"].stamp
    assert stamps[0] > 0
    assert (stamps - stamps[0]) * 1e-9 - 3 == pytest.approx(time, abs=1e-6)
