"""Measured velocities that the estimate is far from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vsense_ros.estimation.timeline import Event
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.observer.state import FORWARD
from vsense_ros.runner import Runner
from vsense_ros.runner.velocity_judge import VELOCITY, VelocityJudge

SPEED, PERIOD = 15.0, 0.1  # [m/s], [s] between velocities
Velocity = Callable[[float], tuple[float, float]]


@pytest.fixture
def runner() -> Runner:
    """A filter that goes straight to the east at a speed that it is sure of."""
    runner = Runner(load_vehicle(vehicle_path("rav4")))
    car = runner.adapter.car  # type: ignore[attr-defined]
    runner.adapter.alignment.known = True  # type: ignore[attr-defined]
    car.mean[FORWARD] = SPEED
    car.covariance[:] = 1e-6 * np.eye(len(car.mean))
    return runner


def judged(runner: Runner, seconds: float, velocity: Velocity) -> VelocityJudge:
    """The judge after so long, of velocities east and north at times [s]."""
    of = next(one for one in runner.judges if isinstance(one, VelocityJudge))
    course = list(runner.sensors).index("velocity")
    for i in range(round(seconds / 0.04)):
        now = round(1e9 * (1 + 0.04 * i))
        runner._timeline.begin(now)
        if i % 3 == 0:
            of.hear(Event(course, now, np.array(velocity(0.04 * i)), np.full(2, 0.05**2)))
        of.feel(now, 0.04, [0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
    return of


def test_velocities_within_their_noise_are_no_contradiction(runner: Runner) -> None:
    rng = np.random.default_rng(1)
    of = judged(runner, 20.0, lambda t: (SPEED + rng.normal(0, 0.05), rng.normal(0, 0.05)))
    assert of.apart is None
    assert of.doubts == []


def test_while_the_car_seems_to_slide_the_lateral_velocity_is_as_uncertain_as_that_is_fast(runner: Runner) -> None:
    of = judged(runner, 3.0, lambda t: (SPEED, min(t, 1.0)))
    assert of.apart is not None
    assert 0.8 < of.apart.across < 1.01
    assert of.apart.ahead < 0.1
    assert of.doubts[0].startswith("measured velocity is ")


def test_a_contradiction_that_is_over_is_forgotten(runner: Runner) -> None:
    of = judged(runner, 6.0, lambda t: (SPEED, 0.0 if t > 2 else 1.0))
    assert of.doubts == []


def test_what_no_car_can_do_in_the_time_makes_no_estimate_more_uncertain(runner: Runner) -> None:
    of = judged(runner, 1.5, lambda t: (SPEED, 40.0 if t > 1.0 else 0.0))
    assert of.apart is not None
    assert of.apart.across < 0.7 * VELOCITY.acceleration
