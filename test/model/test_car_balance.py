"""The balance of forces and moments, against a rigid body moved by four forces."""

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.balance import SHARES, CarBalance
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY

PHYSICS = load_vehicle(Path(__file__).parents[2] / "config/vehicles/genesis.yaml").physics
CAR = CarBalance(PHYSICS)
CHASSIS = PHYSICS.chassis
forces = st.lists(st.floats(-5e3, 5e3), min_size=12, max_size=12).map(lambda values: np.reshape(values, (3, 4)))


def places():
    """Positions of the contacts about cog, (4, 3) [m]."""
    front, rear = PHYSICS.front.track / 2, PHYSICS.rear.track / 2
    ahead = [CHASSIS.cog_to_front_axle] * 2 + [-CHASSIS.cog_to_rear_axle] * 2
    return np.column_stack([ahead, [front, -front, rear, -rear], [-CHASSIS.cog_height] * 4])


@given(forces, st.lists(st.floats(-500, 500), min_size=4, max_size=4), st.floats(-0.5, 0.5), st.floats(-60, 60))
def test_what_four_tyres_and_the_air_do_to_a_rigid_body_is_balanced(force, aligning, steering, speed):
    """Newton and Euler about cog, one wheel after the other."""
    total, moment = np.zeros(3), np.array([0.0, 0.0, sum(aligning)])
    for i, place in enumerate(places()):
        turned = Rotation.from_euler("z", steering if i < 2 else 0.0).apply(force[:, i])
        total += turned
        moment += np.cross(place, turned)
    total[0] -= 0.5 * AIR_DENSITY * PHYSICS.aerodynamics.drag_area * speed * abs(speed)
    inertia = [CHASSIS.roll_inertia, CHASSIS.pitch_inertia, CHASSIS.yaw_inertia]
    wheels = np.vstack([force, aligning, np.zeros((3, 4))])
    asked = CAR.of_motion(total / CHASSIS.mass, moment / inertia, 0.0, 0.0, np.array(speed))
    assert_allclose(CAR.of_tyres(wheels, steering), asked, atol=1e-6)


def test_a_car_at_rest_carries_its_weight_by_the_levers_of_its_axles():
    felt = CAR.of_motion(np.array([0.0, 0.0, GRAVITY]), np.zeros(3), 0.0, 0.0, np.array(0.0))
    front, rear = CAR.axle_loads(felt)
    assert_allclose(front * CHASSIS.cog_to_front_axle, rear * CHASSIS.cog_to_rear_axle)
    assert_allclose(front + rear, CHASSIS.mass * GRAVITY)
    assert_allclose(CAR.shares(felt), [0, 0, 1, 1, 1, 0], atol=1e-12)
    assert len(SHARES) == 6


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_body_that_leans_on_its_springs_feels_the_same_along_the_road(roll, pitch):
    along_road = np.array([1.0, -3.0, 9.5])
    in_body = Rotation.from_euler("ZYX", [0.0, pitch, roll]).inv().apply(along_road)
    found = CAR.of_motion(in_body, np.zeros(3), roll, pitch, np.array(0.0))
    assert_allclose(found[:3], CHASSIS.mass * along_road)


def test_many_instants_at_once_are_each_by_itself():
    random = np.random.default_rng(1)
    wheels, steering, force = random.normal(size=(5, 7, 4)), random.normal(size=5), random.normal(size=(5, 3))
    turning, roll, speed = random.normal(size=(5, 3)), 0.1 * random.normal(size=5), random.normal(size=5)
    together = CAR.shares(CAR.of_tyres(wheels, steering) - CAR.of_motion(force, turning, roll, roll, speed))
    for i in range(5):
        alone = CAR.of_tyres(wheels[i], steering[i])
        alone = alone - CAR.of_motion(force[i], turning[i], roll[i], roll[i], speed[i])
        assert_allclose(together[i], CAR.shares(alone))
