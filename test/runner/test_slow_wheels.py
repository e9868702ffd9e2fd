"""Wheels that turn more slowly than their sensors measure read zero, and the car moves all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vsense_ros as vs
from drives import WHEELS
from vsense_ros.manoeuvre import generate


@pytest.fixture(scope="module")
def without_gnss(plant):
    """Off from rest, followed by inertial sensors, steering and wheels alone."""
    recording = generate("stop_and_go", plant, seed=4)
    kept = {topic: one for topic, one in recording.channels.items() if not topic.startswith("gps/")}
    return replace(recording, channels={topic: one.select(one.seconds >= 7.0) for topic, one in kept.items()})


def test_the_drive_has_wheels_that_read_zero_while_the_car_moves(without_gnss):
    wheels, truth = without_gnss[WHEELS], without_gnss["reference/odometry"]
    speed = np.interp(wheels.seconds, truth.seconds, truth.columns["linear"][:, 0])
    assert np.max(speed[wheels.columns["velocity"][:, 0] == 0]) > 0.5


@pytest.mark.filterwarnings("ignore:none of gps")
def test_a_start_that_slow_wheels_do_not_show_leaves_the_speed_within_its_uncertainty(without_gnss, vehicle):
    estimated = vs.estimate(without_gnss, vehicle)
    speed, slip = estimated["longitudinal_velocity"], estimated["side_slip"]
    assert speed.coverage > 0.95
    assert slip.coverage > 0.95
    assert speed.rmse < 0.05
