"""How the handling model of Best & Bogdanski is identified: noise, priors and schedule that were found to work.

Densities say what the model lacks between two samples: the noise of the wheel speeds acts on the tyre forces through
hundreds of kilonewtons of longitudinal stiffness. Forces may err by 0.3 kN/√s, the velocities by what that does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.identification.rinsing import Identifier, Kind, Noise
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


@dataclass(frozen=True)
class BestSettings:
    """Settings of the identification of the model of Best & Bogdanski 2016: decisions of this project, but for
    units."""

    # standard deviations of the state at the first sample, in the order of its states
    start_deviations: tuple[float, ...] = (0.3, 0.3, 0.05, 0.02, 0.05, *(500.0,) * 8)
    # standard deviations of accelerations [m/s²] and roll rate [rad/s]
    output_deviations: tuple[float, float, float] = (0.1, 0.1, 0.01)
    # Signals are low-passed first, inputs and outputs alike. Noise of the wheel speeds acts like slip that is
    # not there, which makes stiffnesses too small; the paper's 10 Hz take away too much of how wheels spin up
    # and lock (its rear K_x would be 10 % too small). In everyday driving, where slip is small and slow, 25 Hz
    # would let D C_α be 15 % too small, and 5 Hz leave 2 %. [Hz]
    cut_off: float = 25.0
    everyday_cut_off: float = 5.0  # [Hz]
    everyday_acceleration: float = 5.0  # [m/s²] that an everyday drive does not exceed, for 99 % of the time
    # [-] share of their values by which K_x and C_α are wrong however long a drive is: slip that is not there, and what
    # the filter takes away of the slip that is. Measured on 34 twins, none of those that the study tries intervals on.
    stiffnesses: tuple[str, ...] = (
        "front_longitudinal_ratio", "rear_longitudinal_ratio", "front_stiffness", "rear_stiffness",
    )  # fmt: skip
    stiffness_form: float = 0.012
    prior_share: float = 0.3  # [-] standard deviation of a parameter around its start, as a share of its value
    prior_height: float = 0.1  # [m] standard deviation of the height of a roll centre, which may be zero


SETTINGS = BestSettings()


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
    scales: Sequence[float] | Array = more.pop("scales", prior(values, free) / SETTINGS.prior_share)
    return Identifier(
        model or Best4Dof(), values, free,
        noise or Noise(SETTINGS.output_deviations, SETTINGS.start_deviations, DISTURBANCES), kind=kind,
        curves=lambda p: best_4dof.curves(p) / peak, bounds=best_4dof.BOUNDS,
        scales=scales, form=dict.fromkeys(SETTINGS.stiffnesses, SETTINGS.stiffness_form), **more,
    )  # fmt: skip


def prior(values: Mapping[str, float], free: Sequence[str]) -> Array:
    """Standard deviations (p,) with which the free parameters are known before."""
    return np.array(
        [SETTINGS.prior_height if "roll_centre" in name else SETTINGS.prior_share * abs(values[name]) for name in free]
    )
