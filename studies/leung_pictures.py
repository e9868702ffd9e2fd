"""Pictures of what Leung 2010 draws of filters: chapters 4 and 5 and appendix E, on our plant and with our noise.

Figures over time are one table (`FIGURES`): a drive, filters, and the quantities of a panel each. Those that
`leung_figures` has in numbers are drawn there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from studies.leung import GENESIS_LAP, ON_THE_BUS, ROWS, SECTION_4_4, SHORT, angle_errors
from studies.leung_models_picture import COLOURS, labelled, page
from studies.leung_study import estimate
from vsense_ros.assess.drives import (
    STEERING_RATIO,
    Case,
    Errors,
    Readings,
    Truth,
    drive_plant,
    readings,
)
from vsense_ros.assess.filter_run import follow
from vsense_ros.bag.importers import genesis
from vsense_ros.evaluate.picture import BAND, TRUTH
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals, wrap
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.navigation.motion import Motions
from vsense_ros.navigation.space import MOTION
from vsense_ros.runner.run import run
from vsense_ros.runner.smoothing import run_smoothed

Array = NDArray[np.float64]
Progress = Callable[[float], None]

UNITS = {
    "yaw": ("heading error", "[°]"), "side_slip": ("side slip", "[°]"), "yaw_rate": ("yaw rate", "[°/s]"),
    "forward_velocity": ("forward velocity error", "[m/s]"), "lateral_velocity": ("lateral velocity", "[m/s]"),
    "gyro_bias": ("bias of the gyro", "[°/s]"), "acceleration_bias_x": ("bias of a_x", "[m/s²]"),
    "acceleration_bias_y": ("bias of a_y", "[m/s²]"), "rolling_radius": ("rolling radius", "[m]"),
    "steering_bias": ("bias at the steering wheel", "[°]"), "side_slip_error": ("side slip error", "[°]"),
    "yaw_rate_error": ("yaw rate error", "[°/s]"),
}  # fmt: skip
_ERRORS = frozenset({"yaw", "forward_velocity", "side_slip_error", "yaw_rate_error"})


@dataclass(frozen=True)
class TimeFigure:
    """One page: quantities of filters over time, on one drive."""

    file: str
    title: str
    row: str
    filters: tuple[str, ...]
    quantities: tuple[str, ...]
    errors: Errors = ON_THE_BUS


_DUAL = ("yaw", "gyro_bias", "forward_velocity", "lateral_velocity", "acceleration_bias_x", "acceleration_bias_y")
_MODELS = ("single_track", "mekf_2c", "triple_kkf_b", "integrated_kf_a", "integrated")
_BETWEEN = ("dual_kkf", "side_slip_kkf_1", "side_slip_kkf_2", "inertial")
_STEERING = ("mekf_2b", "mekf_2c", "integrated_kf_a", "integrated")
_OF_MODELS = ("side_slip", "yaw_rate", "yaw", "side_slip_error", "yaw_rate_error", "steering_bias")
FIGURES = (
    TimeFigure("figure_4_2_dual_kkf", "States of the dual KKF", "DO25", ("dual_kkf",), _DUAL),
    TimeFigure("figure_4_3_side_slip", "Side slip in steps of a fix", "DO25", ("dual_kkf", "inertial"), ("side_slip",)),
    TimeFigure("figure_4_4_dual_kkf", "States of the dual KKF", "LC25", ("dual_kkf",), _DUAL),
    TimeFigure("figure_4_5_side_slip", "Side slip in steps of a fix", "LC45", ("dual_kkf", "inertial"), ("side_slip",)),
    TimeFigure("figure_4_7_heading", "With a heading sensor of 0.1 rad and without", "DO25",
               ("dual_kkf", "dual_kkf_heading"), ("yaw", "side_slip"), replace(ON_THE_BUS, heading=0.1)),
    TimeFigure("figures_4_8_to_4_11_wheels", "Heading, speed and radius by wheel speeds", "DO25",
               ("wheel_speed_ekf_a", "wheel_speed_ekf_b1", "wheel_speed_ekf_b2", "wheel_speed_ekf_c"),
               ("yaw", "forward_velocity", "rolling_radius")),
    TimeFigure("figure_4_15_speed", "Speed by wheels where these slip", "DO55",
               ("wheel_speed_ekf_b2", "dual_kkf", "triple_kkf"), ("forward_velocity",)),
    TimeFigure("figures_4_27_to_4_29_extrapolation", "Side slip extrapolated between fixes", "8C",
               _BETWEEN, ("lateral_velocity", "yaw"), SECTION_4_4),
    TimeFigure("figure_4_32_slalom", "Lateral velocity in the slalom", "SD",
               _BETWEEN, ("lateral_velocity",), SECTION_4_4),
    *(TimeFigure(f"figures_5_12_to_5_17_steering_{row.lower()}", "Bias of the steering angle", row,
                 _STEERING, ("steering_bias",)) for row in ("DO35", "LC35")),
    *(TimeFigure(f"figures_5_18_to_5_21_and_e_{row.lower()}", "Filters by a model", row, _MODELS, _OF_MODELS)
      for row in ROWS),
)  # fmt: skip


def draw_all(
    folder: Path, store: Path, laps: Path | None = None, progress: Progress = lambda share: None
) -> list[Path]:
    """Every picture of this file, in a folder; what the plant did is kept in `store`. `laps` is the folder of the
    Genesis laps, None where they are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    jobs: list[Callable[[], list[Path]]] = [lambda f=figure: [over_time(f, folder, store)] for figure in FIGURES]  # type: ignore[misc]
    jobs += [lambda: by_speed(folder, store), lambda: on_hill(folder)]
    if laps is not None:
        jobs += [lambda rate=rate: [on_genesis(folder, laps, rate)] for rate in (10.0, 1.0)]  # type: ignore[misc]
    for i, job in enumerate(jobs):
        paths += job()
        progress((i + 1) / len(jobs))
    return paths


def over_time(figure: TimeFigure, folder: Path, store: Path) -> Path:
    """One figure of `FIGURES`."""
    manoeuvre = {**ROWS, **SHORT}[figure.row]
    case = Case(manoeuvre, 0, figure.errors)
    truth = drive_plant(manoeuvre, case.plant, store)
    read = readings(truth, case)
    followed = {name: follow(name, truth, case, read) for name in figure.filters}
    count = len(figure.quantities)
    columns = 1 if count == 1 else 2 if count <= 4 else 3
    rows = -(-count // columns)
    with page(f"{figure.title}, {figure.row}", (4.4 * columns + 1.5, 2.5 * rows + 0.8)) as (drawn, save):
        panels = drawn.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for panel, quantity in zip(panels, figure.quantities, strict=False):
            _panel(panel, quantity, truth, read, followed)
        for panel in panels[count:]:
            panel.set_axis_off()
        for panel in panels[max(0, count - columns) : count]:
            panel.set_xlabel("[s]")
        handles, labels = panels[0].get_legend_handles_labels()
        drawn.legend(handles, labels, loc="outside lower center", ncols=min(6, len(labels)), fontsize=8)
        return save(folder / f"{figure.file}.png")


def _panel(
    panel: Axes, quantity: str, truth: Truth, read: Readings, followed: dict[str, tuple[Motions, NDArray[np.int64]]]
) -> None:
    title, unit = UNITS[quantity]
    true, factor = _truth(quantity, truth)
    shown: list[Array] = []
    for (name, (motions, at)), colour in zip(followed.items(), COLOURS, strict=False):
        value = _value(quantity, motions, truth, at)
        if value is None:
            panel.plot([], [], color=colour, label=name)
            continue
        shown.append(factor * value[truth.t[at] > 5.0])
        panel.plot(truth.t[at], factor * value, color=colour, lw=0.9, label=name)
    if true is not None:
        panel.plot(truth.t, factor * true, color=TRUTH, lw=0.8, label="truth")
        shown.append(factor * true)
    if quantity == "side_slip":
        fixes = np.flatnonzero(np.isfinite(read.fixes[:, 0]))
        course = np.arctan2(read.fixes[fixes, 1], read.fixes[fixes, 0])
        raw = factor * wrap(course - truth.yaw[fixes])
        panel.plot(truth.t[fixes], raw, ".", color=BAND, ms=2.5, zorder=0, label="course of a fix less true heading")
    if shown:
        low, high = (float(np.percentile(np.concatenate(shown), q)) for q in (0.2, 99.8))
        margin = 0.15 * (high - low) + 1e-6
        panel.set_ylim(low - margin, high + margin)
    panel.set_title(title)
    panel.set_ylabel(unit)


def _truth(quantity: str, truth: Truth) -> tuple[Array | None, float]:
    """What a quantity truly was, None where its error is drawn or nobody knows it; and the factor to its unit."""
    degrees = float(np.degrees(1.0))
    if quantity == "steering_bias":
        return np.full(len(truth.t), Errors().steering.bias), degrees * STEERING_RATIO
    force = Errors().force.bias
    biases = {"gyro_bias": Errors().gyro.bias, "acceleration_bias_x": force, "acceleration_bias_y": force}
    if quantity in biases:
        return np.full(len(truth.t), biases[quantity]), degrees if quantity == "gyro_bias" else 1.0
    angles = {"yaw", "side_slip", "yaw_rate", "side_slip_error", "yaw_rate_error"}
    factor = degrees if quantity in angles else 1.0
    if quantity in _ERRORS or quantity == "rolling_radius":
        return None, factor
    return np.asarray(getattr(truth, quantity)), factor


def _value(quantity: str, motions: Motions, truth: Truth, at: NDArray[np.int64]) -> Array | None:
    """What a filter has of a quantity, or its error; None where it has none."""
    name = quantity.removesuffix("_error")
    values: Array
    if name == "side_slip":
        if not motions.has_side_slip:
            return None
        values = motions.side_slip[:, 0]
    elif name in motions.estimated:
        values = motions.value[:, MOTION.index(name)]
    else:
        places = [i for i, full in enumerate(motions.parameter_names) if full.rpartition(".")[2] == name]
        if not places:
            return None
        values = motions.parameters[:, places[-1]]
    if quantity not in _ERRORS:
        return values
    error = values - getattr(truth, name)[at]
    return wrap(error) if name in ("yaw", "side_slip") else error


def by_speed(folder: Path, store: Path) -> list[Path]:
    """Figures 4.12, 4.13 and 4.16: errors over the speeds of oval and lane change."""
    quantities = (("yaw", "heading", "[°]"), ("forward_velocity", "forward velocity", "[m/s]"),
                  ("lateral_velocity", "lateral velocity", "[m/s]"))  # fmt: skip
    filters = ("dual_kkf", "wheel_speed_ekf_b2", "triple_kkf", "inertial", "integrated")
    with page("Errors over the speed of the drive, RMS once settled", (11, 5.6)) as (figure, save):
        panels = figure.subplots(2, 3, sharex=True)
        for line, kind in zip(panels, ("DO", "LC"), strict=True):
            speeds = (15, 25, 35, 45, 55)
            scores = {
                (name, v): estimate(
                    name,
                    drive_plant(ROWS[f"{kind}{v}"], "jaguar_saloon", store),
                    Case(ROWS[f"{kind}{v}"], 0, ON_THE_BUS),
                )
                for name in filters
                for v in speeds
            }
            for panel, (key, title, unit) in zip(line, quantities, strict=True):
                factor = float(np.degrees(1.0)) if key == "yaw" else 1.0
                for name, colour in zip(filters, COLOURS, strict=True):
                    known = [v for v in speeds if key in scores[name, v]]
                    values = [factor * scores[name, v][key]["rmse"] for v in known]
                    panel.plot(known, values, "o-", color=colour, ms=3, label=name)
                labelled(panel, f"{title}, {'oval' if kind == 'DO' else 'lane change'}", "[km/h]", unit)
                panel.set_yscale("log")
        handles, labels = panels[0][1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
        return [save(folder / "figures_4_12_4_13_4_16_speeds.png")]


def on_hill(folder: Path) -> list[Path]:
    """Figures 4.42 to 4.46 on the track of table 4.12: pitch beside the grade, side slip with six axes and without."""
    car = load_vehicle(vehicle_path("jaguar_saloon"))
    trajectory = drive(MANOEUVRES["hill"], car)
    recording = record(trajectory, car, 1, name="hill")
    names = ("strapdown", "inertial", "integrated")
    outputs = {name: run(recording, car, name).output for name in names}
    with page("The hill of table 4.12", (11, 6.2)) as (figure, save):
        panels = figure.subplots(2, 2, sharex=True).ravel()
        for panel, (key, title, unit, factor) in zip(
            panels,
            (("pitch", "pitch on the map", "[°]", 57.29578), ("roll", "roll on the map", "[°]", 57.29578),
             ("lateral_velocity", "lateral velocity", "[m/s]", 1.0), ("side_slip", "side slip", "[°]", 57.29578)),
            strict=True,
        ):  # fmt: skip
            for name, colour in zip(names, COLOURS, strict=False):
                _signal(panel, outputs[name], "vsense", key, factor, color=colour, label=name)
            _signal(panel, recording, "reference", key, factor, color=TRUTH, lw=0.8, label="truth")
            labelled(panel, title, "[s]", unit)
        panels[0].legend(fontsize=7)
        return [save(folder / "figures_4_42_to_4_46_hill.png")]


_OF_THESIS, _OURS = ("dual_kkf", "side_slip_kkf_1", "side_slip_kkf_2"), ("inertial", "integrated")


def on_genesis(folder: Path, laps: Path, rate: float) -> Path:
    """In place of figures 4.33 to 4.38, whose recordings are not public: the third Genesis lap with `rate` fixes a
    second. Estimates as its reference system would see them, and what `inertial` says of its errors.
    """
    car = load_vehicle(vehicle_path("genesis"))
    lap = genesis.read(laps / GENESIS_LAP, gnss_rate_hz=rate)
    outputs = {name: at_reference(run(lap, car, name).output, car) for name in (*_OF_THESIS, *_OURS)}
    outputs["inertial, smoothed"] = at_reference(run_smoothed(lap, car, "inertial").output, car)
    colours = dict(zip(outputs, (*COLOURS, "#666666"), strict=False))
    with page(f"Third Genesis lap, {rate:g} Hz of GNSS velocity", (13, 7.4)) as (figure, save):
        (path, thesis, ours), (heading, slip, stated) = figure.subplots(2, 3)
        position = read_signals(lap, "reference")["position"].value
        path.plot(position[:, 0], position[:, 1], color=TRUTH, lw=1.0)
        path.plot(*position[0, :2], "o", color=TRUTH, ms=4)
        path.set_aspect("equal", adjustable="datalim")
        labelled(path, "the lap, from the dot", "east [m]", "north [m]")
        for panel, whose, shown in (
            (thesis, "filters of the thesis", _OF_THESIS),
            (ours, "ours", (*_OURS, "inertial, smoothed")),
        ):
            for name in shown:
                _signal(
                    panel, outputs[name], "vsense", "lateral_velocity", 1.0, color=colours[name], lw=0.9, label=name
                )
            _signal(panel, lap, "reference", "lateral_velocity", 1.0, color=TRUTH, lw=0.8, label="reference")
            labelled(panel, f"lateral velocity, {whose}", "[s]", "[m/s]")
        for panel, key, title, names in (
            (heading, "yaw", "heading error", ("dual_kkf", *_OURS)),
            (slip, "side_slip", "side slip error", ("dual_kkf", *_OURS, "inertial, smoothed")),
        ):
            for name in names:
                t, error, _ = angle_errors(outputs[name], lap, key)
                panel.plot(t, np.degrees(error), color=colours[name], lw=0.8, label=name)
            labelled(panel, title, "[s]", "[°]")
        t, error, deviation = angle_errors(outputs["inertial"], lap, "side_slip")
        error, deviation = np.degrees(error), np.degrees(deviation)
        stated.fill_between(t, -2 * deviation, 2 * deviation, color=BAND, lw=0, label="two standard deviations stated")
        stated.plot(t, error, color=colours["inertial"], lw=0.8, label="inertial")
        labelled(stated, "side slip error, and what is said of it", "[s]", "[°]")
        for panel in (heading, slip, stated):
            panel.set_ylim(-2.0, 2.0)
        for panel in (thesis, ours, heading, slip, stated):
            panel.legend(fontsize=7, loc="upper left" if panel is ours else "upper right")
        return save(folder / f"figures_4_33_to_4_38_genesis_{rate:g}_hz.png")


def _signal(panel: Axes, recording: Recording, source: str, key: str, factor: float, **style: object) -> None:
    signal = read_signals(recording, source).get(key)
    if signal is not None:
        panel.plot((signal.stamp - signal.stamp[0]) * 1e-9, factor * signal.value[:, 0], **style)  # type: ignore[arg-type]
