"""How stiffness and friction of a tyre depend on its load: shared by all formulas, because each needs some."""

from __future__ import annotations

import numpy as np


def at_load(tyre, load, friction):
    """Cornering stiffness [N/rad], slip stiffness [N], largest longitudinal and lateral force [N] at a load."""
    ratio = np.clip(load / tyre.nominal_load, 0.0, 3.0)
    stiffer = ratio * (1 + tyre.stiffness_fall) / (1 + tyre.stiffness_fall * ratio)
    grip = friction * (1 - tyre.friction_fall * (ratio - 1)) * load
    return tyre.cornering * stiffer, tyre.slip_stiffness * stiffer, tyre.friction_x * grip, tyre.friction_y * grip
