"""What the filter found missing across the car, given to the tyres."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.observer.estimate import with_lateral_error

AXLES = np.array([1.2, 1.0])  # distances of the front and the rear axle from cog [m]
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
    added = with_lateral_error(before, force, steering, AXLES)[1] - before[1]
    front, rear = added[:2].sum() * np.cos(steering), added[2:].sum()
    assert front + rear == pytest.approx(lateral, abs=1e-6)
    assert AXLES[0] * front - AXLES[1] * rear == pytest.approx(yaw, abs=1e-6)


def test_the_tyres_of_an_axle_share_by_their_loads():
    force = np.zeros(14)
    force[1] = 600.0
    added = with_lateral_error(wheels_with((1000, 3000, 500, 500)), force, 0.0, AXLES)[1] - (100, 200, 300, 400)
    assert added[1] == pytest.approx(3 * added[0])
    assert added[2] == pytest.approx(added[3])


def test_nothing_but_the_lateral_forces_of_tyres_on_the_ground_is_touched():
    force = np.full(14, 100.0)
    before = wheels_with((0, 0, 800, 0))
    after = with_lateral_error(before, force, 0.1, AXLES)
    changed = np.argwhere(after != before).tolist()
    assert changed == [[1, 2]]
