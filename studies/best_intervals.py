"""How often the 90 % intervals of an identified car hold on twins that are driven to their limits, and why not always.

An interval can miss for two reasons: noise, and what an estimate is wrong by without any noise: low-passed signals,
steps of 10 ms and inputs that are held between them. The same drive without noise has the second alone. So each twin is
identified twice, and its intervals are tried against both: against the true car, and against the parameters that the
identification finds without noise, the pseudo-true ones of White (1982).

Shape C and curvature E make up one curve and are hardly separable. What a drive determines is the force at the slips
that it had: the intervals of the curves are tried there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import binomtest

from studies import best_twin
from studies.best import FREE, SECONDS, TRUTH, curve_slopes, wrong_start
from studies.best_twin import Twin
from studies.tasks import Failed, Task, kept, pool
from vsense_ros.estimation.filter import Array
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.identification import best
from vsense_ros.identification.information import Information, weigh
from vsense_ros.identification.progress import Progress
from vsense_ros.identification.rinsing import Drive, rinse
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import JUDGED_BY_CURVE, PAPER, REACH, SYMBOLS

TWINS = 100
FIRST_SEED = 3000  # of drivers, noise and starts, which no setting was chosen with
WITHIN = 1.645  # standard deviations, of a 90 % interval
_SECONDS_OF_TWIN = 6.0  # that one takes, roughly


@dataclass(frozen=True)
class Intervals:
    """Errors of n twins over stated standard deviations: of the parameters (n, 14) against the true car and against
    the pseudo-true one; of the force curves (n, 4, points) against the true car, NaN at slips that were not driven.
    `stated` (n, 14) are the standard deviations over the values, `without_noise` (n, 14) the errors of the estimates
    without noise over the values."""

    true: Array
    pseudo_true: Array
    curves: Array
    stated: Array
    without_noise: Array


def intervals(store: Path, twins: int = TWINS, progress: Progress = lambda share: None) -> Intervals:
    """Errors over stated standard deviations, of that many twins; each is kept in `store`."""
    seeds = range(FIRST_SEED, FIRST_SEED + twins)
    tasks = {f"twin {seed}": Task(_SECONDS_OF_TWIN, twin_intervals, (seed,)) for seed in seeds}
    with pool() as do_tasks:
        rows = [row for row in do_tasks(kept(tasks, store), progress) if not isinstance(row, Failed)]
    return Intervals(*(np.array(column) for column in zip(*rows, strict=True)))


def twin_intervals(seed: int) -> tuple[Array, ...]:
    """What `Intervals` has of each, for one twin."""
    twin = best_twin.drive(best_twin.rich_driver(seed), SECONDS)
    noisy, clean = (
        identified(twin.recorded(seed, cut_off=best.SETTINGS.cut_off, noise=noise), wrong_start(seed))
        for noise in (1.0, 0.0)
    )
    slopes, peak = curve_slopes(noisy.values)
    errors = best_4dof.curves(PAPER | dict(zip(FREE, noisy.values.tolist(), strict=True))) - best_4dof.curves(PAPER)
    stated = np.apply_along_axis(noisy.deviation_of, 0, slopes)
    ratio = errors / peak / stated
    ratio[~driven(twin)] = np.nan
    return (
        (noisy.values - TRUTH) / noisy.deviations, (noisy.values - clean.values) / noisy.deviations, ratio,
        noisy.deviations / TRUTH, clean.values / TRUTH - 1,
    )  # fmt: skip


def identified(drive: Drive, start: Mapping[str, float]) -> Information:
    """What `vsense identify` finds of a drive: passes of the filter, then prior and drive weighed."""
    one = best.identifier(start, FREE)
    return weigh(one, [drive], rinse(one, [drive]).values, one.begin(), best.prior(start, FREE))


def driven(twin: Twin) -> NDArray[np.bool_]:
    """Which slips of the force curves the twin had for more than 1 % of its drive, (4, points)."""
    speed, across, turning = (twin.states[:, i, None] for i in range(3))
    weights = PAPER["front_weight"], PAPER["rear_weight"]
    to_front = PAPER["wheelbase"] * weights[1] / sum(weights)
    arms = np.array([to_front, to_front, to_front - PAPER["wheelbase"], to_front - PAPER["wheelbase"]])
    ahead = speed + turning * PAPER["half_track"] * np.array([-1, 1, -1, 1])
    left = across + turning * arms
    steering, *spins = twin.inputs.T
    angle = np.column_stack([steering, steering, np.zeros_like(steering), np.zeros_like(steering)])
    along = ahead * np.cos(angle) + left * np.sin(angle)
    along, sideways = np.maximum(along, 2.0), left * np.cos(angle) - ahead * np.sin(angle)
    slip = {
        "lateral": np.abs(sideways / along),
        "longitudinal": np.abs(PAPER["wheel_radius"] * np.column_stack(spins) / along - 1),
    }
    reached = []
    for name in REACH:
        axle, direction = name.split()
        wheels = slice(0, 2) if axle == "front" else slice(2, 4)
        reached.append(best_4dof.curve_slips(name) <= np.quantile(slip[direction][:, wheels], 0.99))
    return np.array(reached)


def content(made: Intervals) -> dict[str, Any]:
    """Contents of the file of results: shares of intervals that hold, and median errors."""
    judged = [i for i, name in enumerate(FREE) if name not in JUDGED_BY_CURVE]
    known = np.isfinite(made.curves)
    return {
        "twins": len(made.true),
        "parameters": {
            SYMBOLS[name][0]: {
                "inside_90_percent": _share(made.true[:, i]),
                "inside_between": _between(made.true[:, i]),
                "inside_90_percent_of_pseudo_true": _share(made.pseudo_true[:, i]),
                "median_deviation_percent": float(100 * np.median(made.stated[:, i])),
                "median_error_without_noise_percent": float(100 * np.median(made.without_noise[:, i])),
                "spread_without_noise_percent": float(100 * np.std(made.without_noise[:, i])),
            }
            for i, name in enumerate(FREE)
        },
        "curves": {name: _share(made.curves[:, i][known[:, i]]) for i, name in enumerate(REACH)},
        "all": {
            "parameters": _share(made.true), "without C and E": _share(made.true[:, judged]),
            "pseudo-true parameters": _share(made.pseudo_true), "curves": _share(made.curves[known]),
        },
    }  # fmt: skip


def _between(errors: Array) -> list[float]:
    """95 % interval of the share of intervals that hold, by n twins (Clopper & Pearson 1934)."""
    found = binomtest(int((np.abs(errors) < WITHIN).sum()), len(errors)).proportion_ci()
    return [float(found.low), float(found.high)]


def _share(errors: Array | Sequence[float]) -> float:
    return float((np.abs(errors) < WITHIN).mean())


def show(made: Intervals, out: Console) -> None:
    """For the terminal."""
    found = content(made)
    heads = ("90 % interval holds", "of the pseudo-true", "σ, %", "error without noise, %", "its spread, %")
    table = plain_table(f"{found['twins']} twins at their limits", *heads, right=heads)
    for symbol, row in found["parameters"].items():
        table.add_row(
            symbol,
            f"{100 * row['inside_90_percent']:.0f} % ({100 * row['inside_between'][0]:.0f} to "
            f"{100 * row['inside_between'][1]:.0f})",
            f"{100 * row['inside_90_percent_of_pseudo_true']:.0f} %", f"{row['median_deviation_percent']:.2f}",
            f"{row['median_error_without_noise_percent']:+.2f}", f"{row['spread_without_noise_percent']:.2f}",
        )  # fmt: skip
    for name, share in found["curves"].items():
        table.add_row(f"force at slips driven, {name}", f"{100 * share:.0f} %", "", "", "", "")
    for words, share in found["all"].items():
        table.add_row(f"all: {words}", f"{100 * share:.0f} %", "", "", "", "")
    out.print(table)
