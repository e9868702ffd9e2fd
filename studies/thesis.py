"""The tables of Rodríguez 2020 again: slides "Estimations (SPI + simplified vehicle MB model): RMSE", "Implementation".

The car that drives is the full one with all its bodies and linkages; what observes it is the simplified model or the
full one, with 700 kg where the car has 600, and a friction of 1.0 where the road has 0.8 or 0.6. As in the slides the
observer gets throttle and steering as the car does, starts where the car does, on a level road, and has sensors without
biases.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.assess.iterations import on_level_road, with_thesis_sensors
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.sensing import SENSING, record
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.messages.recording import Recording
from vsense_ros.model.schema.observer_settings import EstimatedParameter, ForceErrors
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.simulation.closed_loop import Trajectory
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS, MakeFilter
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.state import Prior
from vsense_ros.runner import Runner
from vsense_ros.runner.run import as_recording

Array = NDArray[np.float64]

SEEDS = tuple(range(3))
STEPS = (4, 8)  # [ms]
PARAMETERS = {
    "chassis.mass": EstimatedParameter(deviation=100.0),
    "road.friction": EstimatedParameter(deviation=0.3, lower=0.1, upper=1.5),
}
# About what the simplified model on straight guides lacks against the full car once mass and friction are right: the
# accelerations that it does not explain in the manoeuvres of bags/, of which the two here are none. On tables of its
# suspensions it lacks less; a real car would lack more.
LEFT = ForceErrors(
    longitudinal=0.02, lateral=0.05, vertical=0.1, roll=0.2, pitch=0.05, yaw=0.05, suspension=1.0, time_constant=0.5
)
_WIDTH = 128  # of the tables


@dataclass(frozen=True)
class Kind:
    """One observer of the comparison."""

    name: str
    filter: str  # of `observer.catalogue`
    parameter_filter: str | None = None  # None: it estimates no parameters
    reference: bool = False  # here for comparison alone: the first step only, and not in the file
    full: bool = False  # its model is the full car

    @property
    def once(self) -> bool:
        """True if it is slow, and so is run with one seed."""
        return self.reference or self.full


KINDS = (
    Kind("errorEKF", "error_ekf"),
    Kind("SPI_UKF", "spi", "ukf"),
    Kind("SPI_EKF", "spi", "ekf"),
    Kind("DEKF", "dekf", reference=True),
    Kind("UKF", "ukf", reference=True),
    Kind("full_errorEKF", "full_error_ekf", full=True),
    Kind("full_SPI_UKF", "full_spi", "ukf", full=True),
    Kind("full_SPI_EKF", "full_spi", "ekf", full=True),
)
_FULL = {kind.name for kind in KINDS if kind.full}


@dataclass(frozen=True)
class Row:
    """A line of his table: a signal, and the RMSE he prints, errorEKF and SPI in both manoeuvres."""

    signal: str
    label: str
    error_ekf: tuple[float, float]
    spi: tuple[float, float]


ROWS = (
    Row("position", "position [m]", (0.1988, 0.4023), (0.2196, 0.4793)),
    Row("longitudinal_acceleration", "acceleration X [m/s²]", (0.1319, 0.3018), (0.0343, 0.0634)),
    Row("lateral_acceleration", "acceleration Y [m/s²]", (0.7923, 1.5429), (0.1551, 0.2750)),
    Row("vertical_acceleration", "acceleration Z [m/s²]", (0.3496, 0.3662), (0.1022, 0.1121)),
    Row("wheel_force_rr_x", "RR tyre force X [N]", (76.09, 165.32), (28.27, 28.41)),
    Row("wheel_force_rr_y", "RR tyre force Y [N]", (237.69, 265.58), (57.77, 41.27)),
    Row("wheel_force_rr_z", "RR tyre force Z [N]", (144.25, 180.09), (79.48, 75.30)),
)
FORCES = tuple(row for row in ROWS if row.signal.startswith("wheel_force"))
# Of the largest force, in manoeuvre 2: longitudinal, lateral, vertical.
HIS_PERCENT = {("errorEKF", 4): (41, 50, 18), ("SPI", 4): (7, 9, 8), ("SPI", 8): (14, 12, 13)}
# Computing time of 10 s and iterations in a step on his ARM Cortex-A9 (667 MHz), tolerance 1e-5.
HIS_TIME = {("errorEKF", 4): (7.673, 1.554), ("SPI", 4): (21.114, 1.512), ("SPI", 8): (13.3456, 3.055)}


@dataclass(frozen=True)
class Result:
    """What one observer reached in one manoeuvre with one step, over all seeds."""

    rmse: dict[str, float]  # of each signal [its unit]
    percent: dict[str, float]  # of each force, of its largest magnitude in truth
    parameters: dict[str, tuple[float, float]]  # at the end: value and standard deviation, of the first seed
    step_us: float  # median computing time of all that happens in a step [µs]
    iterations: float | None  # of the model in 1 ms, None: its steps have none


Results = dict[tuple[str, str, int], Result]  # manoeuvre, observer, step [ms]


def driven(plant: Vehicle, manoeuvre: Manoeuvre) -> tuple[Vehicle, Trajectory]:
    """The full car in a manoeuvre, and that car: on the manoeuvre's road, with sensors as in the slides."""
    assert manoeuvre.friction is not None
    car = with_thesis_sensors(plant.with_parameters({"road.friction": manoeuvre.friction}))
    return car, simulate_full_car(car, manoeuvre.driver(car), manoeuvre.duration, step=1e-3)


def observing(model: Vehicle, kind: Kind, step: int) -> Vehicle:
    """Model as an observer of the comparison takes it, for steps of `step` [ms]."""
    if kind.parameter_filter is None:
        return on_level_road(model, step)
    return on_level_road(model, step, parameters=PARAMETERS, parameter_filter=kind.parameter_filter, force_errors=LEFT)


def observe(
    recording: Recording, vehicle: Vehicle, kind: Kind, step: int, make: MakeFilter | None = None
) -> tuple[Runner, Recording, Array]:
    """An observer on a recording: itself at the end, its estimates every 10 ms, and computing times of the steps [µs].
    `make` builds another filter than that of its kind.

    Waiting for a busy processor does not count.
    """
    observer = Runner(vehicle, recording.map_origin, make or partial(_placed, kind.filter))
    topics = tuple(t for t in observer.topics if t in recording)
    estimates, last = [], 0
    spent: dict[int, float] = {}
    for sample in recording.samples(topics):
        began = time.thread_time()
        observer.add(sample)
        at = (sample.stamp - SENSING.epoch) // (step * 1_000_000)
        spent[at] = spent.get(at, 0.0) + time.thread_time() - began
        if observer.started and observer.stamp >= last + 9_990_000:
            estimates.append(observer.snapshot())
            last = observer.stamp
    output = as_recording(observer.adapter, estimates, recording)
    return observer, output, 1e6 * np.array(list(spent.values()))


def _placed(name: str, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> CarFilter:
    """A filter that knows where it starts, as in the slides."""
    return FILTERS[name].make(vehicle, sensors, Prior.of(vehicle, sensors).placed())


def repeat(
    plant: Vehicle,
    model: Vehicle,
    seeds: tuple[int, ...] = SEEDS,
    kinds: tuple[Kind, ...] = KINDS,
    steps: tuple[int, ...] = STEPS,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Results of all observers in both manoeuvres with the noise of every seed, from rest to the end of the drive."""
    results: Results = {}
    runs = {(kind, step): seeds[:1] if kind.once else seeds for step in steps for kind in kinds}
    runs = {(kind, step): chosen for (kind, step), chosen in runs.items() if step == steps[0] or not kind.reference}
    total, done = len(MANOEUVRES) * sum(map(len, runs.values())), 0
    for manoeuvre in MANOEUVRES:
        car, trajectory = driven(plant, manoeuvre)
        for step in steps:
            recordings = [
                record(trajectory, car, seed, name=manoeuvre.name, biased=False, every=step) for seed in seeds
            ]
            for kind in (kind for kind, of in runs if of == step):
                estimated = []
                for recording in recordings[: len(runs[kind, step])]:
                    estimated.append(_estimate(recording, observing(model, kind, step), kind, step))
                    done += 1
                    if progress is not None:
                        progress(done / total)
                results[manoeuvre.name, kind.name, step] = _over_all_seeds(estimated, model)
    return results


class _Estimated(NamedTuple):
    """One run of an observer: of each row's signal the mean square error and the largest magnitude in truth, parameters
    at the end, computing times of the steps [µs], and iterations of the model in 1 ms, None if its steps have none."""

    mean_squares: dict[str, float]
    largest: dict[str, float]
    parameters: dict[str, tuple[float, float]]
    spent: Array
    iterations: float | None


def _estimate(recording: Recording, vehicle: Vehicle, kind: Kind, step: int) -> _Estimated:
    """Run an observer on a recording and compare it with the truth."""
    observer, output, spent = observe(recording, vehicle, kind, step)
    parameters = observer.parameters()
    car = getattr(observer.filter, "car", None)
    iterations = car.plant.integrator.iterations if isinstance(car, FullCarBlocks) else None
    estimates, truths = read_signals(output, "vsense"), read_signals(recording, "reference")
    pairs = {row.signal: align(estimates[row.signal], truths[row.signal]) for row in ROWS}
    return _Estimated(
        {signal: float(np.mean(np.sum(pair.error**2, axis=1))) for signal, pair in pairs.items()},
        {signal: float(np.abs(pair.truth).max()) for signal, pair in pairs.items()},
        parameters,
        spent,
        iterations,
    )


def _over_all_seeds(estimated: Sequence[_Estimated], model: Vehicle) -> Result:
    """Result of one observer in one manoeuvre; parameters are those of the first seed, or of the model."""
    rmse = {row.signal: float(np.sqrt(np.mean([one.mean_squares[row.signal] for one in estimated]))) for row in ROWS}
    last = estimated[-1]
    parameters = {name: (value, 0.0) for name, value in model.values().items() if name in PARAMETERS}
    parameters |= {name: value for name, value in estimated[0].parameters.items() if name in PARAMETERS}
    return Result(
        rmse,
        {row.signal: 100 * rmse[row.signal] / last.largest[row.signal] for row in FORCES},
        {name: parameters[name] for name in PARAMETERS},
        float(np.median(np.concatenate([one.spent for one in estimated]))),
        last.iterations,
    )


def show(results: Results, console: Console) -> None:
    """His figures and ours side by side, as wide as they are."""
    console.width = max(console.width, _WIDTH)
    for i, manoeuvre in enumerate(MANOEUVRES):
        console.print(Text(f"Manoeuvre {i + 1}: {manoeuvre.title}", style="bold"))
        for full in (False, True):
            columns = [column for column in _columns(results) if (column[0] in _FULL) == full]
            if columns:
                console.print(_errors(results, i, manoeuvre.name, columns))
    console.print(Text("Rear right tyre forces in percent of their largest magnitude, manoeuvre 2", style="bold"))
    console.print(_percentages(results, MANOEUVRES[1].name))
    words = "Mass [kg] and friction at the end of manoeuvres 1 and 2 (true: 600; 0.8, 0.6), cost of a step"
    console.print(Text(words, style="bold"))
    console.print(_costs(results))
    console.print(
        "Thesis: his simplified model at 4 ms on his own car, in percent of forces that the slides do not name.\n"
        "His times: ARM Cortex-A9 at 667 MHz, Newton iterations of the trapezoidal rule. Ours: this machine, one "
        "thread, reading of the messages included; a step is linearly implicit and has no iterations.\n"
        "full: with all bodies and linkages as the model, in steps of 1 ms with as many iterations each."
    )


def _columns(results: Results) -> list[tuple[str, int]]:
    """Observers and steps that there are results of, in order."""
    return list(dict.fromkeys((kind, step) for _, kind, step in results))


def _table(first: str, *others: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1))
    table.add_column(first, no_wrap=True)
    for heading in others:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _errors(results: Results, number: int, manoeuvre: str, columns: list[tuple[str, int]]) -> Table:
    table = _table("RMSE", "thesis\nerrorEKF", "thesis\nSPI", *(f"{k}\n{s} ms" for k, s in columns))
    for row in ROWS:
        ours = (results[manoeuvre, *column].rmse[row.signal] for column in columns)
        his = (row.error_ekf[number], row.spi[number])
        table.add_row(Text(row.label), *(f"{value:.3g}" for value in (*his, *ours)))
    return table


def _percentages(results: Results, manoeuvre: str) -> Table:
    table = _table("", "step", "longitudinal", "lateral", "vertical")
    for (name, step), figures in HIS_PERCENT.items():
        table.add_row(f"thesis {name}", f"{step} ms", *(f"{figure} %" for figure in figures))
    for kind, step in _columns(results):
        percent = results[manoeuvre, kind, step].percent
        table.add_row(kind, f"{step} ms", *(f"{percent[row.signal]:.1f} %" for row in FORCES))
    return table


def _costs(results: Results) -> Table:
    table = _table("", "step", "mass 1", "friction 1", "mass 2", "friction 2", "iterations", "time")
    for (name, step), (seconds, iterations) in HIS_TIME.items():
        cells = ["–"] * 4 + [f"{iterations:.2f}", f"{1e6 * seconds / (1e4 / step):.0f} µs"]
        table.add_row(f"thesis {name}", f"{step} ms", *cells)
    for kind, step in _columns(results):
        both = [results[manoeuvre.name, kind, step] for manoeuvre in MANOEUVRES]
        cells = []
        for result in both:
            for (value, deviation), digits in zip(result.parameters.values(), (1, 3), strict=True):
                cells.append(f"{value:.{digits}f}" + (f" ± {deviation:.{digits}f}" if deviation else ""))
        iterated = "none" if both[0].iterations is None else f"{both[0].iterations:.2f}"
        table.add_row(kind, f"{step} ms", *cells, iterated, f"{both[0].step_us:.0f} µs")
    return table


def write(results: Results, path: Path) -> None:
    """Write the results as JSON: {manoeuvre: {observer: {step: {fx_percent, fy_percent, fz_percent, position_rmse_m,
    mass_kg, friction, step_us_median}}}}."""
    content: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for i, manoeuvre in enumerate(MANOEUVRES):
        for kind, step in _columns(results):
            if any(kind == k.name and k.reference for k in KINDS):
                continue
            result = results[manoeuvre.name, kind, step]
            (mass, _), (friction, _) = result.parameters.values()
            forces = dict(zip(("fx_percent", "fy_percent", "fz_percent"), _percent(result), strict=True))
            content.setdefault(f"manoeuvre_{i + 1}", {}).setdefault(kind, {})[f"{step}ms"] = forces | {
                "position_rmse_m": result.rmse["position"],
                "mass_kg": mass,
                "friction": friction,
                "step_us_median": result.step_us,
            }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _percent(result: Result) -> Iterator[float]:
    return (result.percent[row.signal] for row in FORCES)
