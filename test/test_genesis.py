"""The examination on the Genesis: on recordings that no model of ours made."""

import pytest

from vsense_ros import genesis as job
from vsense_ros.bag import datasets
from vsense_ros.shared_files import vehicle_path
from vsense_ros.vehicle_file import load_vehicle


@pytest.mark.slow
def test_side_slip_without_measuring_it_beats_the_formulas_and_reaches_what_was_asked_for():
    folder = datasets.find("genesis_oxts_can")
    if folder is None:
        pytest.skip("the Genesis recordings are not here: set VSENSE_DATA or run `vsense datasets fetch`")
    results = job.examine(folder if folder.is_dir() else folder.parent, load_vehicle(vehicle_path("genesis")))
    limits = {"10hz": (0.16, 3.5), "1hz": (0.22, 5.0), "outage": (0.30, float("inf"))}
    for case, (side_slip, lateral_velocity) in limits.items():
        assert results[case]["side_slip_rmse_deg"] <= side_slip, case
        assert results[case]["lateral_velocity_nrmsd_percent"] <= lateral_velocity, case
    for formula in ("regression", "kinematic"):
        assert results["10hz"]["side_slip_rmse_deg"] < results[formula]["side_slip_rmse_deg"]


def test_the_third_lap_is_not_among_those_that_are_searched_on():
    assert job.EXAMINED_ON not in job.IDENTIFIED_FROM
