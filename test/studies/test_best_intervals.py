"""How often the intervals of an identified car hold: which slips count as driven, and what is counted."""

from __future__ import annotations

import numpy as np
import pytest

from studies.best import FREE
from studies.best_intervals import Intervals, content, driven
from studies.best_twin import Twin
from vsense_ros.model.handling.best_4dof import PAPER, REACH, curve_slips


def test_slips_that_a_car_had_are_driven_and_larger_ones_are_not() -> None:
    """A car that moves sideways by 0.05 of its speed, whose wheels turn 10 % too fast."""
    states, inputs = np.zeros((200, 13)), np.zeros((200, 5))
    states[:, 0], states[:, 1] = 20.0, 1.0
    inputs[:, 1:] = 1.1 * 20.0 / PAPER["wheel_radius"]
    found = dict(zip(REACH, driven(Twin(states, inputs)), strict=True))
    for name, reached in found.items():
        largest = curve_slips(name)[reached].max()
        step = curve_slips(name)[0]
        assert largest == pytest.approx(0.05 if name.endswith("lateral") else 0.1, abs=1.01 * step)


def test_intervals_of_errors_that_are_as_large_as_stated_hold_in_nine_of_ten_twins() -> None:
    random = np.random.default_rng(0)
    errors = random.standard_normal((2000, len(FREE)))
    curves = random.standard_normal((2000, 4, 3))
    curves[:, :, 2] = np.nan
    found = content(Intervals(errors, 2 * errors, curves, np.ones_like(errors), np.zeros_like(errors)))
    assert found["all"]["parameters"] == pytest.approx(0.9, abs=0.01)
    assert found["all"]["pseudo-true parameters"] == pytest.approx(0.589, abs=0.01)  # of ±0.82 σ
    assert found["all"]["curves"] == pytest.approx(0.9, abs=0.01)
