"""How accelerations are compared with those that a motion makes expect."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from vsense_ros.checks.relations import _force_errors, key

STEP = 0.05  # [s]


def test_of_a_car_that_hardly_gains_speed_the_lateral_acceleration_alone_says_how_late_it_is() -> None:
    """Along the car a body that rocks on its springs measures ten times what the wheels make expect, and earlier."""
    random, n, late = np.random.default_rng(3), 4000, 8
    along, across = (gaussian_filter1d(random.standard_normal(n), 10) for _ in range(2))
    along, across = 0.01 * along / along.std(), 3.0 * across / across.std()
    measured = np.array([np.roll(10 * along, -20), np.roll(across, late)])
    errors = _force_errors(measured, np.array([along, across]), False, None, STEP)
    assert min(errors, key=errors.__getitem__) == key(np.eye(3))
    assert errors[key(np.eye(3))] < 0.1 * np.std(across)
