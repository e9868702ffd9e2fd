"""Tables of suspension kinematics, and the simplified car on them, against the linkage they are made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.errors import InputError
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.car.kinematic_tables import (
    COLUMNS,
    TABLES,
    SteeringRack,
    WheelPosition,
    kinematic_tables,
    largest_errors,
    steering_rack,
)
from vsense_ros.model.car.steps import dynamics_function
from vsense_ros.model.schema.suspension_tables import SuspensionTables
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.model.vehicle import Vehicle

CAMBER, TOE = COLUMNS.index("camber"), COLUMNS.index("toe")
MIRROR = np.array([1, -1, 1, -1, 1, 1])  # x, y, camber, toe, caster, spring


@pytest.fixture(scope="module")
def tables(vehicle: Vehicle) -> SuspensionTables:
    return kinematic_tables(vehicle)


@pytest.fixture(scope="module")
def rack(vehicle: Vehicle) -> SteeringRack:
    return steering_rack(vehicle)


@pytest.fixture(scope="module")
def positions(vehicle: Vehicle) -> list[WheelPosition]:
    """Solvers of the corners fl, fr, rl, rr."""
    car = FullCar(vehicle)
    numbers = car.corner_parameters(car.parameters(vehicle))
    return [WheelPosition(car.corners[i // 2], own) for i, own in enumerate(numbers)]


def solved(position: WheelPosition, travel: float, rack: float) -> np.ndarray:
    return position.values(position.coordinates(travel, rack), rack)


def looked_up(tables: SuspensionTables, axle: str, travel: float, steering: float = 0.0) -> np.ndarray:
    return np.array([values[0] for values in tables.columns(axle, travel, steering).values()])


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.06, 0.06), st.floats(-0.33, 0.33))
def test_tables_agree_with_the_linkage_between_their_points(tables, rack, positions, travel: float, angle: float):
    place = float(rack.motion(angle)[0])
    assert_allclose(
        looked_up(tables, "front", travel, angle), solved(positions[0], travel, place), atol=TABLES.tolerance
    )
    right = MIRROR * looked_up(tables, "front", travel, -angle)
    assert_allclose(right, solved(positions[1], travel, place), atol=TABLES.tolerance)
    assert_allclose(looked_up(tables, "rear", travel), solved(positions[2], travel, 0), atol=TABLES.tolerance)
    assert_allclose(MIRROR * looked_up(tables, "rear", travel), solved(positions[3], travel, 0), atol=TABLES.tolerance)


def test_errors_that_are_reported_are_within_the_tolerance(vehicle: Vehicle, tables: SuspensionTables):
    for columns in largest_errors(vehicle, tables).values():
        assert 1e-8 < max(columns.values()) < TABLES.tolerance


def test_in_the_design_position_wheels_stand_straight(tables: SuspensionTables):
    for axle in ("front", "rear"):
        assert_allclose(looked_up(tables, axle, 0.0), 0, atol=1e-9)
        assert_allclose(tables.columns(axle, 0.0, 0.0)["spring"][1], 1, atol=5e-4)


def test_roll_centres_and_camber_are_those_that_the_vehicle_file_promises(tables: SuspensionTables, vehicle: Vehicle):
    """The contact point of a wheel that travels moves at a right angle to the line to the roll centre."""
    physics = vehicle.physics
    for name, axle, camber in (("front", physics.front, 0.5), ("rear", physics.rear, 0.6)):
        slope = {column: values[1] for column, values in tables.columns(name, 0.0, 0.0).items()}
        sideways = slope["y"] - axle.unloaded_radius * slope["camber"]
        assert_allclose(axle.track / 2 * sideways, axle.roll_centre_height, atol=0.01)
        assert_allclose(np.degrees(slope["camber"]) * 0.02, -camber, atol=0.05)


@pytest.mark.exam
def test_wheels_of_the_simplified_car_slip_lean_and_press_as_those_of_the_full_car(vehicle: Vehicle, tables, rack):
    """At the same coordinates and velocities, whatever the forces inside."""
    tabled = vehicle.model_copy(update={"suspension": tables})
    dynamics = dynamics_function(car_of(tabled))
    plant = FullCarPlant(vehicle, 0.004, rack=rack)
    random = np.random.default_rng(4)
    for _ in range(8):
        q, u = rolling_straight(vehicle, random.uniform(3, 30))
        bounce = random.uniform(-0.04, 0.05)
        q[:6] += random.uniform(-1, 1, 6) * [5, 5, 0.002, 0.003, 0.002, 3] - [0, 0, bounce, 0, 0, 0]
        q[6:10] = bounce + random.uniform(-0.002, 0.002, 4)
        u += random.uniform(-1, 1, 14) * ([0.5] * 3 + [0.4] * 3 + [0.4] * 4 + [2.0] * 4)
        inputs = np.array([random.uniform(-0.3, 0.3), 0, 0, 0, 0, 0])
        plant.place(q, u, inputs)
        found = np.asarray(dynamics(q, u, np.zeros(14), np.zeros(7), inputs, vehicle.parameter_vector(), [])[1])
        expected = plant.wheels
        assert expected[2].min() > 100
        assert_allclose(found[2], expected[2], atol=3.0)  # N: a tyre of 160 N/mm within 10 µm, its damper
        assert_allclose(found[4], expected[4], atol=1e-4)
        assert_allclose(found[5], expected[5], atol=1e-4)
        assert_allclose(found[6], expected[6], atol=2 * TABLES.tolerance)


def test_the_rack_is_put_where_the_wheels_take_the_angle(rack: SteeringRack, positions: list[WheelPosition]):
    for angle in (-0.25, -0.03, 0.0, 0.1, 0.3):
        place = float(rack.motion(angle)[0])
        toes = [solved(position, 0.0, place)[TOE] for position in positions[:2]]
        assert_allclose(np.mean(toes), angle, atol=1e-9)


def test_the_motion_of_the_rack_is_consistent(rack: SteeringRack):
    def place(t: float) -> float:
        return float(rack.motion(0.1 + 0.2 * t + 0.15 * t**2)[0])

    h = 1e-3
    _, speed, acceleration = rack.motion(0.1, 0.2, 0.3)
    assert_allclose(speed, (place(h) - place(-h)) / (2 * h), rtol=1e-5)
    assert_allclose(acceleration, (place(h) - 2 * place(0) + place(-h)) / h**2, rtol=1e-3)


def test_an_angle_that_the_rack_cannot_give_is_refused(rack: SteeringRack):
    with pytest.raises(InputError, match=r"a mean steering angle of 57\.3° is more than the rack's"):
        rack.motion(1.0)


def test_travel_that_the_linkage_cannot_reach_is_refused(vehicle: Vehicle):
    with pytest.raises(InputError, match=r"linkage of the front axle does not reach travel .* mm"):
        kinematic_tables(vehicle, bump=0.6)
    with pytest.raises(InputError, match="bump must be a length between 0 and 1 m, found -1"):
        kinematic_tables(vehicle, bump=-1)


def test_kinematics_too_wild_for_the_tolerance_are_refused(vehicle: Vehicle):
    with pytest.raises(InputError, match=r"x of the front suspension cannot be put into a polynomial of degree 8"):
        kinematic_tables(vehicle, tolerance=1e-14)


def test_an_axle_that_cannot_be_steered_is_refused(vehicle: Vehicle):
    assert vehicle.linkage is not None
    front = vehicle.linkage.front.model_copy(update={"steered": False})
    fixed = vehicle.model_copy(update={"linkage": vehicle.linkage.model_copy(update={"front": front})})
    with pytest.raises(InputError, match="cannot be steered: set `steered: true`"):
        kinematic_tables(fixed)
