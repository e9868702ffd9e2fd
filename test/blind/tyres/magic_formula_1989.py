"""The Magic Formula as Bakker, Pacejka & Lidner (1989) gave it, combined slip by their normalized slips."""

from __future__ import annotations

import numpy as np

from blind.tyres.load import at_load

SHAPE_X, SHAPE_Y = 1.60, 1.35
CURVATURE_X, CURVATURE_Y = 0.35, -0.6


def _sine(slip, slope, peak, shape, curvature):
    b = slope / (shape * peak)
    x = b * slip
    return peak * np.sin(shape * np.arctan(x - curvature * (x - np.arctan(x))))


def forces(tyre, kappa, alpha, load, friction):
    cornering, slip_stiffness, peak_x, peak_y = at_load(tyre, np.maximum(load, 1.0), friction)
    scale_x, scale_y = peak_x / slip_stiffness, peak_y / cornering
    x, y = kappa / scale_x, np.tan(alpha) / scale_y
    slip = np.sqrt(x * x + y * y) + 1e-9
    force_x = x / slip * _sine(slip * scale_x, slip_stiffness, peak_x, SHAPE_X, CURVATURE_X)
    force_y = y / slip * _sine(slip * scale_y, cornering, peak_y, SHAPE_Y, CURVATURE_Y)
    return force_x, force_y
