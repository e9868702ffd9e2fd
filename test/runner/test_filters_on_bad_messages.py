"""Receivers that lie, and cars that stand: no number that is none, and no certainty that is wrong without a word."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from marks import exam_except
from sine_drive import SineDrive, car_of_sine_drive, with_velocity, without_velocity
from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import compare
from vsense_ros.evaluate.signals import read_signals, wrap
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.run import Run, run
from vsense_ros.runner.smoothing import run_smoothed

KINEMATIC = ("dual_kkf", "inertial", "strapdown")
BY_MODEL = ("integrated", "integrated_kf_a")


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return car_of_sine_drive()


def finite(found: Run) -> bool:
    """True if the car's speed is known, and each number is there always or, where the filter does not estimate it,
    never."""
    speed = found.output["vsense/odometry"].columns["linear"][:, 0]
    return bool(np.isfinite(speed).all()) and all(
        name == "vector"  # a side slip at rest has an infinite deviation
        or bool(np.all(np.isfinite(column).all(axis=0) | np.isnan(column).all(axis=0)))
        for channel in found.output.channels.values()
        for name, column in channel.columns.items()
    )


def yaw_error(found: Run, recording: Recording, after: float = 0.0) -> np.ndarray:
    """Over its standard deviation, at the times of the estimates later than `after` [s]."""
    mine, true = read_signals(found.output, "vsense")["yaw"], read_signals(recording, "reference")["yaw"]
    truth = np.interp(mine.stamp, true.stamp, np.unwrap(true.value[:, 0]))
    late = (mine.stamp - true.stamp[0]) * 1e-9 > after
    assert mine.deviation is not None
    return wrap(mine.value[late, 0] - truth[late]) / mine.deviation[late]


@pytest.mark.parametrize("heading", exam_except([0.0, 90.0, 180.0, 270.0, 179.0], 179.0))
def test_a_course_across_north_south_and_180_degrees_is_an_angle_like_any_other(car: Vehicle, heading: float) -> None:
    drive = SineDrive(25.0, np.radians(heading)).recording()
    found = run(drive, car, "dual_kkf")
    assert finite(found)
    assert np.degrees(compare(found.output, drive)["yaw"].rmse) < 0.7


LIES: dict[str, Callable[[Recording], Recording]] = {
    "jumps": lambda r: with_velocity(r, lambda v: v + (np.arange(len(v)) % 15 == 3)[:, None] * [30.0, -20.0, 0.0]),
    "is gone for good": lambda r: without_velocity(r, 20.0, 1e9),
    "is gone in a bend": lambda r: without_velocity(r, 14.0, 19.0),
    "is no number": lambda r: with_velocity(r, lambda v: np.full_like(v, np.nan)),
    "is no number now and then": lambda r: with_velocity(
        r, lambda v: np.where(np.arange(len(v))[:, None] % 2, v, np.nan)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", exam_except(KINEMATIC, "inertial"))
@pytest.mark.parametrize("lie", LIES)
def test_a_receiver_that(car: Vehicle, name: str, lie: str) -> None:
    """… does this leaves finite estimates whose errors the filter knows."""
    drive = LIES[lie](SineDrive(25.0).recording())
    found = run(drive, car, name, rate=20.0)
    assert finite(found)
    assert np.percentile(np.abs(yaw_error(found, drive, 12.0)), 95) < 6.0


@pytest.mark.parametrize("name", exam_except(BY_MODEL, "integrated"))
def test_models_that_do_not_fit_survive_a_receiver_that_jumps(car: Vehicle, name: str) -> None:
    drive = LIES["jumps"](SineDrive(25.0).recording())
    found = run(drive, car, name, rate=20.0)
    assert finite(found)
    assert np.degrees(compare(found.output, drive)["yaw"].rmse) < 3.0


def test_a_receiver_that_repeats_its_messages_tells_nothing_new(car: Vehicle) -> None:
    drive = SineDrive(20.0).recording()
    channel = drive["gps/velocity"]
    twice = channel.select(np.repeat(np.arange(len(channel)), 2))
    repeated = replace(drive, channels={**drive.channels, "gps/velocity": twice})
    once, again = run(drive, car, "inertial"), run(repeated, car, "inertial")
    assert np.array_equal(
        once.output["vsense/odometry"].columns["linear"],
        again.output["vsense/odometry"].columns["linear"],
        equal_nan=True,
    )
    velocity = next(line for line in again.diagnostics if line.name == "velocity")
    assert int(velocity.values["invalid"]) == len(channel)


def test_a_receiver_that_freezes_is_refused_and_told(car: Vehicle) -> None:
    """From 15 s on it repeats one velocity while the car turns: at most a few seconds are believed."""
    drive = with_velocity(SineDrive(30.0).recording(), lambda v: np.repeat(v[:1], len(v), axis=0), 15.0)
    found = run(drive, car, "inertial")
    velocity = next(line for line in found.diagnostics if line.name == "velocity")
    assert velocity.level != Level.OK
    assert int(velocity.values["refused"]) > 20
    assert finite(found)


def test_nothing_starts_before_the_car_moves_and_that_is_told(car: Vehicle) -> None:
    drive = SineDrive(30.0, stands=10.0)
    runner = Runner(car, make=every_filter()["inertial"].make)
    for sample in drive.recording().samples():
        runner.add(sample)
        if sample.stamp - 1_600_000_000_000_000_000 > 5e9:
            break
    assert not runner.started
    assert runner.estimate() == []
    assert "heading unknown until the car moves" in runner.diagnostics()[0].message
    found = run(drive.recording(), car, "inertial")
    assert finite(found)
    assert np.abs(yaw_error(found, drive.recording(), 20.0)).max() < 6.0


def test_what_the_sensors_cannot_tell_is_said_in_the_diagnostics(car: Vehicle) -> None:
    """On the straight the course alone tells nothing of the radius of the wheels (Leung 2010, figure 4.9)."""
    drive = SineDrive(8.0).recording()
    found = run(drive, car, "wheel_speed_ekf_a")
    assert found.diagnostics[0].level == Level.WARN
    assert found.diagnostics[0].message == "not determined so far: rolling_radius"
    _, deviation = found.parameters["rolling_radius"]
    assert deviation > 0.01


def test_a_filter_without_its_sensor_is_refused_with_its_name(car: Vehicle) -> None:
    poor = car.model_copy(update={"sensors": {k: s for k, s in car.sensors.items() if k != "wheel_speeds"}})
    with pytest.raises(
        InputError, match="'triple_kkf' needs the input spin_rear_left, of a sensor that measures 'rolling"
    ):
        Runner(poor, make=every_filter()["triple_kkf"].make)


@pytest.mark.exam
def test_smoothing_halves_the_error_between_rare_fixes(car: Vehicle) -> None:
    drive = SineDrive(40.0).recording(gnss_every=100)
    forward, backward = run(drive, car, "inertial"), run_smoothed(drive, car, "inertial")
    lagged = run_smoothed(SineDrive(15.0).recording(gnss_every=100), car, "inertial", lag=1.0)
    errors = [compare(one.output, drive)["lateral_velocity"].rmse for one in (forward, backward)]
    assert errors[1] < 0.7 * errors[0]
    assert finite(lagged)


def test_only_a_filter_of_one_state_space_is_smoothed(car: Vehicle) -> None:
    with pytest.raises(InputError, match="dual_kkf: only an extended Kalman filter of one state space"):
        run_smoothed(SineDrive(5.0).recording(), car, "dual_kkf")
