"""Dugoff, Fancher & Segel 1969, friction falling with the speed of sliding over the speed of rolling."""

from __future__ import annotations

import numpy as np

from blind.tyres.load import at_load

FALL = 0.25  # of friction, per unit of resultant slip


def forces(tyre, kappa, alpha, load, friction):
    cornering, slip_stiffness, limit_x, limit_y = at_load(tyre, np.maximum(load, 1.0), friction)
    slip = kappa / (1 + np.abs(kappa))  # over the larger of both speeds, as the model wants it
    rolling = 1 - np.abs(slip)
    lateral = np.tan(alpha) * rolling
    x, y = slip_stiffness * slip / rolling, cornering * lateral / rolling
    fall = 1 - FALL * np.minimum(np.sqrt(slip**2 + lateral**2), 1.0)
    demand = np.sqrt((x / limit_x) ** 2 + (y / limit_y) ** 2) + 1e-9
    saturation = fall / (2 * demand)
    share = np.where(saturation < 1, saturation * (2 - saturation), 1.0)
    return x * share, y * share
