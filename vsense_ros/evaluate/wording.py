"""Scores and lists of signals as text, shared by the terminal and the reports."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsense_ros.evaluate.balance import Balance
from vsense_ros.evaluate.metrics import SignalScore
from vsense_ros.evaluate.signals import SIGNALS


def score_cells(name: str, found: SignalScore) -> tuple[str, str, str, str]:
    """RMSE, NRMSD, bias and lag of a signal as people read them; "–" where there is no value.

    The RMSE has three digits (no more than four decimals), the bias as many decimals as the RMSE.
    """
    signal = SIGNALS[name]
    unit = ("" if signal.shown_unit.startswith("°") else " ") + signal.shown_unit
    rmse, bias = found.rmse * signal.shown_per_unit, found.bias * signal.shown_per_unit
    decimals = int(np.clip(2 - np.floor(np.log10(rmse)), 0, 4)) if rmse > 0.0 else 2
    nrmsd = "–" if found.nrmsd_percent is None else f"{found.nrmsd_percent:.2f} %"
    lag = "–" if found.lag_s is None else f"{found.lag_s * 1e3:+.1f} ms"
    return f"{rmse:.{decimals}f}{unit}", nrmsd, f"{bias:+.{decimals}f}{unit}", lag


def balance_in_words(found: Balance) -> str:
    """How far the tyre forces are from what the inertial sensor feels."""
    shares = ", ".join(f"{name} {share:.1f} %" for name, share in found.percent.items())
    return (
        f"Tyre forces less what the inertial sensor feels, RMS below 2 Hz, of the weight or the load at rest: {shares}"
    )


def named(signals: Sequence[str]) -> str:
    """A list of signals in words, with the twelve tyre forces in one."""
    forces = [name for name in signals if name.startswith("wheel_force_")]
    slips = [name for name in signals if name.startswith("wheel_slip_")]
    words = [
        SIGNALS[name].label if name in SIGNALS else name.replace("_", " ")
        for name in signals
        if name not in forces and name not in slips
    ]
    if forces:
        words.append(f"tyre forces ({len(forces)} components)")
    if slips:
        words.append(f"slips of {len(slips)} tyres")
    return ", ".join(words)
