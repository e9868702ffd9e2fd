"""Speeds that change from one message to the next as those of no car do."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from vsense_ros.estimation.timeline import Event
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.runner import Runner
from vsense_ros.runner.judge import Rolled
from vsense_ros.runner.leap_judge import LeapJudge

STEP = 0.01  # [s] between messages
SPIN = 60.0  # [rad/s] of wheels at 20 m/s


@pytest.fixture
def runner() -> Runner:
    return Runner(load_vehicle(vehicle_path("rav4")))


def is_open_after(runner: Runner, spins: Iterable[list[float]], step: float = STEP) -> bool:
    """True if wheels that the filter refuses have leapt, and are not back."""
    of = next(one for one in runner.judges if isinstance(one, LeapJudge))
    wheels = list(runner.sensors).index("wheel_speeds")
    for i, spin in enumerate(spins):
        runner.health[wheels].refused_in_a_row = i
        event = Event(wheels, round(1e9 * (1 + i * step)), np.array(spin), np.ones(4))
        of.roll(Rolled([event.stamp], event.value[None], event))
    return of.is_open(wheels)


def test_four_wheels_that_fall_to_zero_between_two_messages_have_leapt_until_they_are_back(runner: Runner) -> None:
    rolling, still = [SPIN] * 4, [0.0] * 4
    assert is_open_after(runner, [rolling, rolling, still, still])
    runner.judges.forget(0)
    assert not is_open_after(runner, [rolling, rolling, still, still, rolling])


@pytest.mark.parametrize(("fallen", "absent"), [(3, False), (4, False), (3, True)])
def test_wheels_leap_within_a_block_if_all_that_are_there_do(runner: Runner, fallen: int, absent: bool) -> None:
    of = next(one for one in runner.judges if isinstance(one, LeapJudge))
    wheels = list(runner.sensors).index("wheel_speeds")
    spins, stamps = np.full((6, 4), SPIN), [round(1e9 * (1 + i * STEP)) for i in range(6)]
    spins[3:, :fallen] = 0.0
    if absent:
        spins[2:, 3] = np.nan
    of.roll(Rolled(stamps, spins, Event(wheels, stamps[-1], spins[-1], np.ones(4))))
    assert of.is_open(wheels) is (fallen == 4 or absent)


def test_wheels_that_lock_one_by_one_have_not_leapt(runner: Runner) -> None:
    assert not is_open_after(runner, [[0.0] * i + [SPIN] * (4 - i) for i in range(5)])


def test_a_car_that_brakes_as_hard_as_a_racing_car_has_not_leapt(runner: Runner) -> None:
    assert not is_open_after(runner, [[SPIN - 150.0 * STEP * i] * 4 for i in range(40)])


def test_wheels_that_were_silent_while_the_car_stopped_have_not_leapt(runner: Runner) -> None:
    assert not is_open_after(runner, [[SPIN] * 4, [0.0] * 4], step=3.0)


def test_wheels_that_the_filter_uses_again_are_back(runner: Runner) -> None:
    assert is_open_after(runner, [[SPIN] * 4, [0.0] * 4])
    runner.health[list(runner.sensors).index("wheel_speeds")].used += 3
    assert not is_open_after(runner, [[0.0] * 4])
