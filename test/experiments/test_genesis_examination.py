"""The examination on the Genesis: on recordings that no model of ours made."""

from pathlib import Path

import pytest

from vsense_ros.bag import datasets
from vsense_ros.experiments import genesis as job
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identify.parameter_set import of_vehicle, with_values
from vsense_ros.identify.side_slip import SideSlipFit

EXTENDED = Path(__file__).parents[2] / "docs/examples/genesis/vehicle.extended.yaml"


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


@pytest.mark.xfail(
    strict=True,
    reason="the answer was found with a flat road; since roads bend, the observer without it has 0.229 deg at "
    "10 Hz, and with it 0.225 deg: explain has to look again",
)
@pytest.mark.slow
def test_with_what_explain_found_the_observer_knows_the_side_slip_better_while_gnss_comes():
    """Which explain was not given. The reference is where the two other laps tell that it is."""
    folder = datasets.find("genesis_oxts_can")
    if folder is None:
        pytest.skip("the Genesis recordings are not here: set VSENSE_DATA or run `vsense datasets fetch`")
    reference = load_vehicle(vehicle_path("genesis_identified")).reference

    def side_slip(vehicle: Path) -> dict[str, float]:
        car = load_vehicle(vehicle).model_copy(update={"reference": reference})
        results = job.examine(folder if folder.is_dir() else folder.parent, car)
        return {case: figures["side_slip_rmse_deg"] for case, figures in results.items()}

    before, after = side_slip(vehicle_path("genesis_start")), side_slip(EXTENDED)
    assert after["10hz"] < 0.85 * before["10hz"]
    assert after["1hz"] < before["1hz"]


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
