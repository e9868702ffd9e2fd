"""The examination on the Genesis: on recordings that no model of ours made."""

from pathlib import Path

import pytest

from studies import genesis as job
from studies.side_slip_fit import SideSlipFit
from vsense_ros.bag import datasets
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.parameter_set import of_vehicle, with_values

EXTENDED = Path(__file__).parents[2] / "docs/examples/genesis/vehicle.extended.yaml"


@pytest.mark.exam
def test_side_slip_without_measuring_it_beats_the_formulas_and_reaches_what_was_asked_for():
    folder = datasets.find("genesis_oxts_can")
    if folder is None:
        pytest.skip("the Genesis recordings are not here: set VSENSE_DATA or run `vsense datasets fetch`")
    folder = folder if folder.is_dir() else folder.parent
    results = job.examine(folder, load_vehicle(vehicle_path("genesis"))).figures()
    limits = {"10hz": (0.16, 3.5), "1hz": (0.22, 5.0), "outage": (0.30, float("inf"))}
    for case, (side_slip, lateral_velocity) in limits.items():
        assert results[case]["side_slip_rmse_deg"] <= side_slip, case
        assert results[case]["lateral_velocity_nrmsd_percent"] <= lateral_velocity, case
    for formula in ("regression", "kinematic"):
        assert results["10hz"]["side_slip_rmse_deg"] < results[formula]["side_slip_rmse_deg"]


@pytest.mark.exam
def test_with_what_explain_found_the_observer_knows_the_side_slip_better_with_gnss_and_without():
    """Explain was given no side slip. The mounting of the reference is fitted: its place counts from the centre of
    gravity, which explain has estimated to be elsewhere."""
    folder = datasets.find("genesis_oxts_can")
    if folder is None:
        pytest.skip("the Genesis recordings are not here: set VSENSE_DATA or run `vsense datasets fetch`")
    folder = folder if folder.is_dir() else folder.parent
    stated = load_vehicle(vehicle_path("genesis_identified")).reference
    before, after = (
        job.side_slip(folder, load_vehicle(path), stated) for path in (vehicle_path("genesis_start"), EXTENDED)
    )
    assert after["side_slip_without_constant_deg"] <= 0.17
    assert after["side_slip_without_constant_deg"] < before["side_slip_without_constant_deg"]
    assert after["outage_without_constant_deg"] <= before["outage_without_constant_deg"]
    assert after["side_slip_deg"] < before["side_slip_deg"]


def test_the_identified_car_differs_from_where_the_search_began_in_the_free_parameters_alone():
    found, start = (load_vehicle(vehicle_path(name)) for name in ("genesis_identified", "genesis_start"))
    values, known = (of_vehicle(car).values for car in (found, start))
    searched = {name for parameter in job.FREE_PARAMETERS for name in parameter.names(known)} | {"reference.yaw"}
    assert {name for name, value in values.items() if value != known[name]} <= searched
    assert with_values(found, of_vehicle(start)) == start.model_copy(update={"source": found.source})


def test_identification_says_in_the_vehicle_file_what_was_fitted(monkeypatch: pytest.MonkeyPatch):
    start = load_vehicle(vehicle_path("genesis_start"))
    monkeypatch.setattr(job, "fit_side_slip", lambda vehicle, *_, progress: SideSlipFit(vehicle, (), ()))
    source = job.identify(start, []).vehicle.source
    assert source == load_vehicle(vehicle_path("genesis_identified")).source


def test_the_third_lap_is_not_among_those_that_are_searched_on():
    assert job.EXAMINED_ON not in job.IDENTIFIED_FROM
