"""The study of filters: what it keeps, what it scores, and that a table says what its runs did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies import leung
from studies.leung_observers import BOUND, OBSERVERS
from studies.leung_study import estimate, study
from vsense_ros.assess.drives import Case, Error, Errors, Truth, readings, receiver
from vsense_ros.bag import datasets
from vsense_ros.errors import InputError
from vsense_ros.evaluate.terminal import PIPE_WIDTH, PlainConsole


def circle(seconds: float = 60.0, rate: float = 0.2, speed: float = 10.0) -> Truth:
    """A car that goes straight for 25 s, then in a circle, whose rear axle rolls without side slip."""
    t = np.arange(0.0, seconds, 0.01)
    turn = np.where(t > 25, rate, 0.0)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * 0.01)])
    lateral = 1.546 * turn
    forces = np.column_stack([-turn * lateral, turn * speed])
    spins = (speed + turn[:, None] * 0.768 * np.array([-1, 1, -1, 1])) / 0.29
    return Truth(t, yaw, np.full_like(t, speed), lateral, turn, forces, forces, 2.906 * turn / speed, spins)


def test_readings_have_the_errors_that_tables_b1_and_b2_say() -> None:
    truth = circle()
    read = readings(truth, Case("double_oval_15", 3))
    gyro, steering = read.imu[:, 2] - truth.yaw_rate, read.steering[:, 0] - truth.steer
    assert np.degrees(gyro.mean()) == pytest.approx(1.0, abs=0.01)
    assert np.degrees(gyro.std()) == pytest.approx(0.1, rel=0.05)
    assert np.degrees(steering.mean()) * 17.58 == pytest.approx(5.0, abs=0.1)
    assert (read.imu[:, 3:5] - truth.forces).std(axis=0) == pytest.approx([0.5, 0.5], rel=0.05)
    known = np.flatnonzero(np.isfinite(read.fixes[:, 0]))
    assert np.array_equal(known, np.arange(0, len(truth.t), 100))


def test_an_outage_is_silent_and_a_receiver_is_as_good_as_its_table_says() -> None:
    case = Case("double_oval_15", 0, receiver("consumer"), outage=(10.0, 20.0))
    read = readings(circle(), case)
    assert np.isnan(read.fixes[1000:2000]).all()
    assert case.errors.fix == 0.5
    with pytest.raises(InputError, match="no receiver 'good'; known are survey"):
        receiver("good")


def test_a_yaw_kkf_without_noise_finds_the_bias_and_the_heading() -> None:
    still = Errors(gyro=Error(1e-7, np.radians(1.0)), fix=1e-6)
    found = estimate("yaw_kkf", circle(), Case("double_oval_15", 0, still))
    assert np.degrees(found["yaw"]["rmse"]) < 0.02
    assert np.degrees(found["gyro_bias"]["rmse"]) < 0.001


def test_raw_fixes_are_scored_as_course_less_heading() -> None:
    """Its noise is σ_V / V (C8): 0.025 m/s at 10 m/s are 2.5 mrad."""
    runs = [estimate("yaw_kkf", circle(35.0), Case("double_oval_15", seed)) for seed in range(10)]
    assert np.mean([one["raw_side_slip"]["rmse"] for one in runs]) == pytest.approx(0.0025, rel=0.25)


@pytest.mark.exam
def test_what_a_study_has_done_it_does_not_do_again(tmp_path: Path) -> None:
    cases = [(Case("right_turn", 0, leung.SECTION_4_4), ("yaw_kkf", "inertial"))]
    first = study(cases, tmp_path)
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    shares: list[float] = []
    again = study(cases, tmp_path, shares.append)
    assert again == first
    assert {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()} == kept
    assert shares == [1.0]
    with pytest.raises(InputError, match="no filter 'yaw_kf', did you mean 'yaw_kkf'"):
        study([(Case("right_turn", 0), ("yaw_kf",))], tmp_path)


def test_every_table_names_filters_and_manoeuvres_that_exist_and_has_a_figure_for_each_column() -> None:
    from vsense_ros.manoeuvre import MANOEUVRES
    from vsense_ros.navigation.catalogue import FILTERS

    for table in leung.TABLES.values():
        assert all(len(figures) == len(table.columns) for figures in table.printed.values())
        assert all(column.filter in (*FILTERS.names, *OBSERVERS) for column in table.columns)
        assert all(table.manoeuvres[row] in MANOEUVRES for row in table.printed)
    with pytest.raises(InputError, match=r"no table '9\.9'"):
        leung.repeat(["9.9"], Path(), None)


def test_a_wide_table_comes_in_parts_of_which_no_figure_is_cut() -> None:
    figure = {"printed": 12.8077, "ours": 0.012345, "spread": 0.00234}
    headings = [column.title for column in leung.TABLES["5.5"].columns]
    console = PlainConsole(width=PIPE_WIDTH)
    with console.capture() as capture:
        leung.show({"5.5": {row: dict.fromkeys(headings, figure) for row in leung.ROWS}}, console)
    lines = capture.get().splitlines()
    assert capture.get().count("0.0123 ± 0.002 (12.8077)") == len(headings) * len(leung.ROWS)
    assert all(len(line) <= PIPE_WIDTH for line in lines[:-1])
    assert sum(line.startswith("DO15") for line in lines) == 4  # 12 columns of 27 characters


@pytest.mark.parametrize("frequency", [0.05, 0.3, 2.0])
def test_what_is_faster_than_a_second_is_a_waves_share_of_its_mean(frequency: float) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    fast = leung.fast_part(t, np.sin(2 * np.pi * frequency * t), 1.0)
    assert np.std(fast) == pytest.approx(abs(1 - np.sinc(frequency)) / 2**0.5, rel=0.02, abs=2e-3)


@pytest.mark.exam
def test_on_the_hardest_rows_the_error_ekf_has_at_most_half_the_error_of_the_thesis_and_none_beats_the_bound(
    tmp_path: Path,
) -> None:
    printed = leung.TABLES["5.5"].printed
    cases = [Case(leung.ROWS[row], 0, leung.ON_THE_BUS) for row in ("DO55", "LC55")]
    names = ("error_ekf", BOUND, "integrated")
    results = study([(case, names) for case in cases], tmp_path)
    found = leung.side_slips(results)
    for row in ("DO55", "LC55"):
        error, bound = (found[name][row]["beta_nrmsd_percent"] for name in ("error_ekf", BOUND))
        assert error <= 0.5 * printed[row][1]
        assert 0 < bound < min(error, found["integrated"][row]["beta_nrmsd_percent"])


@pytest.mark.exam
def test_on_the_third_genesis_lap_inertial_states_what_it_is_off_by():
    folder = datasets.find("genesis_oxts_can")
    if folder is None:
        pytest.skip("the Genesis laps are not here")
    for rate in (1.0, 10.0):
        found = leung.genesis_run(folder if folder.is_dir() else folder.parent, rate, "inertial")["inertial"]
        assert 0.5 < found[f"NEES of beta, {rate:g} Hz"]["ours"] < 2.0
        assert found[f"beta RMSE [°], {rate:g} Hz"]["ours"] < 0.2
