"""Burckhardt 1993: friction over resultant slip as exponential rise and linear fall; the slip is an ellipse of both."""

from __future__ import annotations

import numpy as np

from blind.tyres.load import at_load

FALL = 0.30  # of friction per unit of normalized slip at which the rise ends


def forces(tyre, kappa, alpha, load, friction):
    cornering, slip_stiffness, limit_x, limit_y = at_load(tyre, np.maximum(load, 1.0), friction)
    x = slip_stiffness / limit_x * kappa / (1 + 0.5 * np.abs(kappa))
    y = cornering / limit_y * np.sin(alpha)
    slip = np.sqrt(x * x + y * y) + 1e-9
    # rise with unit slope at zero; the fall is small where tyres are used
    share = 1.06 * (1 - np.exp(-slip / 1.06)) - FALL * 0.02 * slip * slip / (1 + 0.3 * slip)
    return limit_x * share * x / slip, limit_y * share * y / slip
