"""Side slip at which tyres do not hold the force that an accelerometer feels."""

from __future__ import annotations

import re

import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.observer.state import FORWARD, LATERAL, YAW_RATE
from vsense_ros.runner import Runner
from vsense_ros.runner.slip_judge import SlipJudge

SPEED = 15.0  # [m/s]
SAID = re.compile(r"lateral velocity is \d\.\d m/s from what the lateral force that is felt allows")


def judged(lateral: float, yaw_rate: float, felt: float, seconds: float = 3.0, then: float = 0.0) -> SlipJudge:
    """The judge after some seconds at a lateral velocity [m/s] and a yaw rate [rad/s] by the filter, and a lateral
    acceleration [m/s²]; `then` so many straight ahead."""
    runner = Runner(load_vehicle(vehicle_path("rav4")))
    runner.adapter.alignment.known = True  # type: ignore[attr-defined]
    of = next(one for one in runner.judges if isinstance(one, SlipJudge))
    mean = runner.adapter.car.mean  # type: ignore[attr-defined]
    mean[FORWARD], mean[LATERAL], mean[YAW_RATE] = SPEED, lateral, yaw_rate
    for i in range(round((seconds + then) / 0.04)):
        straight = 0.04 * i > seconds
        if straight:
            mean[LATERAL] = mean[YAW_RATE] = 0.0
        of.feel(round(1e9 * (1 + 0.04 * i)), 0.04, [0.0, 0.0, yaw_rate, 0.0, 0.0 if straight else felt, 9.81])
    return of


def test_a_car_that_turns_as_its_tyres_are_felt_to_push_it_slips_as_it_may() -> None:
    of = judged(0.15, 0.2, 0.2 * SPEED)
    assert of.apart is None
    assert of.doubts == []


@pytest.mark.parametrize("side", [-1, 1])
def test_while_the_estimate_slides_and_hardly_any_force_is_felt_it_is_as_uncertain_as_it_slides(side: int) -> None:
    of = judged(3.0 * side, -0.3 * side, 0.5 * side)
    assert of.apart is not None
    assert 2.5 < of.apart.across < 4.5
    (doubt,) = of.doubts
    assert SAID.fullmatch(doubt)


def test_where_so_much_force_is_felt_that_tyres_may_slide_nothing_is_doubted() -> None:
    assert judged(-3.0, 0.6, 0.6 * SPEED).apart is None


def test_side_slip_that_is_over_is_forgotten() -> None:
    assert judged(-2.0, 0.2, 0.2 * SPEED).doubts
    assert judged(-2.0, 0.2, 0.2 * SPEED, then=6.0).doubts == []


@pytest.mark.parametrize("bag", ["double_lane_change", "sine_with_dwell"])
def test_tyres_of_a_car_that_is_steered_quickly_are_not_said_to_slide(bag: str) -> None:
    recording = import_recording(shared_folder("bags") / bag)
    runner = Runner(load_vehicle(vehicle_path("prototype_model")), recording.map_origin)
    of = next(one for one in runner.judges if isinstance(one, SlipJudge))
    for sample in recording.samples(tuple(topic for topic in runner.topics if topic in recording)):
        runner.add(sample)
        assert not of.doubts
