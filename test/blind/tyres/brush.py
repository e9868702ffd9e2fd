"""Brush with parabolic pressure and combined slip; friction falls with the sliding share (Pacejka 2012, ch. 3)."""

from __future__ import annotations

import numpy as np

from blind.tyres.load import at_load

SLIDING = 0.90  # friction of full sliding over friction of adhesion


def forces(tyre, kappa, alpha, load, friction):
    cornering, slip_stiffness, limit_x, limit_y = at_load(tyre, np.maximum(load, 1.0), friction)
    # Slips of tread elements, each in units of what makes the whole patch slide.
    x = slip_stiffness * kappa / (1 + np.abs(kappa)) / (3 * limit_x)
    y = cornering * np.tan(alpha) / (3 * limit_y)
    slip = np.sqrt(x * x + y * y) + 1e-9
    adhering = np.maximum(1 - slip, 0.0)
    share = (1 - adhering**3) * (1 - (1 - SLIDING) * np.minimum(slip, 2.0) / 2)
    return limit_x * share * x / slip, limit_y * share * y / slip
