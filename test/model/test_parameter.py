"""Parameters as numbers, as a vector and as symbols."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.effects import Effects
from vsense_ros.model.parameter import numbers, symbols, vector
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.tyres import MODELS, TMeasy
from vsense_ros.model.vehicle import Physics


@pytest.fixture(scope="module")
def physics() -> Physics:
    found = load_vehicle(vehicle_path("genesis")).physics
    return found.model_copy(update={"effects": Effects(tyre_heating={}, road_grade={})})


def test_symbols_have_the_type_of_the_model_down_to_its_last_part(physics):
    _, symbolic = symbols(physics)
    assert isinstance(symbolic, Physics)
    assert isinstance(symbolic.front, Axle)
    assert isinstance(symbolic.front.tyre, TMeasy)
    assert [type(effect) for effect in symbolic.effects.present()] == [type(e) for e in physics.effects.present()]


def test_each_symbol_stands_where_the_vector_has_its_number(physics):
    p, symbolic = symbols(physics)
    names = [name for name, _ in numbers(physics)]
    assert p.numel() == len(names) == len(vector(physics))
    for name, element in zip(names, ca.vertsplit(p), strict=True):
        found = symbolic
        for part in name.split("."):
            found = getattr(found, part)
        assert ca.is_equal(found, element), name


def test_what_is_no_number_stays(physics):
    _, symbolic = symbols(physics)
    assert symbolic.front.tyre.model == "tmeasy"
    assert symbolic.effects.road_bank is None


@pytest.mark.parametrize("load", [500.0, 4000.0])
def test_a_method_on_symbols_is_the_expression_of_what_it_gives_for_numbers(physics, load):
    p, symbolic = symbols(physics)
    tyre = physics.front.tyre
    results = ca.vertcat(symbolic.front.tyre.cornering_stiffness_at(load), symbolic.front.tyre.steepest_slope(load))
    found = np.asarray(ca.Function("found", [p], [results])(vector(physics)))[:, 0]
    assert found == pytest.approx([float(tyre.cornering_stiffness_at(load)), float(tyre.steepest_slope(load))])


def test_tyres_are_found_by_the_one_value_of_their_key():
    assert {"fiala", "linear", "magic_formula", "similarity", "tmeasy"} <= set(MODELS)
    assert all(tyre.model_fields["model"].annotation.__args__ == (key,) for key, tyre in MODELS.items())
