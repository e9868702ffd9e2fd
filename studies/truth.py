"""What is published, held against what it says of itself: one file of figures for all drives that have a reference.

For each drive and output the share of errors within two of the standard deviations that the filter states, NEES, the
error, and that of what costs nothing; tyre forces against a plant or the inertial sensor; faults; the standard
deviations of GNSS/INS filters; and by how much sensors are late against the reference.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from studies import fault_outcomes, fault_rows, navigation_consistency, road
from studies.coverage import Compared, coverage_table
from studies.genesis import EXAMINED_ON, IDENTIFIED_FROM
from studies.heading_transient import HeadingTransient, transient_of
from studies.navigation_consistency import GENESIS, RECORDED, Drive
from studies.tasks import Failed, Task, kept, pool
from vsense_ros.bag.datasets import data_dir
from vsense_ros.bag.importers import genesis, import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.balance import balance
from vsense_ros.evaluate.metrics import lag
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import SIGNALS, Series, find_channel, make_series, read_signals
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import IN_BAGS
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import run

Progress = Callable[[float], None]

LAPS = (*IDENTIFIED_FROM, EXAMINED_ON)
OF_BAGS = "prototype_model"  # vehicle file by which bags are estimated, other than that of the plant
FAULT_ROWS = 12  # of the systematic table; `make exam` does more of them
QUICK = ("med_lap_center_8_21.mat 1 Hz", "comma2k19_rav4", "step_steer")  # drives of a quick look
# Shares of the time that a percentile of an undriven wheel's force leaves on either side [%].
PERCENTILES = (5.0, 95.0)


@dataclass(frozen=True)
class Outcome:
    """What came of one drive: signals by the title of the drive, or of a part of it; figures of forces; sensors' lags
    behind the reference [ms]."""

    compared: Mapping[str, Compared]
    forces: Mapping[str, Any]
    lags_ms: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Results:
    """All that was examined, by drive, row or filter."""

    drives: Mapping[str, Outcome]
    faults: Sequence[fault_outcomes.RowOutcome]
    navigation: Mapping[str, Mapping[str, Mapping[str, float]]]
    failed: Mapping[str, str] = field(default_factory=dict)  # error by part
    left_out: Sequence[str] = ()  # drives whose recordings are not here

    def compared(self) -> dict[str, Compared]:
        """Signals by the title of the drive, or of a part of it."""
        return {title: one for outcome in self.drives.values() for title, one in outcome.compared.items()}

    def figures(self) -> dict[str, Any]:
        """The results as numbers, ready for JSON."""
        return {
            "coverage": {title: one.figures() for title, one in self.compared().items()},
            "forces": {title: outcome.forces for title, outcome in self.drives.items()},
            "faults": fault_outcomes.as_json(self.faults),
            "navigation": self.navigation,
            "latency_ms": {title: outcome.lags_ms for title, outcome in self.drives.items() if outcome.lags_ms},
        }


def examine(
    store: Path,
    parts: Path,
    bags: Path,
    progress: Progress = lambda share: None,
    *,
    only: Sequence[str] = (),
    processes: int | None = None,
) -> Results:
    """Examine all drives, some faults and the GNSS/INS filters.

    Plants of GNSS/INS filters are kept in the folder `store`, what was done in `parts`, so that what was stopped goes
    on where it was; `bags` holds the generated recordings of the repository. Recordings that are not here are left out,
    and a part that fails is listed in `Results.failed`. `only` takes parts: texts of which a drive's title has one,
    "faults", "filters". Raises `InputError` where a text fits nothing.
    """
    tasks = {one.title: Task(12.0, _if_here, (one,)) for one in RECORDED}
    tasks |= {one.name: Task(2.0, on_bag, (bags / one.name,)) for one in IN_BAGS}
    tasks |= {name: Task(70.0, on_hills, (name,)) for name in road.PLANTS}
    _refuse_unknown(only, tasks)
    tasks = {title: task for title, task in tasks.items() if not only or any(text in title for text in only)}
    rows = fault_rows.some_rows(FAULT_ROWS) if not only or "faults" in only else []
    filters = not only or "filters" in only
    tasks |= {row.name: Task(4.0, fault_outcomes.if_here, (row,)) for row in rows}
    share_of_drives = 0.6 if filters else 1.0
    with pool(processes) as do_tasks:
        found = do_tasks(kept(tasks, parts), lambda share: progress(share_of_drives * share)) if tasks else []
    by_title = dict(zip(tasks, found, strict=True))
    failed = {title: one.error for title, one in by_title.items() if isinstance(one, Failed)}
    drives = {title: one for title, one in by_title.items() if isinstance(one, Outcome)}
    faults = [one for one in by_title.values() if isinstance(one, fault_outcomes.RowOutcome)]
    navigation: Mapping[str, Mapping[str, Mapping[str, float]]] = {}
    if filters:
        by_filter, of_filters = navigation_consistency.by_drive(
            store, parts, progress=lambda share: progress(share_of_drives + (1.0 - share_of_drives) * share),
            quick=True, processes=processes,
        )  # fmt: skip
        navigation, failed = navigation_consistency.summary(by_filter), failed | of_filters
    return Results(drives, faults, navigation, failed, [title for title, one in by_title.items() if one is None])


def _refuse_unknown(only: Sequence[str], titles: Iterable[str]) -> None:
    parts = [*titles, "faults", "filters"]
    for text in only:
        if not any(text in part for part in parts):
            raise InputError(f"no part has {text!r} in its title; parts are: {', '.join(parts)}")


def _if_here(drive: Drive) -> Outcome | None:
    try:
        return on_recording(drive)
    except InputError:
        return None


def on_recording(drive: Drive) -> Outcome:
    """Examine a recording of a real car. Raises `InputError` if it is not here."""
    recording, car = navigation_consistency.load(drive)
    transient = _transient(drive, recording)
    parts = {drive.title: road.SETTLED}
    if transient is not None and transient.over > road.SETTLED:
        parts[f"{drive.title}, after {transient.over:.0f} s"] = transient.over
    return _estimated(parts, recording, car)


def _transient(drive: Drive, recording: Recording) -> HeadingTransient | None:
    """The transient of the reference's heading on a lap of the Genesis, by a formula that is fitted to the others."""
    if drive.folder != GENESIS:
        return None
    others = [genesis.read(data_dir() / GENESIS / name) for name in LAPS if name != drive.file]
    return transient_of(recording, baselines.regression(recording, baselines.fit_regression(others)))


def on_bag(path: Path) -> Outcome:
    """Examine a generated recording of the repository, whose plant is another car than its observer knows."""
    return _estimated({path.name: road.SETTLED}, import_recording(path), load_vehicle(vehicle_path(OF_BAGS)))


def on_hills(name: str) -> Outcome:
    """Examine a drive of the full car on one of the surfaces of `road.PLANTS`, with an outage of GNSS."""
    car = load_vehicle(vehicle_path("prototype_real"))
    compared = road.on_plant(name, car, with_pedals_of(load_vehicle(vehicle_path(OF_BAGS)), car)).compared
    return Outcome({name: compared}, {"nrmsd_percent": _of_plant(compared)})


def with_pedals_of(known: Vehicle, car: Vehicle) -> Vehicle:
    """The car with what the vehicle file `known` says of what is driven and of torques that nothing measures: the file
    of the plant says neither, as if no wheel could be driven or braked by more than 30 rad/s²."""
    of_known = known.observer.force_errors
    settings = ("wheel_spin", "wheel_spin_time_constant")
    errors = car.observer.force_errors.model_copy(update={name: getattr(of_known, name) for name in settings})
    observer = car.observer.model_copy(update={"force_errors": errors})
    return car.model_copy(update={"drivetrain": known.drivetrain, "observer": observer})


def _estimated(parts: Mapping[str, float], recording: Recording, car: Vehicle) -> Outcome:
    """What came of a drive; `parts` of it begin at these times [s], and go on to its end."""
    output = run(recording, car).output
    there = at_reference(output, car)
    compared = {title: Compared.of(there, recording, (begin, np.inf)) for title, begin in parts.items()}
    forces: dict[str, Any] = {}
    sums = balance(output, car)
    if sums is not None:
        forces["balance_percent"] = dict(sums.percent)
    if of_plant := _of_plant(next(iter(compared.values()))):
        forces["nrmsd_percent"] = of_plant
    if free := _undriven(output, car):
        forces["undriven_longitudinal"] = free
    return Outcome(compared, forces, dict(_lags(recording)))


def _of_plant(compared: Compared) -> dict[str, float | None]:
    return {name: one.nrmsd_percent for name, one in compared.scores.items() if name.startswith("wheel_force_")}


def _undriven(output: Recording, car: Vehicle) -> dict[str, list[float]]:
    """Percentiles of the longitudinal force of wheels that are not driven, by wheel [N]; it is rolling resistance,
    unless the car brakes."""
    shares = car.drivetrain.driving_shares
    free = {}
    for i, wheel in enumerate(WHEELS):
        channel = find_channel(output, f"vsense/wheel_force/{wheel}")
        if shares is not None and shares[i] == 0 and channel is not None:
            force = channel.columns["force"][:, 0]
            if np.isfinite(force).any():
                free[wheel] = np.nanpercentile(force, PERCENTILES).tolist()
    return free


def _lags(recording: Recording) -> Iterator[tuple[str, float]]:
    """By how much what sensors measure is later than the reference [ms], where the drive shows it."""
    truths = read_signals(recording, "reference")
    readings: list[tuple[str, Series]] = [("imu/data", one) for one in baselines.gyro(recording)]
    velocity = find_channel(recording, "gps/velocity")
    if velocity is not None:
        speed = np.hypot(velocity.columns["linear"][:, :1], velocity.columns["linear"][:, 1:2])
        readings.append(("gps/velocity", make_series(SIGNALS["speed"], velocity, speed)))
    for topic, series in readings:
        truth = truths.get(series.signal.name)
        seconds = lag(series, truth) if truth is not None else None
        if seconds is not None:
            yield topic, 1e3 * seconds


def write(results: Results, path: Path, *, keep: bool = False) -> None:
    """Write the results as JSON; with `keep` what the file has of other parts stays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figures = results.figures()
    if keep and path.exists():
        before = json.loads(path.read_text(encoding="utf-8"))
        figures = {part: {**before.get(part, {}), **one} for part, one in figures.items()}
    with atomic_write(path) as file:
        json.dump(figures, file, indent=2)
        file.write("\n")


def show(results: Results, console: Console) -> None:
    """Print errors beside standard deviations of all drives, then forces, lags, faults and filters."""
    without_forces = {
        title: Compared({n: s for n, s in one.scores.items() if not n.startswith("wheel_force_")}, one.trivial)
        for title, one in results.compared().items()
    }
    console.print(coverage_table(without_forces))
    table = plain_table("drive", "forces and lags", "value", right=("value",))
    for title, outcome in results.drives.items():
        for what, value in _lines(outcome):
            table.add_row(title, what, value)
            title = ""
    console.print(table)
    if results.faults:
        console.print(fault_outcomes.table(results.faults))
    if results.left_out:
        console.print(
            f"Left out, as they are not here (VSENSE_DATA names their folder): {', '.join(results.left_out)}."
        )
    for title, error in results.failed.items():
        console.print(f"{title} failed: {error}")
    if results.navigation:
        table = plain_table("filter", "output", "within 3σ [%]", "NEES", right=("within 3σ [%]", "NEES"))
        for name, outputs in results.navigation.items():
            for output, one in outputs.items():
                table.add_row(name, output, f"{one['within_3s']:.1f}", f"{one['nees']:.2f}")
        console.print(table)


def _lines(outcome: Outcome) -> Iterator[tuple[str, str]]:
    """The figures of forces and lags of one drive, in words."""
    errors = outcome.forces.get("nrmsd_percent", {})
    for axis, label in (("x", "longitudinal"), ("y", "lateral"), ("z", "vertical")):
        of_axis = [value for name, value in errors.items() if name.endswith(f"_{axis}") and value is not None]
        if of_axis:
            yield f"{label} force of the worst wheel, NRMSD [%]", f"{max(of_axis):.1f}"
    for name, value in outcome.forces.get("balance_percent", {}).items():
        yield f"{name} against the inertial sensor [%]", f"{value:.1f}"
    for wheel, (low, high) in outcome.forces.get("undriven_longitudinal", {}).items():
        yield f"longitudinal force {wheel.upper()}, not driven, 5 to 95 % of the time [N]", f"{low:.0f} to {high:.0f}"
    for topic, milliseconds in outcome.lags_ms.items():
        yield f"{topic} later than the reference [ms]", f"{milliseconds:+.0f}"
