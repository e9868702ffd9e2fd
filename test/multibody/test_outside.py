"""The full car with its systems solved, and its bodies' matrices computed, outside of its integrator."""

from __future__ import annotations

import numpy as np
import pytest

from marks import exam_except
from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.faults import Faults
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.multibody.outside import Outside, turned
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.observer.implicit import in_double, outside_with

pytestmark = pytest.mark.slow
VEHICLE = load_vehicle(vehicle_path("prototype_model"))
INPUTS = np.array([0.05, 0.0, 0.0, 100.0, 100.0])


def driven(outside: Outside | None, tolerance: float, steps: int = 150) -> FullCarPlant:
    """Steered while it rolls at 10 m/s."""
    plant = FullCarPlant(VEHICLE, 1e-3, tolerance=tolerance, outside=outside)
    plant.place(*rolling_straight(VEHICLE, 10.0), INPUTS)
    for _ in range(steps):
        plant.step(INPUTS)
    return plant


@pytest.fixture(scope="module")
def inside() -> FullCarPlant:
    return driven(None, 1e-9, steps=60)


@pytest.mark.parametrize("turn", exam_except([None, turned], None), ids=["systems", "systems and bodies"])
def test_one_dense_system_is_what_is_eliminated_branch_by_branch(inside: FullCarPlant, turn) -> None:
    found = driven(Outside(in_double, turn), 1e-9, steps=60)
    assert np.allclose(found.q, inside.q, atol=1e-9)
    assert np.allclose(found.u, inside.u, atol=1e-9)
    # Those inside always go three by three.
    assert found.integrator.iterations <= inside.integrator.iterations


@pytest.mark.exam
@pytest.mark.parametrize("tolerance", [1e-5, 2e-4, 1e-3])
def test_single_precision_adds_no_iteration_at_the_thesis_s_tolerances(tolerance: float) -> None:
    client = Client(Direct(Device("mock")))
    double = driven(Outside(in_double), tolerance, steps=110)
    single = driven(outside_with(client, ("solve56",)), tolerance, steps=110)
    assert client.counts["accelerated"] == client.counts["requests"] > 100
    assert single.integrator.iterations <= 1.05 * double.integrator.iterations
    assert np.abs(single.u - double.u).max() < 1e-3 * np.abs(double.u).max()


@pytest.mark.exam
def test_bodies_from_the_accelerator_are_those_of_the_model_in_single_precision(inside: FullCarPlant) -> None:
    client = Client(Direct(Device("mock")))
    found = driven(outside_with(client, ("body_mass",)), 1e-9, steps=60)
    assert client.fallbacks == 0
    assert client.counts["accelerated"] >= 28 * 60
    assert np.abs(found.u - inside.u).max() < 1e-5 * np.abs(inside.u).max()


@pytest.mark.exam
def test_an_accelerator_of_the_full_car_may_fail() -> None:
    transport = Direct(Device("mock", faults=Faults(drop=0.05, nan=0.05, silent_error=0.05), seed=4))
    client = Client(transport)
    found = driven(outside_with(client, ("solve56",), transport.at), 1e-5, steps=100)
    expected = driven(None, 1e-9, steps=100)
    assert client.fallbacks > 5
    assert np.abs(found.u - expected.u).max() < 1e-3 * np.abs(expected.u).max()


def test_a_step_that_is_given_no_solution_leaves_the_car_where_it_was() -> None:
    plant = driven(Outside(lambda matrix, right: np.full_like(right, np.nan)), 1e-9, steps=0)
    before = plant.memory()
    with pytest.raises(InputError, match="does not converge"):
        plant.step(INPUTS)
    assert np.array_equal(plant.memory(), before)


def test_a_body_turned_and_moved_is_that_of_the_textbook() -> None:
    """R J Rᵀ and m R s by hand: a quarter turn about z swaps x and y."""
    body = np.zeros((1, 19))
    body[0, :9] = [0, -1, 0, 1, 0, 0, 0, 0, 1]
    body[0, 9:] = [1, 2, 3, 0.1, 0.2, 0.3, 5, 6, 7, 10]  # xx yy zz xy xz yz, s, m
    expected = [2, -0.1, -0.3, 1, 0.2, 3, -60, 50, 70]
    assert np.allclose(turned(body)[0], expected)
