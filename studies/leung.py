"""The tables of Leung 2010 on filters (chapters 4 and 5), his figures beside ours, from one study.

A table is rows of a manoeuvre, columns of a filter and a quantity. Errors are those of eq. 1.1 and 1.2: `R` is 100
times the root mean square error in the SI unit of the quantity, `N` that over the range of the truth in percent. Ours
are the mean over seeds of the noise, once the filter has settled, with their standard deviation as spread. Plant, tyres
and driver are ours: what a table should show is its shape, and the sizes where the plant is in its linear range.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.text import Text

from studies import leung_causes, leung_models, leung_verdict
from studies.leung_observers import BOUND, OBSERVERS
from studies.leung_study import Results, study
from studies.tasks import Task, pool
from vsense_ros.assess.drives import Bus, Case, Error, Errors
from vsense_ros.bag.importers import genesis
from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import align, compare
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.runner.run import run
from vsense_ros.runner.smoothing import run_smoothed

Progress = Callable[[float], None]
SEEDS, QUICK_SEEDS, OBSERVER_SEEDS = 10, 1, 4
ROWS = {
    **{f"DO{v}": f"double_oval_{v}" for v in (15, 25, 35, 45, 55)},
    **{f"LC{v}": f"lane_change_{v}" for v in (15, 25, 35, 45, 55)},
}
QUICK_ROWS = ("DO35", "DO55", "LC35", "LC55")
SHORT = {"ST": "plain_straight", "RT": "right_turn", "LC": "lane_change_20", "8C": "eight", "SD": "slalom"}
# Sensors of chapters 4 and 5: their readings come by a CAN bus.
ON_THE_BUS = Errors(bus=Bus())
# Section 4.4: heading by a perfect gyro, accelerometers that feel no gravity, at 5 m/s.
SECTION_4_4 = Errors(gyro=Error(1e-6, 0.0), fix=5e-4**0.5, feels_gravity=False)


@dataclass(frozen=True)
class Column:
    """A quantity of a filter, as R or as N; of kind W as N of the whole drive, of kind S the deviation that the filter
    states, as N; of kind V 100 times the mean square error, which table 4.9 calls a percentage variance."""

    title: str
    filter: str
    quantity: str
    kind: str


@dataclass(frozen=True)
class Table:
    """Table of the thesis; `printed` has a figure for each column by row, None where it prints none."""

    title: str
    columns: tuple[Column, ...]
    printed: Mapping[str, tuple[float | None, ...]]
    errors: Errors = ON_THE_BUS
    manoeuvres: Mapping[str, str] = field(default_factory=lambda: ROWS)


def _columns(*texts: str) -> tuple[Column, ...]:
    """Columns from lines `title filter quantity kind`, with a | between."""
    return tuple(Column(*(part.strip() for part in text.split("|"))) for text in texts)


def _dual(filter: str, also: str = "") -> tuple[Column, ...]:
    """The columns of a dual filter, with `also` in their titles."""
    columns = _columns(
        f"psi N|{filter}|yaw|N", f"beta of fix N|{filter}|raw_side_slip|N", f"b_r R|{filter}|gyro_bias|R",
        f"v_x R|{filter}|forward_velocity|R", f"v_y N|{filter}|lateral_velocity|N", f"beta N|{filter}|side_slip|N",
        f"b_x R|{filter}|acceleration_bias_x|R", f"b_y R|{filter}|acceleration_bias_y|R",
    )  # fmt: skip
    return tuple(replace(one, title=f"{one.title}{also}") for one in columns)


def _printed(*rows: str) -> dict[str, tuple[float | None, ...]]:
    """Printed figures from lines `row figure figure …`; `-` stands for none."""
    split = (row.split() for row in rows)
    return {name: tuple(None if f == "-" else float(f) for f in figures) for name, *figures in split}


TABLES = {
    "4.2": Table(
        "dual KKF", _dual("dual_kkf") + _columns("psi W|dual_kkf|yaw|W", "v_y R|dual_kkf|lateral_velocity|R"),
        _printed(
            "DO15 0.04 5.72 0.03 3.01 6.86 6.90 13.96 0.22 0.04 -",
            "DO25 0.04 5.15 0.06 3.38 6.37 6.40 15.18 0.16 0.04 -",
            "DO35 0.05 7.04 0.08 3.88 9.76 9.75 17.35 0.41 0.05 -",
            "DO45 0.06 15.13 0.09 4.96 24.52 24.44 20.03 0.57 0.06 -",
            "DO55 0.08 14.15 0.09 8.27 21.43 21.25 23.22 1.08 0.08 -",
            "LC15 0.81 12.64 0.09 3.19 14.92 14.96 0.49 0.44 0.81 -",
            "LC25 0.59 10.93 0.10 4.12 11.72 11.76 3.24 0.46 0.59 -",
            "LC35 0.58 14.73 0.23 5.37 15.85 15.89 23.55 1.07 0.58 -",
            "LC45 0.55 18.86 0.16 7.48 21.39 21.46 30.46 1.48 0.55 -",
            "LC55 0.52 47.10 0.21 10.01 62.16 62.46 39.09 2.06 0.52 -",
        ),
    ),
    "4.3": Table(
        "dual KKF with a heading sensor of 0.1 rad, and without",
        _dual("dual_kkf_heading") + _dual("dual_kkf", ", without"),
        _printed(
            "DO25 0.04 4.80 0.04 3.11 5.94 5.97 15.12 0.29 0.04 5.35 0.08 3.14 6.49 6.52 15.24 0.43",
            "DO45 0.05 12.77 0.04 4.33 22.33 22.30 19.74 0.61 0.07 16.26 0.08 4.24 26.02 25.94 20.11 0.64",
            "DO55 0.07 13.81 0.07 7.59 20.71 20.52 22.98 0.81 0.08 14.99 0.08 7.53 22.55 22.36 23.08 1.07",
            "LC25 0.59 11.17 0.16 3.50 11.92 11.95 2.84 0.56 0.61 11.47 0.15 3.59 12.29 12.31 3.00 0.72",
            "LC45 0.51 20.99 0.26 5.63 22.59 22.66 30.77 1.16 0.60 19.94 0.20 5.42 21.81 21.89 30.88 1.60",
            "LC55 0.66 60.05 0.20 7.17 74.65 74.88 39.22 1.34 0.54 51.69 0.19 7.33 67.94 68.21 39.39 2.08",
        ),
        replace(ON_THE_BUS, heading=0.1),
    ),
    "4.4": Table(
        "heading by wheel speeds, and by gyro",
        _columns(
            "psi of wheels b2 N|wheel_speed_ekf_b2|yaw|N", "b_w R|wheel_speed_ekf_b2|rolling_radius|R",
            "psi of gyro N|yaw_kkf|yaw|N", "b_r R|yaw_kkf|gyro_bias|R",
        ),
        _printed(
            "DO15 0.11 0.18 0.04 0.03", "DO25 0.07 0.30 0.04 0.06", "DO35 0.20 0.35 0.05 0.08",
            "DO45 0.93 0.12 0.06 0.09", "DO55 4.38 0.14 0.08 0.09", "LC15 1.23 0.33 0.81 0.09",
            "LC25 0.98 0.36 0.59 0.10", "LC35 1.02 0.22 0.58 0.23", "LC45 1.12 0.34 0.55 0.16",
            "LC55 1.39 0.39 0.52 0.21",
        ),
    ),
    "4.5": Table(
        "forward velocity by wheels, and by the dual KKF",
        _columns("v_x of wheels R|wheel_speed_ekf_b2|forward_velocity|R", "v_x dual R|dual_kkf|forward_velocity|R"),
        _printed(
            "DO15 0.85 2.96", "DO25 0.89 3.05", "DO35 1.10 2.91", "DO45 2.19 3.42", "DO55 10.04 6.71",
            "LC15 0.88 2.82", "LC25 0.93 3.03", "LC35 0.90 2.92", "LC45 0.99 3.04", "LC55 1.06 2.98",
        ),
    ),
    "4.6": Table(
        "triple KF",
        _columns(
            "psi of gyro N|triple_kkf|yaw|N", "b_r R|triple_kkf|gyro_bias|R", "v_x R|triple_kkf|forward_velocity|R",
            "v_y N|triple_kkf|lateral_velocity|N",
            "b_x R|triple_kkf|acceleration_bias_x|R", "b_y R|triple_kkf|acceleration_bias_y|R",
            "psi of wheels c N|wheel_speed_ekf_c|yaw|N", "b_w R|triple_kkf|rolling_radius|R",
        ),
        _printed(
            "DO15 0.04 0.04 0.87 6.75 13.14 0.21 0.04 0.34", "DO25 0.04 0.06 0.90 6.09 13.15 0.38 0.04 0.37",
            "DO35 0.05 0.09 0.99 9.37 13.21 0.40 0.05 0.31", "DO45 0.06 0.05 2.28 24.78 13.85 0.79 0.10 0.08",
            "DO55 0.08 0.08 10.22 20.45 13.68 1.29 0.29 0.24", "LC15 1.24 0.09 0.84 16.67 2.31 0.14 1.25 0.25",
            "LC25 1.08 0.08 0.94 14.77 2.69 0.58 1.13 0.31", "LC35 0.65 0.16 0.98 16.95 12.81 0.91 0.68 0.20",
            "LC45 0.64 0.18 0.95 24.54 12.65 1.27 0.71 0.32", "LC55 0.60 0.25 1.04 74.65 12.74 2.19 0.78 0.38",
        ),
    ),
    "4.9": Table(
        "lateral velocity with extrapolated side slip, 5 m/s (LC at 20 km/h)",
        _columns(
            "dual V|dual_kkf|lateral_velocity|V", "line V|side_slip_kkf_1|lateral_velocity|V",
            "parabola V|side_slip_kkf_2|lateral_velocity|V", "ours V|inertial|lateral_velocity|V",
        ),
        _printed(
            "ST 0.09 0.03 0.03 -", "RT 0.11 0.05 0.05 -", "LC 0.10 0.07 0.11 -", "8C 0.43 0.44 0.58 -",
            "SD 1.52 2.34 2.81 -",
        ),
        SECTION_4_4, SHORT,
    ),
    "5.4": Table(
        "single-track model, open loop and as MEKF 2c",
        _columns(
            "beta open N|single_track|side_slip|N", "beta 2c N|mekf_2c|side_slip|N", "r open N|single_track|yaw_rate|N",
            "r 2c N|mekf_2c|yaw_rate|N", "b_d R|mekf_2c|steering_bias|R",
        ),
        _printed(
            "DO15 2.4019 0.6062 2.4209 0.8362 0.1011", "DO25 2.5188 0.8253 2.3923 0.5631 0.0872",
            "DO35 2.7803 1.2146 2.3419 0.3609 0.0636", "DO45 4.2303 3.5376 2.3035 0.2580 0.0649",
            "DO55 4.8329 10.1776 2.8420 0.7895 0.0843", "LC15 7.1101 2.3481 6.8070 2.1964 0.1787",
            "LC25 8.5864 2.3685 8.0985 2.0595 0.1346", "LC35 8.8404 1.9844 8.9756 1.6298 0.0966",
            "LC45 8.7876 2.7409 9.1996 1.4280 0.0934", "LC55 9.4020 9.8130 9.4889 1.2488 0.0817",
        ),
    ),
    "5.5": Table(
        "side slip and yaw rate of integrated filters",
        _columns(
            "beta triple b N|triple_kkf_b|side_slip|N", "beta IKF a N|integrated_kf_a|side_slip|N",
            "beta 2c N|mekf_2c|side_slip|N", "r triple b N|triple_kkf_b|yaw_rate|N",
            "r IKF a N|integrated_kf_a|yaw_rate|N", "r 2c N|mekf_2c|yaw_rate|N",
            "beta integrated N|integrated|side_slip|N", "beta inertial N|inertial|side_slip|N",
            "beta errorEKF N|error_ekf|side_slip|N", "beta SPI N|spi|side_slip|N",
            "beta SPI, tyres ± 10 %, N|spi_unsure|side_slip|N", "beta bound N|bound|side_slip|S",
        ),
        _printed(
            "DO15 6.8045 0.4174 0.6062 0.7560 0.4377 0.8362 - - - - - -",
            "DO25 5.2610 0.3232 0.8253 0.4946 0.3555 0.5631 - - - - - -",
            "DO35 6.9596 0.5600 1.2146 0.3849 0.3683 0.3609 - - - - - -",
            "DO45 15.1912 4.0282 3.5376 0.3259 0.3511 0.2580 - - - - - -",
            "DO55 12.7709 12.8077 10.1776 0.2911 0.7194 0.7895 - - - - - -",
            "LC15 21.0481 1.8495 2.3481 2.6157 1.8660 2.1964 - - - - - -",
            "LC25 17.8751 1.4995 2.3685 2.109 1.4815 2.0595 - - - - - -",
            "LC35 17.2353 1.4223 1.9844 1.7858 1.2260 1.6298 - - - - - -",
            "LC45 24.3931 2.2926 2.7409 1.5617 1.0856 1.4280 - - - - - -",
            "LC55 69.7912 9.2321 9.8130 1.4422 0.99748 1.2488 - - - - - -",
        ),
    ),
}  # fmt: skip
OF_MODELS = ("3.4", "5.2", "5.3")
GENESIS = "4.11"  # whose recordings are not public: laps of another car in their place
GENESIS_LAP = "med_lap_center_8_21.mat"  # the third
GENESIS_FILTERS = ("dual_kkf", "side_slip_kkf_1", "side_slip_kkf_2", "mekf_2b", "inertial", "integrated")
SMOOTHED = "inertial, smoothed"
NAMES = tuple(sorted({*TABLES, *OF_MODELS, GENESIS}, key=lambda name: [int(part) for part in name.split(".")]))
Array = NDArray[np.float64]
Found = dict[str, dict[str, dict[str, dict[str, float | None]]]]


def repeat(
    names: Sequence[str],
    store: Path,
    laps: Path | None,
    progress: Progress = lambda share: None,
    *,
    quick: bool = False,
    processes: int | None = None,
) -> tuple[Found, Results]:
    """Tables by name, each with its figures by row and column, and the results of the study they come from.

    `quick` takes one seed, and of ten manoeuvres four. `laps` is the folder of the Genesis laps, None where they are
    not there. Raises `InputError` for an unknown table.
    """
    check(names)
    chosen = {name: TABLES[name] for name in names if name in TABLES}
    seeds = range(QUICK_SEEDS if quick else SEEDS)
    wanted: dict[Case, list[str]] = {}
    for table in chosen.values():
        for row in _rows(table, quick):
            for seed in seeds:
                case = Case(table.manoeuvres[row], seed, table.errors)
                wanted.setdefault(case, []).extend(c.filter for c in table.columns if seed in _seeds_of(c, seeds))
    others = [(name, task) for name in names for task in _tasks(name, store, laps, quick)]
    share_of_study = len(wanted) / (len(wanted) + len(others)) if wanted else 0.0
    with pool(processes) as do_tasks:
        results = study(wanted.items(), store, lambda share: progress(share_of_study * share), do_tasks=do_tasks)
        tasks = [task for _, task in others]
        parts = do_tasks(tasks, lambda share: progress(share_of_study + (1 - share_of_study) * share))
    figures: Found = {name: _figures(table, results, seeds, quick) for name, table in chosen.items()}
    for (name, _), part in zip(others, parts, strict=True):
        for row, columns in part.items():
            figures.setdefault(name, {}).setdefault(row, {}).update(columns)
    return {name: figures[name] for name in names if name in figures}, results


def check(names: Sequence[str]) -> None:
    """Raises `InputError` for an unknown table."""
    for name in names:
        if name not in NAMES:
            raise InputError(f"no table {name!r}; there are: {', '.join(NAMES)}")


def _tasks(name: str, store: Path, laps: Path | None, quick: bool) -> list[Task]:
    """What makes the parts of a table that does not come from the study of filters."""
    if name == "3.4":
        return [Task(20.0, leung_models.table_3_4, (store, row)) for row in ("DO25", "LC25")]
    if name == "5.2":
        return [Task(0.1, leung_models.table_5_2, ())]
    if name == "5.3":
        return [Task(10.0, leung_models.table_5_3, (store, row)) for row in (QUICK_ROWS if quick else ROWS)]
    if name == GENESIS and laps is not None:
        runs = (*GENESIS_FILTERS, SMOOTHED)
        return [Task(5.0, genesis_run, (laps, rate, one)) for rate in (10.0, 1.0) for one in runs]
    return []


def _rows(table: Table, quick: bool) -> tuple[str, ...]:
    rows = tuple(table.printed)
    return tuple(row for row in rows if row in QUICK_ROWS or table.manoeuvres is SHORT) if quick else rows


def _figures(
    table: Table, results: Results, seeds: range, quick: bool
) -> dict[str, dict[str, dict[str, float | None]]]:
    figures: dict[str, dict[str, dict[str, float | None]]] = {}
    for row in _rows(table, quick):
        figures[row] = {}
        for column, printed in zip(table.columns, table.printed[row], strict=True):
            cases = [Case(table.manoeuvres[row], seed, table.errors) for seed in _seeds_of(column, seeds)]
            scores = [results[case, column.filter] for case in cases]
            values = [figure(one, column) for one in scores]
            figures[row][column.title] = {
                "printed": printed,
                "ours": float(np.mean(values)),
                "spread": float(np.std(values, ddof=1)) if len(values) > 1 else None,
                "range": scores[0][column.quantity]["range"],
            }
    return figures


def _seeds_of(column: Column, seeds: range) -> range:
    """Those that a column takes: what can be expected along the true drive is the same for all. The multibody
    observers, which the thesis does not have, take six times as long as its filters and get fewer seeds."""
    if column.kind == "S":
        return seeds[:1]
    return seeds[:OBSERVER_SEEDS] if column.filter in OBSERVERS else seeds


def figure(result: Mapping[str, Any], column: Column) -> float:
    """A figure of a column, of the scores of a filter."""
    score = result[column.quantity]
    if column.kind == "S":
        return float(100 * result[f"expected_{column.quantity}"] / score["range"])
    error = score["whole" if column.kind == "W" else "rmse"]
    if column.kind == "V":
        return float(100 * error**2)
    return 100 * error / (score["range"] if column.kind in "NW" else 1.0)


def side_slips(results: Results) -> dict[str, dict[str, dict[str, float]]]:
    """Side slip of the integrated filter and of the observers with their normalized error squared, and the `bound`, by
    row of what the study has."""
    by_row: dict[str, dict[str, dict[str, float]]] = {}
    for name in ("integrated", "error_ekf", "spi"):
        for row, manoeuvre in ROWS.items():
            every = _of_row(results, name, manoeuvre)
            if every:
                extent = every[0]["side_slip"]["range"]
                by_row.setdefault(name, {})[row] = {
                    "beta_nrmsd_percent": float(np.mean([100 * one["side_slip"]["rmse"] / extent for one in every])),
                    "nees": float(np.mean([one["nees"]["side_slip"] for one in every])),
                }
    for row, manoeuvre in ROWS.items():
        bounds = _of_row(results, BOUND, manoeuvre)
        if bounds:
            share = [100 * one["expected_side_slip"] / one["side_slip"]["range"] for one in bounds]
            by_row.setdefault(BOUND, {})[row] = {"beta_nrmsd_percent": float(np.mean(share))}
    return by_row


def _of_row(results: Results, name: str, manoeuvre: str) -> list[Mapping[str, Any]]:
    return [
        one
        for (case, filter), one in results.items()
        if filter == name and case.manoeuvre == manoeuvre and case.errors == ON_THE_BUS
    ]


def genesis_run(laps: Path, rate: float, name: str) -> dict[str, dict[str, dict[str, float | None]]]:
    """A filter on the third Genesis lap, GNSS at a rate [Hz]: side slip [°], how far its error is from its mean over a
    second, its normalized error squared (1 where what a filter states is true), and NRMSD of the lateral velocity. In
    place of table 4.11, whose recordings are not public."""
    car, lap = load_vehicle(vehicle_path("genesis")), genesis.read(laps / GENESIS_LAP, gnss_rate_hz=rate)
    output = run_smoothed(lap, car, "inertial").output if name == SMOOTHED else run(lap, car, name).output
    seen = at_reference(output, car)
    scores = compare(seen, lap)
    at, error, deviation = angle_errors(seen, lap, "side_slip")
    known = np.isfinite(deviation)
    values = {
        f"beta RMSE [°], {rate:g} Hz": float(np.degrees(scores["side_slip"].rmse)),
        f"within 1 s [°], {rate:g} Hz": float(np.degrees(np.std(fast_part(at, error, 1.0)))),
        f"v_y N, {rate:g} Hz": scores["lateral_velocity"].nrmsd_percent,
        f"NEES of beta, {rate:g} Hz": float(np.mean((error[known] / deviation[known]) ** 2)),
    }
    return {name: {title: {"printed": None, "ours": value, "spread": None} for title, value in values.items()}}


def angle_errors(output: Recording, lap: Recording, key: str) -> tuple[Array, Array, Array]:
    """Times [s], errors and stated standard deviations [rad] of an angle, (n,) each, at the stamps of the reference."""
    mine, true = read_signals(output, "vsense")[key], read_signals(lap, "reference")[key]
    aligned = align(mine, true)
    stated = np.full(len(mine), np.inf) if mine.deviation is None else mine.deviation
    deviation = np.interp(aligned.stamp, mine.stamp, stated)
    return (aligned.stamp - true.stamp[0]) * 1e-9, aligned.error[:, 0], deviation


def show(figures: Found, console: Console) -> None:
    """Print tables: ours, its spread over seeds, and in brackets what the thesis prints. A wide one comes in parts."""
    for name, rows in figures.items():
        title = TABLES[name].title if name in TABLES else _TITLES[name]
        console.print(Text.assemble("\n", (f"Table {name}", "bold"), f": {title}"))
        cells = {
            heading: {row: _cell(columns.get(heading)) for row, columns in rows.items()}
            for heading in next(iter(rows.values()))
        }
        first = max(map(len, rows))
        for i, part in enumerate(_parts(cells, console.width - first)):
            if i:
                console.print()
            table = plain_table("", *part, right=tuple(part))
            table.columns[0].width = first
            for column, width in zip(table.columns[1:], part.values(), strict=True):
                column.width = width
            for row in rows:
                table.add_row(row, *(cells[heading][row] for heading in part))
            console.print(table)
    console.print(
        "\nOurs ± spread over seeds (thesis). N: RMSE over range [%], R: 100 RMSE [SI], after 20 s; W: N of the whole "
        "drive, V: 100 MSE [SI]. On our plant, tyres and driver.",
        soft_wrap=True,
    )


_TITLES = {
    "3.4": "open-loop models, NRMSD [%]",
    "5.2": "parametric sensitivity",
    "5.3": "input errors, NRMSD [%]",
    GENESIS: "third Genesis lap in place of MIRA's",
}


def fast_part(at: Array, values: Array, length: float) -> Array:
    """Values (n,) less their mean over `length` [s] around each; without those nearer than half of it to either end."""
    whole = np.concatenate([[0.0], np.cumsum(values)])
    inside = (at - at[0] >= length / 2) & (at[-1] - at >= length / 2)
    first, last = (np.searchsorted(at, at[inside] + side * length / 2) for side in (-1, 1))
    return values[inside] - (whole[last] - whole[first]) / (last - first)


_SPACE = 2  # between columns, on either side


def _parts(cells: Mapping[str, Mapping[str, str]], width: int) -> list[dict[str, int]]:
    """Headings of the columns that fit side by side, with their widths; a heading may be broken between words."""
    parts: list[dict[str, int]] = [{}]
    for heading, column in cells.items():
        needed = max(map(len, (*column.values(), *heading.split())))
        if parts[-1] and sum(parts[-1].values()) + needed + 2 * _SPACE * (len(parts[-1]) + 1) > width:
            parts.append({})
        parts[-1][heading] = needed
    return parts


def _cell(figure: Mapping[str, float | None] | None) -> str:
    if figure is None or figure["ours"] is None:
        return "–"
    spread, printed = figure.get("spread"), figure.get("printed")
    text = f"{figure['ours']:.3g}" + (f" ± {spread:.1g}" if spread is not None else "")
    return text + (f" ({printed:g})" if printed is not None else "")


def show_verdicts(figures: Found, console: Console) -> None:
    """Print for each table how many of its figures are as near to the thesis's as they should be, and why others are
    not."""
    console.print(Text("\nBeside the thesis, in degrees and m/s", "bold"))
    for name, rows in figures.items():
        every = list(leung_verdict.judged(rows, partial(_shape, name)))
        leung_verdict.show(name, every, leung_causes.CAUSES, console)


def _shape(name: str, row: str, title: str) -> leung_verdict.Shape | None:
    """What the figures of a row and a column of a table are, None for those that are no motion."""
    if name in TABLES:
        return next(leung_verdict.Shape(c.quantity, c.kind) for c in TABLES[name].columns if c.title == title)
    if (name == "3.4" and row.startswith("lateral")) or (name == "5.3" and title.startswith("beta")):
        return leung_verdict.Shape("lateral_velocity" if name == "3.4" else "side_slip", "N")
    return None


def write(figures: Found, results: Results, path: Path) -> None:
    """Write as JSON: `{table: {row: {column: {printed, ours, spread, range [SI]}}}}`, and side slip of the integrated
    filter by row."""
    _add({**figures, **side_slips(results)}, path)


def write_figures(figures: Mapping[str, Mapping[str, Mapping[str, float]]], path: Path) -> None:
    """Write numbers of figures as JSON to a file, which keeps its others: `{figure N: {row: {column: number}}}`."""
    _add({f"figure {name}": rows for name, rows in figures.items()}, path)


def _add(content: Mapping[str, Any], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    with atomic_write(path) as file:
        json.dump({**known, **content}, file, indent=2)
        file.write("\n")
