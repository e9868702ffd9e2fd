"""What a free parameter changes, and the numbers of a vehicle file by name."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.free_parameter import FreeParameter, added, multiplied, scaled, with_offsets
from vsense_ros.identification.parameter_set import of_vehicle, with_values
from vsense_ros.mismatch.candidates import BASE
from vsense_ros.model.vehicle import Vehicle


@pytest.fixture(scope="module", params=["prototype_real", "genesis_start"])
def car(request: pytest.FixtureRequest) -> Vehicle:
    return load_vehicle(vehicle_path(request.param))


def free(change) -> FreeParameter:
    return FreeParameter("unknown", "-", 1.0, -np.inf, np.inf, change)


def test_a_vehicle_is_all_its_numbers_and_the_other_way_round(car: Vehicle):
    numbers = of_vehicle(car)
    assert with_values(car, numbers) == car
    assert car.values().items() <= numbers.values.items()
    moved = with_values(car, numbers.changed({"reference.position.1": 0.25, "chassis.mass": 1800.0}))
    assert moved.reference.position == (car.reference.position[0], 0.25, car.reference.position[2])
    assert moved.physics.chassis.mass == 1800.0


def test_numbers_that_change_have_the_digits_that_are_asked_for_and_others_stay(car: Vehicle):
    numbers = of_vehicle(car)
    changes = {"chassis.mass": 1234.5678, "chassis.cog_height": numbers.values["chassis.cog_height"]}
    found = with_values(car, numbers.changed(changes), digits=3).values()
    assert found == car.values() | {"chassis.mass": 1230.0}


def test_a_name_that_the_vehicle_file_does_not_have_is_refused_by_name(car: Vehicle):
    with pytest.raises(KeyError, match=r"chassis\.weight"):
        with_values(car, of_vehicle(car).changed({"chassis.weight": 1.0}))
    with pytest.raises(KeyError, match=r"chassis\.weight"):
        free(multiplied({"chassis.weight": 1.0})).apply(of_vehicle(car).values, 0.1)


def test_a_car_that_cannot_be_is_refused(car: Vehicle):
    with pytest.raises(ValueError, match="mass"):
        with_values(car, of_vehicle(car).changed({"chassis.mass": -1.0}))


def test_numbers_are_multiplied_together_and_back(car: Vehicle):
    both = free(multiplied({"sensors.imu.force_noise": 1.0, "chassis.mass": -1.0}))
    there = with_offsets(of_vehicle(car), [both], [0.5])
    assert there.values["chassis.mass"] == pytest.approx(car.physics.chassis.mass * np.exp(-0.5))
    noise = [np.array(v.sensors["imu"].force_noise) for v in (with_values(car, there), car)]
    assert noise[0] == pytest.approx(np.exp(0.5) * noise[1])
    assert with_offsets(there, [both], [-0.5]).values == pytest.approx(of_vehicle(car).values)


def test_adding_moves_a_number_that_is_zero_and_scaling_one_that_is_not(car: Vehicle):
    nominal = of_vehicle(car)
    place, mass = free(added("reference.position.0")), free(scaled("chassis.mass"))
    moved = with_offsets(nominal, [place, mass], [0.6, 0.1])
    assert moved.values["reference.position.0"] == nominal.values["reference.position.0"] + 0.6
    assert moved.values["chassis.mass"] == pytest.approx(1.1 * nominal.values["chassis.mass"])


def test_what_is_not_there_yet_is_added_to_nothing():
    assert added("bank at 100 m")({}, 0.02) == {"bank at 100 m": 0.02}


def test_a_free_parameter_tells_which_numbers_it_changes_and_what_the_first_of_them_is():
    values = {"mass": 1500.0, "inertia.0": 2.0, "inertia.1": 3.0}
    parameter = free(multiplied({"inertia": 1.0, "mass": -1.0}))
    assert parameter.names(values) == ("inertia.0", "inertia.1", "mass")
    assert parameter.value(values) == 2.0


def test_free_parameters_of_the_mismatch_search_change_a_vehicle_file_as_well(car: Vehicle):
    """There is one way of saying what a free parameter changes."""
    nominal = of_vehicle(car)
    for parameter in BASE:
        changed = with_values(car, with_offsets(nominal, [parameter], [0.01])).values()
        differing = {name for name, value in car.values().items() if changed[name] != value}
        assert differing == {name for name in parameter.names(nominal.values) if nominal.values[name] != 0.0}
