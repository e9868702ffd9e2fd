"""What the guard does with filters that have diverged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import ortho_group

from drives import feed, messages
from vsense_ros.bag import datasets
from vsense_ros.cli import main
from vsense_ros.cli.common import DIVERGED
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import ROLL
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.state import FORWARD
from vsense_ros.runner import Runner, steering_judge
from vsense_ros.runner.guard import GUARD, is_covariance
from vsense_ros.runner.vote_settings import STEERING


@pytest.fixture
def driving(vehicle: Vehicle, lane_change: Recording) -> Runner:
    """The observer after a third of the drive, in which it was looked at as often as it would be published."""
    runner = Runner(vehicle, lane_change.map_origin)
    every = messages(lane_change)
    for sample in every[: len(every) // 3]:
        feed(runner, [sample])
        if runner.started and runner.guard.due(runner.stamp):
            runner.snapshot()
    assert runner.converged
    return runner


def test_a_car_that_would_lie_on_its_side_goes_back_to_its_last_good_state_and_reports_it(driving: Runner) -> None:
    before = driving.filter.car.mean.copy()  # type: ignore[attr-defined]
    driving.filter.set_element(ROLL, np.radians(70), 0.01)  # type: ignore[attr-defined]
    driving.guard._looked = 0  # the time to look has come
    driving.snapshot()
    after = driving.filter.car.mean  # type: ignore[attr-defined]
    assert abs(after[ROLL] - before[ROLL]) < np.radians(2)
    assert abs(after[FORWARD] - before[FORWARD]) < 1.0
    assert driving.started
    assert "lean by 70°" in driving.diagnostics()[0].message


def test_a_filter_that_keeps_diverging_is_given_up_and_nothing_of_it_is_published(driving: Runner) -> None:
    for _ in range(GUARD.most_recoveries):
        assert driving.started
        driving._restore("its forces are wrong")
    assert not driving.started
    assert driving.estimate() == []
    own = driving.diagnostics()[0]
    assert own.level == Level.ERROR
    assert "its forces are wrong" in own.message


def test_a_filter_that_was_given_up_starts_anew_after_a_pause(driving: Runner, lane_change: Recording) -> None:
    stopped = driving.stamp
    for _ in range(GUARD.most_recoveries):
        driving._restore("its forces are wrong")
    later = [sample for sample in messages(lane_change) if sample.stamp > stopped]
    feed(driving, [sample for sample in later if sample.stamp < stopped + 0.9e9 * GUARD.pause])
    assert not driving.started
    feed(driving, [sample for sample in later if sample.stamp > stopped + GUARD.pause * 1e9])
    assert driving.started


def test_forces_that_stay_the_same_while_the_car_moves_are_a_sign_and_at_standstill_are_not(driving: Runner) -> None:
    guard, snapshot = driving.guard, driving.snapshot()
    vitals = driving.adapter.vitals(snapshot)
    guard.begin(driving.stamp)
    standing = [guard.look(driving.stamp + i * 10**8, vitals._replace(speed=0.0)) for i in range(40)]
    moving = [guard.look(driving.stamp + i * 10**8, vitals._replace(speed=20.0)) for i in range(40, 60)]
    assert not any(standing)
    assert "forces have not changed for 1.0 s" in moving[GUARD.looks_until_frozen - 1]


def test_the_tyres_of_a_car_on_the_road_carry_its_weight(driving: Runner) -> None:
    assert driving.adapter.vitals(driving.snapshot()).load == pytest.approx(1.0, abs=0.2)


def test_a_speed_that_is_not_known_is_a_sign_once_the_start_is_over(driving: Runner) -> None:
    vitals = driving.adapter.vitals(driving.snapshot())._replace(speed_deviation=11.0)
    driving.guard.begin(0)
    assert not driving.guard.look(10**9, vitals)
    assert "known to 11 m/s" in driving.guard.look(int(GUARD.settling * 1e9) + 10**8, vitals)


@pytest.mark.parametrize(("least", "expected"), [(1e-3, True), (0.0, True), (-1e-3, False), (np.nan, False)])
def test_a_covariance_has_no_negative_eigenvalue(least: float, expected: bool) -> None:
    turned = ortho_group.rvs(6, random_state=1)
    units = np.diag([1e-6, 1.0, 1e3, 1.0, 1e-3, 10.0])
    assert is_covariance(units @ turned @ np.diag([least, 1, 1, 2, 3, 4]) @ turned.T @ units) is expected


def test_the_observer_of_an_undisturbed_drive_is_never_sent_back(clean: Runner) -> None:
    assert (clean.faults, clean.restarts) == (0, 0)
    assert not clean.guard.failures


def test_a_run_whose_filter_diverged_ends_with_three_and_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither steering angle nor inertial sensors are in the recording of this drive on a course, and the filter takes
    it that nobody steers."""
    monkeypatch.setattr(steering_judge, "STEERING", replace(STEERING, density=0.0))
    path = datasets.data_dir() / "racelogic_brake_stop" / "ExampleBrakeStop.vbb"
    if not path.exists():
        pytest.skip(f"needs the recording racelogic_brake_stop; looked in {path.parent}")
    result = CliRunner().invoke(main, ["run", str(path), "--vehicle", "genesis", "--out", str(tmp_path)])
    assert result.exit_code == DIVERGED
    assert "the filter diverged" in result.output
    assert "nothing was heard of imu, steering" in result.output
