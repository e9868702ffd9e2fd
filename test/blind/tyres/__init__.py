"""Tyre formulas of the plants, one file each.

`FORMULAS[name](tyre, kappa, alpha, load, friction)` → longitudinal and lateral force [N].

kappa: longitudinal slip [-], positive driving; alpha: slip angle [rad], positive where the force is positive (to the
left); load [N]; friction: grip relative to the dry road [-]. `tyre` has `cornering` [N/rad] and `slip_stiffness` [N] at
`nominal_load` [N], `friction_x`, `friction_y` there, and by what share stiffness and friction fall per nominal load
(`stiffness_fall`, `friction_fall`). All arrays of the same shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from blind.tyres import brush, burckhardt, dugoff, magic_formula_1989

FORMULAS = {
    "magic_formula_1989": magic_formula_1989.forces,
    "brush": brush.forces,
    "dugoff": dugoff.forces,
    "burckhardt": burckhardt.forces,
}
_PARAMETERS = (
    "nominal_load", "cornering", "slip_stiffness", "friction_x", "friction_y", "stiffness_fall", "friction_fall",
)  # fmt: skip


def mixed(names: Sequence[str]):
    """One function for lanes with different formulas: `names` has one for each lane, equal ones in a row."""
    spans, start = [], 0
    for i in range(1, len(names) + 1):
        if i == len(names) or names[i] != names[start]:
            spans.append((FORMULAS[names[start]], slice(start, i)))
            start = i
    if len(spans) == 1:
        return spans[0][0]

    def forces(tyre, kappa, alpha, load, friction):
        force_x, force_y = np.empty_like(kappa), np.empty_like(kappa)
        friction = np.broadcast_to(friction, kappa.shape)
        for formula, span in spans:
            part = SimpleNamespace(**{name: getattr(tyre, name)[:, span] for name in _PARAMETERS})
            force_x[:, span], force_y[:, span] = formula(
                part, kappa[:, span], alpha[:, span], load[:, span], friction[:, span]
            )
        return force_x, force_y

    return forces
