"""How far the identification of the twin can be relied on: from many starts, and with everyday driving.

Beside the filter runs plain output-error least squares: the model alone over the whole drive, Levenberg and Marquardt
with exact sensitivities, from the same starts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from scipy.optimize import least_squares

from studies import best_twin
from studies.best import FREE, SECONDS, TRUTH, curve_errors, wrong_start
from studies.tasks import Failed, Task, kept, pool
from vsense_ros.estimation.filter import Array
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification import best
from vsense_ros.identification.identification import AXLES, cornering_stiffness
from vsense_ros.identification.information import Information, refusals, weigh
from vsense_ros.identification.open_loop import OpenLoop
from vsense_ros.identification.progress import Progress
from vsense_ros.identification.rinsing import Drive, rinse
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import BOUNDS, PAPER, Best4Dof

STARTS = 20
WRONG_MINIMUM = 0.05  # RMS error of a curve, of its peak, beyond which a fit is in a wrong minimum
EVERYDAY = 100  # twins
EVERYDAY_LEVEL = 0.2  # of the driver: |a_y| up to 4 m/s²
EVERYDAY_SECONDS = 60.0
WITHIN = 1.645  # standard deviations, of a 90 % interval
REFUSED = ("front_peak", "rear_peak", *best_4dof.JUDGED_BY_CURVE)


@dataclass(frozen=True)
class Study:
    """Largest curve error by start, of the filter and of least squares (STARTS,); of everyday twins, by axle errors of
    D C_α in standard deviations and these over the value (EVERYDAY, 2); how often each of `REFUSED` was refused."""

    filter: Array
    peer: Array
    errors: Array
    deviations: Array
    refused: Mapping[str, float]


def study(
    store: Path, starts: int = STARTS, everyday: int = EVERYDAY, progress: Progress = lambda share: None
) -> Study:
    """Takes some ten minutes; each start and each drive is kept in `store`."""
    tasks = {f"start {seed}": Task(8.0, of_start, (100 + seed,)) for seed in range(starts)}
    tasks |= {f"everyday {seed}": Task(4.0, of_everyday, (seed,)) for seed in range(everyday)}
    with pool() as do_tasks:
        found = do_tasks(kept(tasks, store), progress)
    largest = np.array([one for one in found[:starts] if not isinstance(one, Failed)]).reshape(-1, 2)
    drives = [one for one in found[starts:] if not isinstance(one, Failed)]
    errors, deviations = (np.array([one[i] for one in drives]) for i in range(2))
    shares = {name: float(np.mean([name in one[2] for one in drives])) if drives else 0.0 for name in REFUSED}
    return Study(largest[:, 0], largest[:, 1], errors, deviations, shares)


def of_start(seed: int) -> tuple[float, float]:
    """Largest curve error from one start, of the filter and of least squares."""
    drive = best_twin.drive(best_twin.rich_driver(0), SECONDS).recorded(0, cut_off=best.SETTINGS.cut_off)
    start = wrong_start(seed)
    return _largest(rinse(best.identifier(start, FREE), [drive]).values), _largest(output_error(drive, start))


def of_everyday(seed: int) -> tuple[list[float], list[float], set[str]]:
    """By axle the error of D C_α in standard deviations and these over the value, and what was refused, in a drive."""
    identified, start = everyday_drive(seed)
    row = [cornering_stiffness(identified, axle, start) for axle in AXLES]
    truth = [cornering_stiffness(_of(TRUTH, identified), axle, PAPER)[0] for axle in AXLES]
    errors = [(value - true) / spread for (value, spread), true in zip(row, truth, strict=True)]
    deviations = [spread / true for (_, spread), true in zip(row, truth, strict=True)]
    return errors, deviations, {refusal.name for refusal in refusals(identified, best_4dof.JUDGED_BY_CURVE)}


def everyday_drive(seed: int) -> tuple[Information, dict[str, float]]:
    """Information in an everyday drive, and the wrong parameters that it started from."""
    driver = best_twin.rich_driver(1000 + seed, EVERYDAY_LEVEL)
    drive = best_twin.drive(driver, EVERYDAY_SECONDS).recorded(seed, cut_off=best.SETTINGS.everyday_cut_off)
    start = wrong_start(seed)
    one = best.identifier(start, FREE)
    rinsed = rinse(one, [drive])
    return weigh(one, [drive], rinsed.values, one.begin(), best.prior(start, FREE)), start


def output_error(drive: Drive, start: Mapping[str, float]) -> Array:
    """Parameters (14,) that plain least squares finds on the outputs of the model alone."""
    model = OpenLoop(Best4Dof(), PAPER, FREE)
    weights = 1 / np.array(best.SETTINGS.output_deviations)
    low, high = np.array([BOUNDS[name] for name in FREE]).T
    begin = np.array([start[name] for name in FREE])
    lost = np.full(drive.outputs.size, 1e3)

    def residuals(scaled: Array) -> Array:
        try:
            return np.ravel((model.outputs(drive, scaled * begin) - drive.outputs) * weights)
        except FloatingPointError:
            return lost

    def slopes(scaled: Array) -> Array:
        try:
            by = model.sensitivities(drive, scaled * begin)[1]
        except FloatingPointError:
            return np.zeros((lost.size, len(begin)))
        return (by * weights[:, None] * begin).reshape(-1, len(begin))

    solution = least_squares(residuals, np.ones(len(begin)), slopes, bounds=(low / begin, high / begin), max_nfev=40)
    return np.asarray(solution.x * begin)


def _largest(values: Array) -> float:
    return float(curve_errors(values).max())


def _of(values: Array, like: Information) -> Information:
    return Information(like.names, values, like.prior, like.scaled, form=like.form)


def content(made: Study) -> dict[str, Any]:
    """Contents of the file of results."""
    inside = np.abs(made.errors) < WITHIN
    return {
        "starts": len(made.filter),
        "wrong_minima": {"filter": int((made.filter > WRONG_MINIMUM).sum()),
                         "output_error": int((made.peer > WRONG_MINIMUM).sum())},
        "largest_curve_error_percent": {"filter": float(100 * made.filter.max()),
                                        "output_error": float(100 * made.peer.max())},
        "everyday": {
            axle: {"inside_90_percent": float(inside[:, i].mean()), "median_deviation_percent":
                   float(100 * np.median(made.deviations[:, i])), "mean_error_in_deviations":
                   float(made.errors[:, i].mean())}
            for i, axle in enumerate(AXLES)
        } if len(made.errors) else {},
        "refused": dict(made.refused),
    }  # fmt: skip


def write(content: Mapping[str, Any], path: Path) -> None:
    """Write results as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps(content, indent=2) + "\n")


def show(study: Study, out: Console) -> None:
    """For the terminal."""
    made = content(study)
    table = plain_table(f"{made['starts']} random starts, ±30 %", "wrong minima", "largest curve error, % of peak",
                        right=("wrong minima", "largest curve error, % of peak"))  # fmt: skip
    for name, words in (("filter", "identifying EKF"), ("output_error", "output-error least squares")):
        table.add_row(words, str(made["wrong_minima"][name]), f"{made['largest_curve_error_percent'][name]:.1f}")
    out.print(table)
    heads = ("inside 90 % interval", "median σ, %", "mean error, σ")
    table = plain_table(f"D C_α from {len(study.errors)} everyday drives of 60 s", *heads, right=heads)
    for axle, row in made["everyday"].items():
        cells = (f"{100 * row['inside_90_percent']:.0f} %", f"{row['median_deviation_percent']:.1f}",
                 f"{row['mean_error_in_deviations']:+.2f}")  # fmt: skip
        table.add_row(axle, *cells)
    out.print(table)
    out.print(
        "Refused as not determined: " + ", ".join(f"{n} {100 * share:.0f} %" for n, share in made["refused"].items())
    )
