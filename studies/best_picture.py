"""Figures 1 to 6 of Best & Bogdanski (2016), of the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from studies.best import FREE, Identified, Repeated
from studies.best import TRUTH as VALUES
from studies.best_twin import STEP
from vsense_ros.evaluate.picture import ESTIMATE, MUTED, STYLE, TRUTH
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import PAPER, REACH, SYMBOLS, Best4Dof

OTHER = "#D55E00"  # of the unscented filter
SHOWN = {
    "longitudinal_acceleration": "longitudinal acceleration [m/s²]",
    "lateral_acceleration": "lateral acceleration [m/s²]",
    "roll_rate": "roll rate [rad/s]", "speed": "speed [m/s]", "roll": "roll [rad]", "yaw_rate": "yaw rate [rad/s]",
    "lateral_velocity": "lateral velocity [m/s]",
}  # fmt: skip
FITTED = Best4Dof.outputs
UNFITTED = ("speed", "roll", "yaw_rate", "lateral_velocity")


def draw(result: Repeated, folder: Path) -> list[Path]:
    """Write figure_1.png to figure_6.png."""
    folder.mkdir(parents=True, exist_ok=True)
    both = (*FITTED, *UNFITTED)
    drawn = {
        "figure_1": lambda figure: _convergence(result, figure),
        "figure_2": lambda figure: _signals(result, "identification", FITTED, figure, "Fitted outputs, model alone"),
        "figure_3": lambda figure: _signals(result, "identification", UNFITTED, figure, "Not fitted, model alone"),
        "figure_4": lambda figure: _signals(result, "step steer, then braking", both, figure),
        "figure_5": lambda figure: _signals(
            result, "straight, accelerating and braking", ("longitudinal_acceleration", "speed"), figure
        ),
        "figure_6": lambda figure: _signals(result, "constant speed, random steering", both, figure),
    }
    paths = []
    with matplotlib.rc_context(dict(STYLE)):
        for name, job in drawn.items():
            figure = Figure(layout="constrained")
            FigureCanvasAgg(figure)
            job(figure)
            figure.savefig(folder / f"{name}.png", dpi=110)
            paths.append(folder / f"{name}.png")
    return paths


def _convergence(result: Repeated, figure: Figure) -> None:
    figure.set_size_inches(14, 11)
    figure.suptitle("Convergence: parameters over their true values, by pass; force curves at the start and the end")
    grid = figure.add_gridspec(5, 4)
    first: dict[str, Identified] = {name: drives[0] for name, drives in result.identified.items()}
    colours = {"iekf": ESTIMATE, "iukf": OTHER}
    for i, name in enumerate(FREE):
        axes = figure.add_subplot(grid[i // 4, i % 4])
        axes.set_title(SYMBOLS[name][0])
        axes.axhline(1.0, color=TRUTH, linewidth=0.8)
        for kind, one in first.items():
            way = np.array([one.start[i], *(made.values[i] for made in one.rinsed.passes)]) / VALUES[i]
            axes.plot(range(len(way)), way, "o-", markersize=3, color=colours[kind], label=kind.upper())
        axes.set_ylim(0.6, 1.4)
    axes = figure.add_subplot(grid[3, 2])
    axes.set_title("trace of the covariance, scaled, over time")
    for kind, one in first.items():
        trace = np.concatenate([made.trace for made in one.rinsed.passes])
        axes.semilogy(np.arange(len(trace)) / 10, trace, color=colours[kind])
    axes.set_xlabel("time of all passes [s]")
    axes = figure.add_subplot(grid[3, 3])
    axes.set_title("the paper's settings: C and E creep")
    for i, name in enumerate(FREE):
        way = [made.values[i] / VALUES[i] for made in result.literal["iekf"].passes]
        creeping = SYMBOLS[name][0][0] in "CE" and SYMBOLS[name][0][:2] != "Ca"
        axes.plot(range(1, len(way) + 1), way, color=OTHER if creeping else MUTED, linewidth=0.8)
    axes.set_xlabel("pass")
    truth = best_4dof.curves(PAPER) / 1e3
    for i, name in enumerate(REACH):
        axes = figure.add_subplot(grid[4, i])
        axes.set_title(f"{name} force of a tyre [kN]")
        slips = best_4dof.curve_slips(name)
        start = best_4dof.curves(PAPER | dict(zip(FREE, first["iekf"].start.tolist(), strict=True))) / 1e3
        axes.plot(slips, start[i], color=MUTED, linestyle=":", label="start")
        axes.plot(slips, truth[i], color=TRUTH, label="truth")
        for kind, one in first.items():
            curves = best_4dof.curves(PAPER | dict(zip(FREE, one.rinsed.values.tolist(), strict=True))) / 1e3
            axes.plot(slips, curves[i], color=colours[kind], linestyle="--", label=kind.upper())
        axes.set_xlabel("slip [-]" if "long" in name else "tangent of the slip angle [-]")
        if i == 0:
            axes.legend()


def _signals(
    result: Repeated, manoeuvre: str, names: tuple[str, ...], figure: Figure, title: str = "Not fitted to, model alone"
) -> None:
    twin, outputs, states = result.validation[manoeuvre]
    figure.set_size_inches(12, 1.2 + 1.9 * len(names))
    figure.suptitle(f"{title}: {manoeuvre}")
    panels: Any = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    time = np.arange(len(states)) * STEP
    for axes, name in zip(panels, names, strict=True):
        if name in Best4Dof.outputs:
            at = Best4Dof.outputs.index(name)
            pair = twin.clean[:, at], outputs[:, at]
        else:
            at = Best4Dof.states.index(name)
            pair = twin.states[:, at], states[:, at]
        axes.plot(time, pair[0], color=TRUTH, linewidth=0.9, label="plant")
        axes.plot(time, pair[1], color=ESTIMATE, linewidth=0.9, linestyle="--", label="identified model")
        axes.set_title(SHOWN[name])
    panels[0].legend(loc="upper right", ncols=2)
    panels[-1].set_xlabel("time [s]")
