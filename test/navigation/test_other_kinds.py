"""Filters of this room that are no extended Kalman filters: the bank of headings, the particles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.particle import ParticleFilter, ParticleSettings
from vsense_ros.navigation.heading_bank import HEADING_BANK
from vsense_ros.navigation.yaw_kkf import HEADING, YawKkf

NUMBERS = {"gyro_noise": 0.0018, "acceleration_noise": 0.1, "sample_time": 0.01, "straight_rate": 0.0175}


@pytest.mark.parametrize("heading", [-170.0, -60.0, 35.0, 120.0])
@pytest.mark.parametrize("drive", ["accelerates", "turns"])
def test_the_bank_finds_a_heading_of_which_nothing_is_known(heading: float, drive: str) -> None:
    """Within 2° after 5 s of acceleration from standstill, or 10 s of turning at 8 m/s (fixes of 5 Hz)."""
    random = np.random.default_rng(1)
    seconds, speed, yaw = (
        (5.0, 0.0, np.radians(heading)) if drive == "accelerates" else (10.0, 8.0, np.radians(heading))
    )
    along, rate = (2.5, 0.0) if drive == "accelerates" else (0.0, 0.25)
    filter: Any = HEADING_BANK.make(NUMBERS)
    filter.start(HEADING_BANK.start({"velocity_east": speed * np.cos(yaw), "velocity_north": speed * np.sin(yaw)}))
    for k in range(1, round(seconds * 100) + 1):
        noise = random.normal(size=3)
        filter.inputs[:] = along + 0.1 * noise[0], speed * rate + 0.1 * noise[1], rate + 0.01 + 0.0018 * noise[2]
        filter.predict(0.01)
        filter.correct("no_sliding", np.zeros(1), np.array([9.0]))
        filter.correct("forwards", np.zeros(1), np.array([9.0]))
        speed, yaw = speed + 0.01 * along, yaw + 0.01 * rate
        if k % 20 == 0:
            seen = speed * np.array([np.cos(yaw), np.sin(yaw)]) + 0.03 * random.normal(size=2)
            filter.correct("gnss_velocity", seen, np.full(2, 0.03**2))
    error = (filter.mean[2] - yaw + np.pi) % (2 * np.pi) - np.pi
    assert abs(np.degrees(error)) < 2.0
    assert abs(error) < 4 * np.sqrt(filter.covariance[2, 2])


def test_particles_of_a_linear_system_come_to_what_the_kalman_filter_says() -> None:
    random = np.random.default_rng(3)
    kalman = Ekf(Dense(YawKkf(), [HEADING], NUMBERS_OF_YAW))
    particles = ParticleFilter(YawKkf(), [HEADING], NUMBERS_OF_YAW, ParticleSettings(count=4000))
    start = Gaussian(np.array([0.1, 0.0]), np.diag([0.05, 0.02]) ** 2)
    for one in (kalman, particles):
        one.start(start)
    for k in range(1, 201):
        for one in (kalman, particles):
            one.inputs[:] = 0.1
            one.predict(0.01)
        if k % 20 == 0:
            seen = np.array([0.1 + 0.0009 * k + 0.02 * random.normal()])
            for one in (kalman, particles):
                one.correct("heading", seen, np.array([0.02**2]))
    deviations = np.sqrt(np.diag(kalman.covariance))
    assert (np.abs(particles.mean - kalman.mean) < 0.15 * deviations).all()
    assert np.sqrt(np.diag(particles.covariance)) == pytest.approx(deviations, rel=0.15)


def test_particles_that_are_put_back_do_the_same_again() -> None:
    filter = ParticleFilter(YawKkf(), [HEADING], NUMBERS_OF_YAW, ParticleSettings(count=50))
    filter.start(Gaussian(np.zeros(2), np.diag([0.1, 0.01]) ** 2))
    kept, found = filter.memory.copy(), []
    for _ in range(2):
        filter.memory[:] = kept
        filter.predict(0.01)
        filter.correct("heading", np.array([0.3]), np.array([1e-4]))
        found.append(filter.memory.copy())
    assert np.array_equal(*found)


NUMBERS_OF_YAW = {name: NUMBERS[name] for name in YawKkf.parameters}
