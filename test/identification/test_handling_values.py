"""Parameters of handling models in a vehicle file, and identified ones back into it."""

from __future__ import annotations

import pytest

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.handling_values import changes, of_vehicle
from vsense_ros.model.tyres.similarity import Similarity
from vsense_ros.model.vehicle import Vehicle


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(vehicle_path("jaguar_saloon"))


def test_a_car_whose_parameters_are_put_back_has_the_same_parameters(car: Vehicle) -> None:
    before = of_vehicle(car)
    after = of_vehicle(changes(car, before, before))
    assert {name: after[name] for name in before} == pytest.approx(before, rel=1e-6)


def test_the_observer_gets_relaxation_length_and_delay_of_the_steering_together(car: Vehicle) -> None:
    """A model explains late forces by either: a file with one of them alone would be of another car."""
    found = of_vehicle(car) | {"relaxation_length": 0.9, "steering_delay": -0.02, "steering_gain": 1.02}
    changed = changes(car, found, {"front_stiffness", "rear_stiffness", "steering_gain", "steering_delay"})
    for axle in (changed.physics.front, changed.physics.rear):
        assert isinstance(axle.tyre, Similarity)
        assert (axle.tyre.relaxation_length, axle.tyre.relaxation_time) == (0.9, 0.0)
    for name, sensor in car.sensors.items():
        if sensor.kind == "steering":
            assert changed.sensors[name].latency == pytest.approx(sensor.latency - 0.02)
            assert changed.sensors[name].gain == pytest.approx(1.02 * sensor.gain)
    assert of_vehicle(changed)["relaxation_length"] == pytest.approx(0.9)


def test_tyres_of_a_model_with_a_constant_time_keep_it(car: Vehicle) -> None:
    found = {name: value for name, value in of_vehicle(car).items() if name != "relaxation_length"} | {"lag": 0.04}
    tyre = changes(car, found, {"front_stiffness"}).physics.front.tyre
    assert isinstance(tyre, Similarity)
    assert (tyre.relaxation_time, tyre.relaxation_length) == (0.04, 0.0)
