"""The errorEKF's table of Rodríguez 2020 (slides, "Estimations … simplified vehicle MB model: RMSE"), repeated.

Plant and observer differ as his do: 600 kg and a friction of 0.8 or 0.6 on one side, 700 kg and 1.0 on the other.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from vsense_ros import observer
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.manoeuvre import generate
from vsense_ros.manoeuvre.sensing import EPOCH
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES, STEP
from vsense_ros.model.vehicle import Vehicle

SEEDS = tuple(range(5))


@dataclass(frozen=True)
class Row:
    """A line of his table: RMSE of his errorEKF in both manoeuvres, his percentage where he prints it (manoeuvre 2)."""

    name: str
    label: str
    rmse: tuple[float, float] | None  # None: not in his table
    percent: float | None = None
    since: float = 0.0  # [s] scored from here on

    @property
    def signal(self) -> str:
        return self.name.removesuffix("_after_step")


ROWS = (
    Row("position", "position [m]", (0.1988, 0.4023)),
    Row("position_after_step", "position, from the steering step on [m]", None, since=STEP),
    Row("longitudinal_acceleration", "X acceleration [m/s²]", (0.1319, 0.3018)),
    Row("lateral_acceleration", "Y acceleration [m/s²]", (0.7923, 1.5429)),
    Row("vertical_acceleration", "Z acceleration [m/s²]", (0.3496, 0.3662)),
    Row("wheel_force_rr_x", "RR longitudinal tyre force [N]", (76.09, 165.32), 41.0),
    Row("wheel_force_rr_y", "RR lateral tyre force [N]", (237.69, 265.58), 50.0),
    Row("wheel_force_rr_z", "RR vertical tyre force [N]", (144.25, 180.09), 18.0),
)


@dataclass(frozen=True)
class Result:
    """RMSE of one signal in one manoeuvre over all seeds [its unit], and in percent of the largest |truth|."""

    rmse: float
    percent: float | None  # None for the position, whose size means nothing


Results = dict[str, dict[str, Result]]  # manoeuvre → row


def repeat(
    plant: Vehicle,
    model: Vehicle,
    seeds: tuple[int, ...] = SEEDS,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Both manoeuvres with the noise of every seed, from rest to the end, nothing left out.

    The observer knows neither where the car stands nor where it heads, and gets no wheel torques.
    """
    results: Results = {}
    for number, manoeuvre in enumerate(MANOEUVRES):
        squares: dict[str, list[float]] = {row.name: [] for row in ROWS}
        largest: dict[str, float] = {}
        for done, seed in enumerate(seeds):
            recording = generate(manoeuvre.name, plant, seed)
            estimates = read_signals(observer.run(recording, model).output, "vsense")
            truths = read_signals(recording, "reference")
            for row in ROWS:
                aligned = align(estimates[row.signal], truths[row.signal])
                scored = aligned.stamp >= EPOCH + row.since * 1e9
                squares[row.name].append(float(np.mean(np.sum(aligned.error[scored] ** 2, axis=1))))
                largest[row.name] = float(np.abs(aligned.truth).max())
            if progress is not None:
                progress((number * len(seeds) + done + 1) / (len(MANOEUVRES) * len(seeds)))
        results[manoeuvre.name] = {}
        for row in ROWS:
            rmse = float(np.sqrt(np.mean(squares[row.name])))
            percent = None if row.signal == "position" else 100 * rmse / largest[row.name]
            results[manoeuvre.name][row.name] = Result(rmse, percent)
    return results


def show(results: Results, console: Console) -> None:
    """His figures and ours side by side."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    table.add_column("RMSE")
    for number in (1, 2):
        table.add_column(f"manoeuvre {number}: Rodríguez", justify="right")
        table.add_column("ours", justify="right")
    for row in ROWS:
        cells = [row.label]
        for i, manoeuvre in enumerate(MANOEUVRES):
            result = results[manoeuvre.name][row.name]
            his = f"{row.rmse[i]:.4g}" if row.rmse else "–"
            his += f" ({row.percent:.0f} %)" if row.percent is not None and i == 1 else ""
            ours = f"{result.rmse:.3g}" + (f" ({result.percent:.0f} %)" if result.percent is not None else "")
            cells += [his, ours]
        table.add_row(*cells)
    console.print(table)
    console.print(
        "Percent of the largest magnitude of the truth (what his percentages refer to, the slides do not say). "
        "Plant: 600 kg, friction 0.8 and 0.6; observer: 700 kg, friction 1.0."
    )


def write(results: Results, path: Path) -> None:
    """The same as JSON: {manoeuvre: {row: {rmse, percent, rodriguez_rmse}}}."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        manoeuvre.name: {
            row.name: {
                "rmse": results[manoeuvre.name][row.name].rmse,
                "percent": results[manoeuvre.name][row.name].percent,
                "rodriguez_rmse": row.rmse[i] if row.rmse else None,
            }
            for row in ROWS
        }
        for i, manoeuvre in enumerate(MANOEUVRES)
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
