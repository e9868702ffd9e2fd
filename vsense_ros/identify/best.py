"""How the handling model of Best & Bogdanski is identified: noise, priors and schedule that were found to work.

Densities say what the model lacks between two samples: the noise of the wheel speeds acts on the tyre forces through
hundreds of kilonewtons of longitudinal stiffness. Forces may err by 0.3 kN/√s, the velocities by what that does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.identify.rinsing import Identifier, Kind, Noise
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import Best4Dof

FORCES = tuple(name for name in Best4Dof.states if "force" in name)
DISTURBANCES = {
    "speed": 0.1,
    "lateral_velocity": 0.1,
    "yaw_rate": 0.01,
    "roll_rate": 0.03,
    **dict.fromkeys(FORCES, 316.0),
}
START = (0.3, 0.3, 0.05, 0.02, 0.05, *(500.0,) * 8)  # deviations of the state at the first sample
OUTPUTS = (0.1, 0.1, 0.01)  # deviations of accelerations [m/s²] and roll rate [rad/s]
# Signals are low-passed first, inputs and outputs alike. Noise of the wheel speeds acts like slip that is not there,
# which makes stiffnesses too small; the paper's 10 Hz take away too much of how wheels spin up and lock (its rear K_x
# would be 10 % too small). In everyday driving, where slip is small and slow, 25 Hz would let D C_α be 15 % too small,
# and 5 Hz leave 2 %.
CUT_OFF = 25.0  # [Hz]
EVERYDAY_CUT_OFF = 5.0  # [Hz]
EVERYDAY = 5.0  # [m/s²] that an everyday drive does not exceed, for 99 % of the time
PRIOR = 0.3  # of its value: how far a parameter may well be from where it starts
HEIGHT_PRIOR = 0.1  # [m] of a roll centre, whose height may be zero


def identifier(
    values: Mapping[str, float],
    free: Sequence[str] = tuple(best_4dof.SYMBOLS),
    *,
    model: Best4Dof | None = None,
    kind: Kind = "extended",
    noise: Noise | None = None,
    **more: Sequence[float] | Array,
) -> Identifier:
    """An identifier of the model, with values for all its parameters by name."""
    peak = best_4dof.curves(values).max(axis=1)[:, None]
    scales: Sequence[float] | Array = more.pop("scales", prior(values, free) / PRIOR)
    return Identifier(
        model or Best4Dof(), values, free, noise or Noise(OUTPUTS, START, DISTURBANCES), kind=kind,
        curves=lambda p: best_4dof.curves(p) / peak, bounds=best_4dof.BOUNDS,
        scales=scales, **more,
    )  # fmt: skip


def prior(values: Mapping[str, float], free: Sequence[str]) -> Array:
    """Standard deviations (p,) with which the free parameters are known before."""
    return np.array([HEIGHT_PRIOR if "roll_centre" in name else PRIOR * abs(values[name]) for name in free])
