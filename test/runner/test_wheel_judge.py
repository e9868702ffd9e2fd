"""A single wheel that turns as the car does not go."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.estimation.timeline import Event
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.runner import Runner
from vsense_ros.runner.judge import Rolled
from vsense_ros.runner.wheel_judge import WheelJudge

STEP = 0.02  # [s] between messages


def rolling(runner: Runner, speed: float, rate: float) -> np.ndarray:
    """Spins of wheels that roll while the car goes straight ahead steered and turns at a rate [rad/s]."""
    numbers = car_numbers(runner.vehicle)
    half = [side * numbers[f"{axle}_half_track"] for axle in ("front", "rear") for side in (1, -1)]
    radii = [numbers[f"radius_{wheel}"] for wheel in ("fl", "fr", "rl", "rr")]
    return (speed - rate * np.array(half)) / np.array(radii)


def left_out(factors: list[list[float]], rate: float = 0.0, force: float = 0.0) -> tuple[list[int], str]:
    """Wheels that are left out, and what is said of the sensor, after messages in which the wheels turn so many times
    as fast as they roll."""
    runner = Runner(load_vehicle(vehicle_path("rav4")))
    of = next(one for one in runner.judges if isinstance(one, WheelJudge))
    wheels = list(runner.sensors).index("wheel_speeds")
    event = Event(wheels, 0, np.zeros(4), np.ones(4))
    for i, factor in enumerate(factors):
        stamp = round(1e9 * (1 + i * STEP))
        of.feel(stamp, STEP, [0.0, 0.0, rate, force, 0.0, 9.81])
        spins = rolling(runner, 15.0, rate) * np.array(factor)
        event = Event(wheels, stamp, spins, np.ones(4))
        of.roll(Rolled([stamp], spins[None], event))
        of.hear(event)
    return np.flatnonzero(np.isnan(event.value)).tolist(), of.doubt(wheels)


GOOD, FAST, AXLE = [1.0] * 4, [1.0, 1.0, 1.0, 1.15], [1.0, 1.0, 1.15, 1.15]


@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_a_wheel_that_turns_faster_than_the_three_others_is_left_out_and_named(rate: float) -> None:
    wheels, said = left_out([GOOD] * 5 + [FAST] * 20, rate)
    assert wheels == [3]
    assert said == "without rr, +15% beside the other wheels"


def test_it_is_believed_once_it_has_agreed_for_a_second() -> None:
    assert left_out([FAST] * 20 + [GOOD] * 30)[0] == [3]
    assert left_out([FAST] * 20 + [GOOD] * 60) == ([], "")


@pytest.mark.parametrize(
    "drive", [([GOOD] * 30, 0.7, 0.0), ([FAST] * 5, 0.0, 0.0), ([AXLE] * 30, 0.0, 0.0), ([FAST] * 30, 0.0, -6.0)]
)
def test_wheels_in_a_bend_for_a_moment_of_an_axle_or_while_brakes_act_are_believed(drive) -> None:
    assert left_out(*drive) == ([], "")
