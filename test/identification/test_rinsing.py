"""A car whose parameters are known is identified from a drive by sensors that are noisy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies import best_twin
from studies.best import FREE, HEIGHTS, TRUTH, curve_errors, wrong_start
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification import best
from vsense_ros.identification.identification import check_free
from vsense_ros.identification.information import Information, information, refusals
from vsense_ros.identification.online import OnlineIdentification
from vsense_ros.identification.open_loop import OpenLoop
from vsense_ros.identification.rinsing import Drive, rinse
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import PAPER, Best4Dof


@pytest.fixture(scope="module")
def drive() -> Drive:
    return best_twin.drive(best_twin.rich_driver(0), 60.0).recorded(0, cut_off=best.SETTINGS.cut_off)


def test_passes_find_the_car_from_a_start_that_is_thirty_percent_off(drive: Drive) -> None:
    start = wrong_start(3)
    found = rinse(best.identifier(start, FREE), [drive])
    assert found.settled
    assert len(found.passes) <= 10
    assert curve_errors(found.values).max() < 0.03
    assert np.abs(found.values / TRUTH - 1)[:4].max() < 0.04  # heights, inertia, roll


@pytest.mark.exam
def test_free_roll_centres_cannot_be_told_apart_from_the_height_of_the_car(drive: Drive) -> None:
    free = (*FREE, *HEIGHTS)
    one = best.identifier(PAPER, free)
    told = information(one, [drive], one.begin(), best.prior(PAPER, free))
    assert {"cog_height", *HEIGHTS} <= {refusal.name for refusal in refusals(told, best_4dof.JUDGED_BY_CURVE)}
    without = best.identifier(PAPER, FREE)
    told = information(without, [drive], without.begin(), best.prior(PAPER, FREE))
    assert "cog_height" not in {refusal.name for refusal in refusals(told, best_4dof.JUDGED_BY_CURVE)}


def test_no_longer_drive_makes_a_parameter_surer_than_errors_of_form_leave_it() -> None:
    endless = Information(("a", "b"), np.array([2.0, 3.0]), np.ones(2), 1e12 * np.eye(2), form=np.array([0.012, 0.005]))
    assert endless.deviations == pytest.approx([0.024, 0.015], rel=1e-3)
    assert endless.without("a").deviations == pytest.approx([0.015], rel=1e-3)


def test_sensitivities_are_what_small_changes_make(drive: Drive) -> None:
    model, step = OpenLoop(Best4Dof(), PAPER, FREE), 1e-6
    short = drive.part(0, 500, drive.start)
    outputs, by = model.sensitivities(short, TRUTH)
    for i in (0, 1, 6, 9):
        changed = TRUTH.copy()
        changed[i] *= 1 + step
        differences = (model.outputs(short, changed) - outputs) / (step * TRUTH[i])
        assert by[:, :, i] == pytest.approx(differences, abs=2e-4 * np.abs(by[:, :, i]).max())


def test_a_parameter_that_starts_at_its_bound_or_is_unknown_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"front_curvature starts at 1"):
        best.identifier(PAPER | {"front_curvature": 1.0}, FREE)
    with pytest.raises(InputError, match="nearest are front_peak"):
        check_free(["front_peek"], Best4Dof.parameters, "best")


@pytest.mark.exam
def test_a_stored_set_is_taken_by_its_own_car_alone(tmp_path: Path) -> None:
    car = load_vehicle(vehicle_path("rav4"))
    OnlineIdentification(car).save(tmp_path / "set.json")
    assert OnlineIdentification(car, tmp_path / "set.json").sample().names
    heavier = car.with_parameters({"chassis.mass": 1800.0})
    with pytest.raises(InputError, match="belongs to one vehicle"):
        OnlineIdentification(heavier, tmp_path / "set.json")
    (tmp_path / "set.json").write_text("{}")
    with pytest.raises(InputError, match="expected parameters"):
        OnlineIdentification(car, tmp_path / "set.json")
