"""Tables of suspension kinematics against the linkage they are made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.errors import InputError
from vsense_ros.model.full_car import FullCar
from vsense_ros.model.kinematic_tables import COLUMNS, Tables, WheelPosition, kinematic_tables
from vsense_ros.model.vehicle import Vehicle

CAMBER, TOE = COLUMNS.index("camber"), COLUMNS.index("toe")


@pytest.fixture(scope="module")
def tables(vehicle: Vehicle) -> Tables:
    return kinematic_tables(vehicle)


@pytest.fixture(scope="module")
def positions(vehicle: Vehicle) -> list[WheelPosition]:
    """Solvers of the corners fl, fr, rl, rr."""
    car = FullCar(vehicle)
    numbers = car.corner_parameters(car.parameters(vehicle))
    return [WheelPosition(car.corners[i // 2], own) for i, own in enumerate(numbers)]


def solved(position: WheelPosition, travel: float, rack: float) -> np.ndarray:
    return position.values(position.coordinates(travel, rack), rack)


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.06, 0.06), st.floats(-0.04, 0.04))
def test_tables_agree_with_the_linkage_between_their_points(
    tables: Tables, positions: list[WheelPosition], travel: float, rack: float
):
    assert_allclose(tables.front.left(travel, rack), solved(positions[0], travel, rack), atol=2e-6)
    assert_allclose(tables.front.right(travel, rack), solved(positions[1], travel, rack), atol=2e-6)
    assert_allclose(tables.rear.left(travel), solved(positions[2], travel, 0), atol=2e-6)
    assert_allclose(tables.rear.right(travel), solved(positions[3], travel, 0), atol=2e-6)


def test_in_the_design_position_wheels_stand_straight(tables: Tables):
    for table in (tables.front, tables.rear):
        assert_allclose(table.left(0.0), 0, atol=1e-9)


def test_roll_centres_and_camber_are_those_that_the_vehicle_file_promises(tables: Tables, vehicle: Vehicle):
    """The contact point of a wheel that travels moves at a right angle to the line to the roll centre."""
    physics = vehicle.physics
    for table, axle, camber in ((tables.front, physics.front, 0.5), (tables.rear, physics.rear, 0.6)):
        slope = (table.left(0.005) - table.left(-0.005)) / 0.01
        sideways = slope[1] - axle.unloaded_radius * slope[CAMBER]
        assert_allclose(axle.track / 2 * sideways, axle.roll_centre_height, atol=0.01)
        assert_allclose(np.degrees(slope[CAMBER]) * 0.02, -camber, atol=0.05)


def test_the_rack_is_put_where_the_wheels_take_the_angle(tables: Tables):
    for angle in (-0.25, -0.03, 0.0, 0.1, 0.3):
        rack = tables.rack_motion(angle)[0]
        assert_allclose(tables.mean_angle(rack), angle, atol=1e-9)


def test_the_motion_of_the_rack_is_consistent(tables: Tables):
    def rack(t: float) -> float:
        return float(tables.rack_motion(0.1 + 0.2 * t + 0.15 * t**2)[0])

    h = 1e-3
    _, speed, acceleration = tables.rack_motion(0.1, 0.2, 0.3)
    assert_allclose(speed, (rack(h) - rack(-h)) / (2 * h), rtol=1e-5)
    assert_allclose(acceleration, (rack(h) - 2 * rack(0) + rack(-h)) / h**2, rtol=1e-3)


def test_a_place_beyond_the_stops_is_refused(tables: Tables):
    with pytest.raises(InputError, match=r"travel 61 mm is outside the table of the front axle, .* -60 to 60 mm"):
        tables.front.left(0.061)
    with pytest.raises(InputError, match="rack -41 mm is outside the table of the front axle"):
        tables.front.left(0.0, -0.041)
    with pytest.raises(InputError, match="travel nan mm is outside"):
        tables.rear.left(float("nan"))


def test_an_angle_that_the_rack_cannot_give_is_refused(tables: Tables):
    with pytest.raises(InputError, match=r"a mean steering angle of 57\.3° is more than the rack's"):
        tables.rack_motion(1.0)


def test_travel_that_the_linkage_cannot_reach_is_refused(vehicle: Vehicle):
    with pytest.raises(InputError, match=r"linkage of the front axle does not reach travel .* mm"):
        kinematic_tables(vehicle, bump=0.6, grid=(9, 3))
    with pytest.raises(InputError, match="bump must be a length between 0 and 1 m, found -1"):
        kinematic_tables(vehicle, bump=-1)
