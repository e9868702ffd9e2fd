"""The thesis's implementation tables again."""

from __future__ import annotations

import pytest

from studies.implementation import FULL_SETS, HIS, KERNEL_SETS, Case, every_case, implementations, shares
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

VEHICLE = load_vehicle(vehicle_path("prototype_model"))


def test_every_figure_of_the_thesis_has_a_line_but_those_of_kernels_that_the_full_car_lacks() -> None:
    lines = set(every_case())
    without = {key for key in HIS if Case(key[0], key[1], key[2], key[3], key[4]) not in lines}
    assert {(key[0], key[2]) for key in without} == {("full", "suspension")}


@pytest.mark.exam
@pytest.mark.parametrize(("car", "names"), [("simplified", tuple(KERNEL_SETS)), ("full", FULL_SETS)])
def test_kernels_add_no_iteration_and_change_no_force(car: str, names: tuple[str, ...]) -> None:
    rows = implementations(
        VEHICLE, lambda share: None, [Case(car, "errorEKF", name, 4, 1e-5) for name in names], short=True
    )
    alone, *others = rows
    assert alone.kernels == "none"
    assert alone.difference == alone.clocks == alone.accelerator_us == 0
    for row in others:
        assert row.iterations <= 1.05 * alone.iterations
        assert 0 < row.difference < 1e-3
        assert row.clocks > 0
        assert row.fallbacks == 0
    # The link eats the mass matrix of the full car, as his.
    assert next(row for row in others if row.kernels == "mass matrix").seconds > alone.seconds
    found = shares(VEHICLE, rows)[f"{car} errorEKF"]
    assert all(0 < share < 60 for share in found.values())
