"""What the filter found missing across the car, given to the tyres."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.model.vehicle import Chassis
from vsense_ros.observer.estimate import with_lateral_error

CHASSIS = Chassis(
    mass=700, roll_inertia=150, pitch_inertia=480, yaw_inertia=560, cog_height=0.42, cog_to_front_axle=1.2,
    cog_to_rear_axle=1.0,
)  # fmt: skip
LOAD = st.floats(50, 5000)
FORCE = st.floats(-5000, 5000)


def wheels_with(loads) -> np.ndarray:
    wheels = np.zeros((7, 4))
    wheels[1] = (100, 200, 300, 400)
    wheels[2] = loads
    return wheels


@given(st.tuples(LOAD, LOAD, LOAD, LOAD), FORCE, FORCE, st.floats(-0.5, 0.5))
def test_the_tyres_together_make_up_for_the_missing_force_and_moment(loads, lateral, yaw, steering):
    before = wheels_with(loads)
    force = np.zeros(14)
    force[[1, 5]] = lateral, yaw
    added = with_lateral_error(before, force, steering, CHASSIS)[1] - before[1]
    front, rear = added[:2].sum() * np.cos(steering), added[2:].sum()
    assert front + rear == pytest.approx(lateral, abs=1e-6)
    assert 1.2 * front - 1.0 * rear == pytest.approx(yaw, abs=1e-6)


def test_the_tyres_of_an_axle_share_by_their_loads():
    force = np.zeros(14)
    force[1] = 600.0
    added = with_lateral_error(wheels_with((1000, 3000, 500, 500)), force, 0.0, CHASSIS)[1] - (100, 200, 300, 400)
    assert added[1] == pytest.approx(3 * added[0])
    assert added[2] == pytest.approx(added[3])


def test_nothing_but_the_lateral_forces_of_tyres_on_the_ground_is_touched():
    force = np.full(14, 100.0)
    before = wheels_with((0, 0, 800, 0))
    after = with_lateral_error(before, force, 0.1, CHASSIS)
    changed = np.argwhere(after != before).tolist()
    assert changed == [[1, 2]]
