"""Which figures of a table count as near to the printed ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies import leung, leung_experiments
from studies.leung_models import COLUMNS_5_3
from studies.leung_verdict import Cause, Shape, judged, show
from vsense_ros.evaluate.terminal import PlainConsole
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle


def within(ours: float, printed: float, extent: float, shape: Shape) -> bool:
    rows = {"DO35": {"figure": {"ours": ours, "printed": printed, "range": extent}}}
    return next(judged(rows, lambda row, title: shape)).within


@pytest.mark.parametrize(
    ("quantity", "kind", "ours", "printed", "extent", "near"),
    [
        ("yaw", "N", 0.69, 1.0, 1.0, False),
        ("yaw", "N", 0.71, 1.0, 1.0, True),
        ("yaw", "N", 1.31, 1.0, 1.0, False),
        ("yaw", "N", 0.025, 0.04, 1.0, True),  # 0.035 is printed as 0.04
        ("yaw", "N", 0.024, 0.04, 1.0, False),
        ("lateral_velocity", "N", 12.9, 10.0, 1.0, True),
        ("lateral_velocity", "N", 13.1, 10.0, 1.0, False),
        ("lateral_velocity", "N", 7.6, 10.0, 1.0, False),
        ("side_slip", "N", 20.0, 10.0, np.radians(0.4), True),  # of a range of 0.4° 10 % are 0.04°
        ("side_slip", "N", 20.0, 10.0, np.radians(0.6), False),
        ("lateral_velocity", "V", 1.68, 1.0, 1.0, True),  # of squares, √1.68 = 1.296
        ("lateral_velocity", "V", 1.70, 1.0, 1.0, False),
    ],
)
def test_headings_are_near_within_30_percent_and_side_slips_within_a_factor_of_1_3_or_where_degrees_are_alike(
    quantity: str, kind: str, ours: float, printed: float, extent: float, near: bool
) -> None:
    assert within(ours, printed, extent, Shape(quantity, kind)) is near


def test_what_is_elsewhere_is_told_by_its_cause() -> None:
    rows = {
        "DO35": {"psi N": {"ours": 2.0, "printed": 1.0, "range": 1.0}, "b_r R": {"ours": 9.0, "printed": 1.0}},
        "LC35": {"psi N": {"ours": 1.0, "printed": 1.0, "range": 1.0}},
    }
    shapes = {"psi N": Shape("yaw", "N"), "b_r R": Shape("gyro_bias", "R")}
    console = PlainConsole(width=200)
    with console.capture() as capture:
        every = list(judged(rows, lambda row, title: shapes[title]))
        show("4.2", every, [Cause("4.2", "psi", ("DO",), "the bus")], console)
    text = capture.get()
    assert "Table 4.2: 1 of 2" in text
    assert "0 better, 1 worse" in text
    assert "the bus" in text


def test_every_cause_is_of_a_table_and_a_column_that_exist() -> None:
    from studies.leung_causes import CAUSES

    for cause in CAUSES:
        assert cause.table in leung.NAMES
        if cause.table in leung.TABLES:
            assert any(cause.column in column.title for column in leung.TABLES[cause.table].columns)


def test_every_experiment_is_of_a_figure_that_the_thesis_prints_and_changes_one_plant(tmp_path: Path) -> None:
    for change, figures in leung_experiments.EXPERIMENTS:
        file = leung_experiments.plant_with(change.numbers, tmp_path)
        values = load_vehicle(vehicle_path(file)).values()
        assert all(values[name] == pytest.approx(value) for name, value in change.numbers.items())
        for table, row, column in figures:
            assert row in (leung.TABLES[table].manoeuvres if table in leung.TABLES else leung.ROWS)
            titles = [c.title for c in leung.TABLES[table].columns] if table in leung.TABLES else COLUMNS_5_3
            assert column in titles
