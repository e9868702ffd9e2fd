"""TMeasy's aligning moment, camber slip and lag by the formulas of its paper."""

from __future__ import annotations

import numpy as np
import pytest

from bench import TYRES, at_slip, forces, relaxation_lengths
from vsense_ros.model.parameter import with_values

TYRE = TYRES["tmeasy"]


def trail(load: float, slip: float) -> float:
    _, y, moment, *_ = at_slip(with_values(TYRE, {"camber_slip": 0.0}), load, 0.0, slip)
    return -moment / y * np.hypot(20, TYRE.standstill_speed) / 20


def test_the_trail_falls_to_zero_overshoots_and_ends():
    none, end = TYRE.slip_of_no_trail, TYRE.slip_of_no_trail * TYRE.end_of_trail
    assert trail(4000.0, 1e-4) == pytest.approx(TYRE.pneumatic_trail, rel=1e-3)
    assert trail(4000.0, none) == pytest.approx(0, abs=1e-12)
    assert trail(4000.0, (none + end) / 2) < -1e-4
    assert trail(4000.0, end) == pytest.approx(0, abs=1e-12)
    assert trail(4000.0, 1.5 * end) == 0
    # Halfway, from the paper's polynomial with w = s_0 / s_E.
    w = 1 / TYRE.end_of_trail
    half = (1 - w) * 0.5 + w * (1 - 2 * 0.25)
    assert trail(4000.0, none / 2) == pytest.approx(half * TYRE.pneumatic_trail, rel=1e-9)


@pytest.mark.parametrize("place", [1.0, "end"])
def test_the_trail_has_no_kink_where_its_pieces_meet(place):
    slip = TYRE.slip_of_no_trail * (TYRE.end_of_trail if place == "end" else place)
    h = 1e-6
    before, here, after = (trail(4000.0, slip + d) for d in (-h, 0.0, h))
    assert (after - here) / h == pytest.approx((here - before) / h, abs=1e-4)


def test_the_trail_grows_with_the_contact_patch():
    assert trail(8000.0, 1e-3) / trail(2000.0, 1e-3) == pytest.approx(2, rel=1e-3)


def test_inclination_acts_as_lateral_slip_without_a_trail():
    lean = 0.05
    _, y, moment, *_ = at_slip(TYRE, 4000.0, 0.0, 0.0, camber=lean)
    rolling = 20.0 / np.hypot(20.0, TYRE.standstill_speed)
    equivalent = at_slip(TYRE, 4000.0, 0.0, -TYRE.camber_slip * np.sin(lean) * rolling**2)
    assert y == pytest.approx(equivalent[1], rel=1e-9)
    assert moment == 0
    assert forces(TYRE, 4000.0, -20.0, 0.0, -20.0, camber=lean)[1] == pytest.approx(y)


def test_a_sliding_tyre_lags_less():
    lengths = [relaxation_lengths(TYRE, 4000.0, 20.0, 20.0 * slip, 20.0)[1] for slip in (1e-4, 0.1, 0.3, 1.0)]
    assert np.all(np.diff(lengths) < 0)
    assert lengths[0] == pytest.approx(46000 / 1e5, rel=1e-2)
