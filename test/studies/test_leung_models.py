"""Chapter 3 and section 5.2 of Leung 2010: what needs no plant comes out as printed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from studies import leung_models as leung
from studies import leung_models_picture
from vsense_ros.manoeuvre.driver import SpeedKeeper, steady_steering
from vsense_ros.model.handling.bicycle_2dof import Bicycle2Dof
from vsense_ros.model.handling.response import Response
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle


def test_table_5_2_is_what_the_thesis_prints() -> None:
    for row in leung.table_5_2().values():
        for column, cell in row.items():
            if cell["printed"] is not None:
                assert cell["ours"] == pytest.approx(cell["printed"], rel=5e-3), column


def test_sensitivities_are_finite_differences() -> None:
    for speed in (5.0, 10.0):
        at = leung.sensitivities(speed)
        for k, name in enumerate(leung.SENSITIVE_TO):
            step = 1e-6 * leung.CAR_5_1[name]
            near, far = (
                leung.sensitivities(speed, leung.CAR_5_1 | {name: leung.CAR_5_1[name] + sign * step})
                for sign in (-1, 1)
            )
            scale = leung.CAR_5_1["to_rear"] if name == "to_front" else 1.0
            for what in "AB":
                slope = scale * (far[what] - near[what]) / (2 * step)
                assert at[f"d{what}"][k] == pytest.approx(slope, rel=1e-5, abs=1e-12)


def test_a_matrix_of_norm_above_one_is_stable_all_the_same() -> None:
    """|A| = 1.2 at 10 m/s, of which the thesis concludes the opposite."""
    row = leung.table_5_2()["10 m/s"]
    assert row["|A|"]["ours"] > 1.2
    assert row["largest eigenvalue"]["ours"] == pytest.approx(0.866, abs=5e-4)


def wave(speed: float) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """A car, its steering and its speed for 20 s."""
    t = np.arange(0, 20, leung.STEP)
    return leung.CAR_5_1, 0.03 * np.sin(t) + 0.01 * np.sin(4 * t), np.full(len(t), speed)


def test_the_runs_side_by_side_are_those_of_scipy() -> None:
    numbers, steering, speed = wave(8.0)
    response = Response(Bicycle2Dof(), numbers)
    linear = response.linear(*response.straight(8.0))
    system = (linear.a, linear.b[:, [0]], np.eye(2), np.zeros((2, 1)))
    _, states, _ = signal.lsim(system, steering, np.arange(len(steering)) * leung.STEP)
    heading = np.concatenate([[0.0], np.cumsum((states[1:, 1] + states[:-1, 1]) / 2) * leung.STEP])
    truth = {"side_slip": states[:, 0], "yaw_rate": states[:, 1], "heading": heading}
    right = leung.bicycle_errors(numbers, steering, speed, truth)
    assert max(error.max() for error in right.values()) < 0.02
    masses = np.array([1.0, 0.5, 1.5])
    wrong = leung.bicycle_errors(numbers | {"mass": 1858.0 * masses}, steering, speed, truth)
    assert np.all(wrong["side_slip"][1:] > 1.0)
    assert wrong["side_slip"][0] == pytest.approx(right["side_slip"][0])


def test_a_bias_of_the_steering_shows_in_the_yaw_rate_as_its_share_of_the_range() -> None:
    """The row of table 5.3 that needs no plant: bias over range."""
    numbers, steering, speed = wave(8.0)
    bias = leung.STEERING_BIAS / 17.58
    slow = 0.05 * np.sin(0.3 * np.arange(len(steering)) * leung.STEP)
    truth = leung.model_truth(numbers, slow, speed)
    found = leung.bicycle_errors(numbers, slow + bias, speed, truth)
    assert found["yaw_rate"][0] == pytest.approx(100 * bias / np.ptp(slow), rel=0.05)


@pytest.mark.exam
def test_table_5_3_of_the_slow_lane_change_is_within_a_fifth_of_the_print_with_noise(tmp_path: Path) -> None:
    row = leung.table_5_3(tmp_path, "LC25")["LC25"]
    for column in ("beta noisy", "r noisy"):
        assert row[column]["ours"] == pytest.approx(row[column]["printed"], rel=0.2)
    assert row["r noisy"]["ours"] == pytest.approx(row["bias over range"]["ours"], rel=0.05)
    assert row["r clean"]["ours"] < 0.2


def errors_in_small_turns(car: Vehicle) -> dict[str, float]:
    """Errors of the linear model in a sine of the steering of 0.4 m/s² at 25 km/h."""
    speed = 25 / 3.6
    feet, angle = SpeedKeeper(car, lambda t: speed), steady_steering(car, speed, 0.4)
    q, u = rolling_straight(car, speed)
    drive = simulate(
        car, lambda t, q, u: np.array([angle * np.sin(2.0 * t), *feet(t, u)]), 6.0, keep_every=10, q=q, u=u
    )
    driven = np.hypot(drive.u[:, 0], drive.u[:, 1])
    found = leung.bicycle_errors(leung.numbers_of(car), drive.inputs[:, 0], driven, leung.truth_of(drive))
    return {key: float(value[0]) for key, value in found.items()}


@pytest.mark.exam
def test_a_full_car_that_cannot_roll_is_the_bicycle_in_small_turns() -> None:
    """What the linear model lacks of the saloon's side slip there is the swinging of its body."""
    saloon = leung.plant()
    changes = {"tyre.pneumatic_trail": 0.0, "antiroll_stiffness": 2e6, "tyre_stiffness": 4e6, "roll_centre_height": 0.0}
    stiff = saloon.with_parameters({f"{axle}.{key}": v for axle in ("front", "rear") for key, v in changes.items()})
    without, rolling = errors_in_small_turns(stiff), errors_in_small_turns(saloon)
    assert without["yaw_rate"] < 0.25
    assert without["side_slip"] < 0.25
    assert 1.0 < rolling["side_slip"] < 2.0


@pytest.mark.exam
def test_the_bode_plots_are_drawn(tmp_path: Path) -> None:
    for path in leung_models_picture.frequency_responses(tmp_path):
        assert path.read_bytes().startswith(b"\x89PNG")
