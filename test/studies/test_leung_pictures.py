"""The figures of Leung 2010 on filters: each is drawn from the drive that it names."""

from __future__ import annotations

import numpy as np
import pytest

from studies import leung_pictures as job
from studies.leung import ROWS, SHORT
from studies.leung_observers import OBSERVERS
from vsense_ros.assess.drives import Case, drive_plant, readings
from vsense_ros.assess.filter_run import follow
from vsense_ros.navigation.catalogue import FILTERS


def test_every_figure_names_a_drive_filters_and_quantities_that_exist_and_a_file_of_its_own():
    for figure in job.FIGURES:
        assert figure.row in {**ROWS, **SHORT}
        assert set(figure.filters) <= {*FILTERS.names, *OBSERVERS}
        assert set(figure.quantities) <= set(job.UNITS)
    assert len({figure.file for figure in job.FIGURES}) == len(job.FIGURES)
    assert {figure.row for figure in job.FIGURES if figure.file.startswith("figures_5_18")} == set(ROWS)


@pytest.mark.exam
def test_a_figure_shows_the_truth_of_its_drive_and_errors_against_it(tmp_path):
    figure = next(one for one in job.FIGURES if one.file == "figure_4_32_slalom")
    path = job.over_time(figure, tmp_path, tmp_path)
    assert path.stat().st_size > 20_000
    manoeuvre = SHORT[figure.row]
    truth = drive_plant(manoeuvre, "jaguar_saloon", tmp_path)
    case = Case(manoeuvre, 0, figure.errors)
    motions, at = follow("inertial", truth, case, readings(truth, case))
    shown = job._value("side_slip_error", motions, truth, at)
    assert np.degrees(np.abs(shown[truth.t[at] > 20])).max() < 1.5
    assert job._value("rolling_radius", motions, truth, at) is None
