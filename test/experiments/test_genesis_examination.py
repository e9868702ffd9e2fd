"""The examination on the Genesis: on recordings that no model of ours made."""

from pathlib import Path
from typing import Any

import pytest

from vsense_ros.bag import datasets
from vsense_ros.experiments import genesis as job
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

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


def test_the_identified_car_differs_from_where_the_search_began_in_the_knobs_alone():
    files = ("genesis_identified", "genesis_start")
    found, start = (load_vehicle(vehicle_path(name)).model_dump(mode="json") for name in files)
    searched = {path for parameter in job.KNOBS for path in parameter.powers} | {"reference.yaw", "source"}
    assert {path.rstrip(".012") for path in _differences(found, start)} <= {path.rstrip(".012") for path in searched}


def test_the_third_lap_is_not_among_those_that_are_searched_on():
    assert job.EXAMINED_ON not in job.IDENTIFIED_FROM


def _differences(one: Any, other: Any, path: str = "") -> set[str]:
    if isinstance(one, dict | list):
        assert len(one) == len(other)
        keys = one.keys() if isinstance(one, dict) else range(len(one))
        return {p for key in keys for p in _differences(one[key], other[key], f"{path}{key}.")}
    return set() if one == other else {path.rstrip(".")}
