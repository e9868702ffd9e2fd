"""Discrete and continuous filters where sensors are slow, of which Rodríguez 2020 warns ("CEKF: stability and accuracy
problems with low sampling rates").

A generated double lane change, recorded at several rates by an IMU, wheel speeds and a steering sensor that measure at
the same instants. The filters know the car as it is: what differs is how they treat the time between measurements.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.table import Table

from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.picture import STYLE
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.atomic import atomic_write
from vsense_ros.manoeuvre import drive
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.runner import run

MANOEUVRE = "double_lane_change"
PERIODS = (2, 4, 10, 20, 50, 100)  # [ms]
COMPARED = {"cekf": "#D55E00", "dekf": "#0072B2", "error_ekf": "#009E73"}  # filters and their colours
SIGNALS = {"yaw_rate": "yaw rate [°/s]", "side_slip": "side slip [°]"}
_SENSORS = ("imu", "wheel_speeds", "steering")  # kinds


@dataclass(frozen=True)
class Result:
    """RMSE [°/s, °] of each signal by one filter, with sensors of one period [ms]; NaN where the filter broke down."""

    filter: str
    period: int
    rmse: dict[str, float]


def measure(
    vehicle: Vehicle, progress: Callable[[float], None] = lambda share: None, periods: Sequence[int] = PERIODS
) -> list[Result]:
    """All filters at all `periods` [ms]. Raises `InputError` for a vehicle without one of the sensors."""
    kinds = {sensor.kind for sensor in vehicle.sensors.values()}
    if missing := [kind for kind in _SENSORS if kind not in kinds]:
        raise InputError(f"{vehicle.name}: the comparison of sampling rates needs a sensor of kind {missing[0]}")
    own = {name: sensor for name, sensor in vehicle.sensors.items() if sensor.kind in _SENSORS}
    car = vehicle.model_copy(update={"sensors": own})
    trajectory, results = drive(MANOEUVRE, car), []
    for i, period in enumerate(periods):
        recording = record(trajectory, car, seed=0, name=MANOEUVRE, biased=False, every=period)
        for j, name in enumerate(COMPARED):
            results.append(Result(name, period, _errors(recording, car, name)))
            progress((i * len(COMPARED) + j + 1) / (len(periods) * len(COMPARED)))
    return results


def _errors(recording: Recording, car: Vehicle, name: str) -> dict[str, float]:
    try:
        output = run(recording, car, make=FILTERS[name].make).output
    except InputError:  # it never goes on
        return dict.fromkeys(SIGNALS, float("nan"))
    estimates, truths = read_signals(output, "vsense"), read_signals(recording, "reference")
    errors = {}
    for signal in SIGNALS:
        error = align(estimates[signal], truths[signal]).error
        errors[signal] = float(np.degrees(np.sqrt(np.mean(error**2))))
    return errors


def table(results: list[Result]) -> Table:
    """For the terminal."""
    made = Table(title="RMSE by the rate of all sensors")
    made.add_column("rate", justify="right")
    for name in COMPARED:
        for words in SIGNALS.values():
            made.add_column(f"{FILTERS[name].title}\n{words}", justify="right")
    for period in PERIODS:
        rmse = {one.filter: one.rmse for one in results if one.period == period}
        cells = [f"{rmse[name][signal]:.3g}" for name in COMPARED for signal in SIGNALS]
        made.add_row(f"{1000 / period:g} Hz", *cells)
    return made


def draw(results: list[Result], path: Path) -> Path:
    """Write the picture; the format is that of the file's name."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        for axes, (signal, words) in zip(figure.subplots(1, 2), SIGNALS.items(), strict=True):
            for name, colour in COMPARED.items():
                mine = [one for one in results if one.filter == name]
                rates = [1000 / one.period for one in mine]
                axes.semilogx(rates, [one.rmse[signal] for one in mine], "o-", color=colour, label=FILTERS[name].title)
            axes.set_title(f"RMSE of the {words}", loc="left")
            axes.set_xlabel("rate of all sensors [Hz]")
            axes.set_xticks([1000 / period for period in PERIODS], [f"{1000 / period:g}" for period in PERIODS])
            axes.minorticks_off()
            axes.set_ylim(bottom=0.0)
        figure.axes[0].legend()
        figure.suptitle(
            "Double lane change: the continuous filter lets a measurement act until the next one comes",
            x=0.01,
            ha="left",
        )
        figure.savefig(path, dpi=110)
    return path


def write(results: list[Result], path: Path) -> None:
    """Write the results as JSON: {filter: {period in ms: {signal: RMSE}}}."""
    content: dict[str, dict[str, dict[str, float]]] = {}
    for one in results:
        content.setdefault(one.filter, {})[f"{one.period}ms"] = one.rmse
    with atomic_write(path) as file:
        file.write(json.dumps(content, indent=2) + "\n")
