"""Filters by name: the same ones in the command, in the node and in a program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drives import feed, messages
from marks import exam_except
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.spi import Spi
from vsense_ros.runner import Runner


def test_all_filters_are_listed_on_request_and_otherwise_those_for_use_on_a_car() -> None:
    every = CliRunner().invoke(main, ["filters", "--all"], terminal_width=200).output.split()
    listed = CliRunner().invoke(main, ["filters"], terminal_width=200).output.split()
    assert {family.name for family in FILTERS} <= set(every)
    assert "error_ekf" in listed
    assert not {"ukf", "dekf", "dual_kkf", "mekf_2c"} & set(listed)


def test_an_unknown_filter_is_refused_with_those_that_there_are(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match=r"no filter 'errorekf', did you mean 'error_ekf'\?.*spi"):
        FILTERS["errorekf"]
    result = CliRunner().invoke(main, ["run", "bags/step_steer", "--vehicle", "prototype_model", "--filter", "magic"])
    assert result.exit_code == 2
    assert "there is no filter 'magic'" in result.output


@pytest.mark.usefixtures("parameters_uncompiled")
def test_an_spi_of_a_file_that_lists_no_parameters_takes_mass_friction_and_stiffness(vehicle: Vehicle) -> None:
    spi = FILTERS["spi"].make(vehicle, sensors_of(vehicle))
    assert isinstance(spi, Spi)
    assert spi.parameter_names == (
        "chassis.mass", "road.friction", "front.cornering_scale", "rear.cornering_scale",
    )  # fmt: skip
    assert spi.prior_deviation[0] == vehicle.observer.surroundings.load
    assert (spi.lower > 0).all()
    assert (spi.lower < spi.values).all()
    assert (spi.values < spi.upper).all()


def prior_of_radius_errors(name: str) -> float:
    """Standard deviation in the full car's filter of a vehicle file."""
    known = load_vehicle(vehicle_path(name))
    filter = FILTERS["full_error_ekf"].make(known, sensors_of(known))
    return float(filter.car.prior.deviation[filter.names.index("radius_error")])


@pytest.mark.parametrize("name", exam_except(["prototype_model", "prototype_real"], "prototype_real"))
def test_both_prototypes_can_be_observed_by_the_full_car(name: str) -> None:
    """In a process of its own that compiles nothing: the filter is made, and not run."""
    here = Path(__file__)
    program = f"from test_catalogue import prior_of_radius_errors as prior; print(prior({name!r}))"
    path = os.pathsep.join(str(folder) for folder in (here.parent, *here.parents[1:3]))
    made = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "VSENSE_COMPILE": "0", "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.stdout.strip() == "0.0", made.stderr


def test_a_full_car_without_linkages_is_refused(vehicle: Vehicle) -> None:
    bare = vehicle.model_copy(update={"linkage": None})
    with pytest.raises(InputError, match="made of the section linkage of the vehicle file, which is missing"):
        FILTERS["full_error_ekf"].make(bare, sensors_of(bare))


@pytest.mark.exam
def test_the_continuous_filter_put_back_does_the_same_again(vehicle: Vehicle, lane_change: Recording) -> None:
    observer = feed(Runner(vehicle, lane_change.map_origin, FILTERS["cekf"].make), messages(lane_change, until=0.3))
    f, ends = observer.filter, []
    kept = f.memory.copy()
    for _ in range(2):
        f.memory[:] = kept
        f.predict(0.004)
        f.correct("imu", np.array([0.0, 0.0, 0.1, 0.1, 0.2, 9.8]), np.full(6, 0.01))
        f.predict(0.004)
        ends.append(f.memory.copy())
    assert np.array_equal(*ends)
