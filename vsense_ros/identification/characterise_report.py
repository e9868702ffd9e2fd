"""What characterising a car came to: a table for a terminal, a file, and a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from vsense_ros.evaluate.handling_picture import bode
from vsense_ros.evaluate.picture import ESTIMATE, MUTED, STYLE, TRUTH
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.names import drawn
from vsense_ros.identification.characterise import Characteristics, Scatter
from vsense_ros.model.handling.bicycle_2dof import Bicycle2Dof
from vsense_ros.model.handling.response import Response
from vsense_ros.model.vehicle import Vehicle

_WIDTH = 130  # of the table
_POINTS = 4000  # of a scatter, beyond which a picture shows no more
_SECOND = "#D55E00"


def table(characteristics: Characteristics) -> Table:
    """One line for each quantity; what is not known says why."""
    result = plain_table(
        "quantity", "value", "± 1 σ", "unit", "vehicle file", "", right=("value", "± 1 σ", "vehicle file")
    )
    for quantity in characteristics.quantities:
        result.add_row(
            quantity.name,
            _number(quantity.value),
            _number(quantity.deviation, 2),
            quantity.unit,
            _number(quantity.file),
            quantity.note or "",
        )
    return result


def show(characteristics: Characteristics, console: Console) -> None:
    """Print the table of quantities."""
    console.width = max(console.width, _WIDTH)
    console.print(characteristics.title, style="bold", markup=False)
    console.print(table(characteristics))


def write(characteristics: Characteristics, path: Path) -> None:
    """Quantities and frequency responses as JSON; SI units but where the unit says otherwise."""
    document: dict[str, Any] = {
        "title": characteristics.title,
        "quantities": {
            quantity.name: {
                "value": quantity.value, "deviation": quantity.deviation, "unit": quantity.unit,
                "vehicle_file": quantity.file, "note": quantity.note,
            }
            for quantity in characteristics.quantities
        },
        "frequency_responses": [
            {
                "speed": response.speed, "frequency_hz": response.frequency.tolist(), "gain": response.gain.tolist(),
                "phase": response.phase.tolist(), "coherence": response.coherence.tolist(),
            }
            for response in characteristics.responses
        ],
    }  # fmt: skip
    with atomic_write(path) as file:
        json.dump(document, file, indent=1)


def draw(characteristics: Characteristics, vehicle: Vehicle | None, path: Path) -> Path:
    """Lines through the points that they come from, frequency responses, and the model's Bode plot."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(13, 9.5), layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(drawn(characteristics.title), x=0.01, ha="left", fontsize=12, fontweight="bold")
        panels = figure.subplots(3, 3)
        _understeer_and_roll(characteristics, panels[0])
        _stiffness(characteristics, panels[0][2], panels[1])
        _responses(characteristics, vehicle, panels[1][2], panels[2][0])
        if vehicle is None:
            for panel in panels[2][1:]:
                _nothing(panel, "Bode plot of the single-track model", "needs --vehicle")
        else:
            model = Bicycle2Dof()
            bode({"": Response(model, model.numbers(vehicle))}, panels[2][1], panels[2][2])
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    return path


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "–"
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1e4 else f"{value:.{digits}g}"


def _points(panel: Axes, scatter: Scatter, colour: str, label: str) -> None:
    rows = np.random.default_rng(0).permutation(len(scatter.x))[:_POINTS]
    panel.plot(scatter.x[rows], scatter.y[rows], ".", ms=1.5, color=colour, alpha=0.35)
    ends = np.array([scatter.x.min(), scatter.x.max()]) if len(scatter.x) else np.zeros(2)
    slope = scatter.slope
    panel.plot(ends, slope * ends, color=colour, lw=1.6, label=label)


def _nothing(panel: Axes, title: str, why: str) -> None:
    panel.set_title(title)
    panel.text(0.5, 0.5, why, transform=panel.transAxes, ha="center", va="center", color=MUTED)
    panel.set_xticks([])
    panel.set_yticks([])


def _understeer_and_roll(characteristics: Characteristics, panels: Any) -> None:
    for panel, key, title, label in (
        (panels[0], "understeer", "Steering beyond the geometric angle", "road wheels [°]"),
        (panels[1], "roll", "Roll", "[°]"),
    ):
        if key not in characteristics.scatters:
            _nothing(panel, title, "not determined")
            continue
        _points(panel, characteristics.scatters[key], ESTIMATE, "")
        panel.set_title(title)
        panel.set_xlabel("lateral acceleration [m/s²]")
        panel.set_ylabel(label)


def _stiffness(characteristics: Characteristics, axle_panel: Axes, panels: Any) -> None:
    if "axle front" in characteristics.scatters:
        axle_panel.set_title("Axle forces")
        for axle, colour in (("front", ESTIMATE), ("rear", _SECOND)):
            scatter = characteristics.scatters[f"axle {axle}"]
            _points(axle_panel, Scatter(scatter.x, scatter.y, np.radians(scatter.slope) / 1e3), colour, axle)
        axle_panel.set_xlabel("minus slip angle [°]")
        axle_panel.set_ylabel("lateral force [kN]")
        axle_panel.legend()
    else:
        _nothing(axle_panel, "Axle forces", "not determined")
    for panel, stiffness_name, x in (
        (panels[0], "slip stiffness", "longitudinal slip [-]"),
        (panels[1], "cornering stiffness", "minus slip angle [rad]"),
    ):
        title = f"Tyre forces: {stiffness_name}"
        if f"{stiffness_name} front" not in characteristics.scatters:
            _nothing(panel, title, "forces are known of a simulation only")
            continue
        for axle, colour in (("front", ESTIMATE), ("rear", _SECOND)):
            _points(panel, characteristics.scatters[f"{stiffness_name} {axle}"], colour, axle)
        panel.set_title(title)
        panel.set_xlabel(x)
        panel.set_ylabel("force [N]")
        panel.legend()


def _responses(characteristics: Characteristics, vehicle: Vehicle | None, gain: Axes, phase: Axes) -> None:
    """Measured points, and the linear single-track model of the file as lines."""
    if not characteristics.responses:
        _nothing(gain, "Yaw rate over road-wheel angle", "not coherent")
        _nothing(phase, "Phase", "not coherent")
        return
    colours = (ESTIMATE, _SECOND, "#009E73", "#CC79A7", "#E69F00")
    for measured, colour in zip(characteristics.responses, colours, strict=False):
        label = f"{3.6 * measured.speed:.0f} km/h"
        gain.plot(measured.frequency, measured.gain, "o", ms=3, color=colour, label=label)
        phase.plot(measured.frequency, np.degrees(measured.phase), "o", ms=3, color=colour, label=label)
        if vehicle is not None:
            model = Bicycle2Dof()
            frequency = np.geomspace(0.1, 5, 100)
            response = Response(model, model.numbers(vehicle)).frequency_response(
                measured.speed, 2 * np.pi * frequency, "yaw_rate"
            )
            gain.plot(frequency, np.abs(response), color=colour, lw=0.9)
            phase.plot(frequency, np.degrees(np.unwrap(np.angle(response))), color=colour, lw=0.9)
    gain.set_title("Yaw rate over road-wheel angle")
    gain.set_ylabel("[1/s]")
    gain.set_ylim(bottom=0)
    phase.set_title("Its phase")
    phase.set_ylabel("[°]")
    for panel in (gain, phase):
        panel.set_xlabel("frequency [Hz]")
        panel.set_xscale("log")
        panel.axhline(0, color=TRUTH, lw=0.3)
        panel.legend(title="lines: linear model" if vehicle is not None else None, title_fontsize=8)
