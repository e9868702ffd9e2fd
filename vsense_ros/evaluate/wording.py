"""Scores and lists of signals as text, shared by the terminal and the reports."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsense_ros.evaluate.balance import Balance
from vsense_ros.evaluate.metrics import SignalScore
from vsense_ros.evaluate.signals import SIGNALS, Signal

HEADINGS = ("RMSE", "in 2σ", "NEES", "trivial", "NRMSD\n[%]", "bias", "lag\n[ms]")  # of two lines in a terminal
LEGEND = (
    "In 2σ: share of the errors within two of the standard deviations that the filter states, 95 % if these are right. "
    "NEES: mean square of error over standard deviation, 1 if they are right. Trivial: RMSE of what costs nothing: "
    "zero, the mean of the reference, the last reading of a sensor. NRMSD: RMSE over the range of the reference "
    "(Leung 2010), where that range is more than six standard deviations of the estimate and of the noise of the "
    "reference. Bias: estimate minus reference. Lag: positive where the estimate is late; – where the signal does not "
    "determine it to 20 ms."
)


def score_cells(name: str, result: SignalScore, trivial: tuple[str, SignalScore] | None = None) -> tuple[str, ...]:
    """The cells below `HEADINGS` for a signal, as people read them; "–" where there is no value.

    The RMSE has three digits (no more than four decimals), the bias as many decimals as the RMSE. An error that was
    only scored for a part of the time, as the filter did not claim to know the signal, is followed by that share.
    """
    signal = SIGNALS[name]
    unit = ("" if signal.shown_unit.startswith("°") else " ") + signal.shown_unit
    bias = result.bias * signal.shown_per_unit
    nrmsd = "–" if result.nrmsd_percent is None or not signal.ranged else f"{result.nrmsd_percent:.2f}"
    lag = "–" if result.lag_s is None else f"{result.lag_s * 1e3:+.1f}"
    inside = "–" if result.within_2s is None else f"{100 * result.within_2s:.0f} %"
    nees = "–" if result.nees is None else f"{result.nees:.2f}" if result.nees < 100 else f"{result.nees:.0f}"
    share_of_time = "" if result.known_share > 0.995 else f" in {100 * result.known_share:.0f} %"
    costs_nothing = "–" if trivial is None else f"{_amount(signal, trivial[1].rmse)} ({trivial[0]})"
    decimals = _decimals(result.rmse * signal.shown_per_unit)
    rmse = f"{_amount(signal, result.rmse)}{share_of_time}"
    return rmse, inside, nees, costs_nothing, nrmsd, f"{bias:+.{decimals}f}{unit}", lag


def _amount(signal: Signal, rmse: float) -> str:
    """A root mean square in the unit that people read."""
    value = rmse * signal.shown_per_unit
    return f"{value:.{_decimals(value)}f}{'' if signal.shown_unit.startswith('°') else ' '}{signal.shown_unit}"


def _decimals(shown: float) -> int:
    return int(np.clip(2 - np.floor(np.log10(shown)), 0, 4)) if shown > 0.0 else 2


def balance_in_words(balance: Balance) -> str:
    """How far the tyre forces are from what the inertial sensor feels."""
    shares = ", ".join(f"{name} {share:.1f} %" for name, share in balance.percent.items())
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
