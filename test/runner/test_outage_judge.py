"""What is stated in an outage of GNSS of a car whose accelerometer and gyro are wrong as those of cars are."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.estimation.timeline import Event
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.sensors import BodyVelocity
from vsense_ros.runner import Runner
from vsense_ros.runner.adapter import Apart
from vsense_ros.runner.outage_judge import OutageJudge

STEP = 0.04  # [s]
RATE = 0.1  # [rad/s]


def judge(vehicle: str) -> OutageJudge:
    runner = Runner(load_vehicle(vehicle_path(vehicle)))
    return next(one for one in runner.judges if isinstance(one, OutageJudge))


def without_gnss(of: OutageJudge, seconds: float) -> Apart:
    """What is unknown after so long in a bend without GNSS; the filter stands."""
    of.hear(Event(min(of.hears), 1, np.zeros(2), np.ones(2)))
    for i in range(round(seconds / STEP)):
        of.feel(round(1e9 * STEP * (i + 1)), STEP, [0.0, 0.0, RATE, 0.0, 0.0, 9.81])
    return of.apart or Apart()


@pytest.mark.parametrize("vehicle", ["genesis", "rav4"])
def test_between_two_messages_of_a_slow_receiver_nothing_is_added(vehicle: str) -> None:
    assert without_gnss(judge(vehicle), 1.2) == Apart()


def test_the_heading_errs_by_a_hundredth_of_the_angle_turned() -> None:
    assert without_gnss(judge("rav4"), 10.0).heading == pytest.approx(0.01 * RATE * 10.0, rel=0.01)


def test_the_speed_errs_by_an_acceleration_that_nobody_measures_once_it_is_unknown() -> None:
    of = judge("genesis")
    apart = without_gnss(of, 10.0)
    assert apart.ahead == pytest.approx(0.1 * 8.5, rel=0.02)
    assert apart.place == pytest.approx(0.1 * 8.5**2 / 2, rel=0.05)
    of.hear(Event(min(of.hears), 2, np.zeros(2), np.ones(2)))
    assert of.apart is None


def test_the_speed_is_as_well_known_as_before_while_an_optical_sensor_measures_it() -> None:
    car = load_vehicle(vehicle_path("genesis"))
    runner = Runner(car.model_copy(update={"sensors": {**car.sensors, "optical": BodyVelocity()}}))
    of = next(one for one in runner.judges if isinstance(one, OutageJudge))
    assert without_gnss(of, 10.0).ahead > 0.5
    optical = runner.intake.health[list(runner.sensors).index("optical")]
    optical.last_stamp = optical.last_received = 1
    assert without_gnss(of, 10.0).ahead == 0.0
