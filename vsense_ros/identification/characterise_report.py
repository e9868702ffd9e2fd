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


def table(found: Characteristics) -> Table:
    """One line for each quantity; what is not known says why."""
    result = plain_table(
        "quantity", "value", "± 1 σ", "unit", "vehicle file", "", right=("value", "± 1 σ", "vehicle file")
    )
    for one in found.quantities:
        result.add_row(
            one.name, _number(one.value), _number(one.deviation, 2), one.unit, _number(one.file), one.note or ""
        )
    return result


def show(found: Characteristics, console: Console) -> None:
    """Print the table."""
    console.width = max(console.width, _WIDTH)
    console.print(found.title, style="bold", markup=False)
    console.print(table(found))


def write(found: Characteristics, path: Path) -> None:
    """Quantities and frequency responses as JSON; SI units but where the unit says otherwise."""
    content: dict[str, Any] = {
        "title": found.title,
        "quantities": {
            one.name: {
                "value": one.value, "deviation": one.deviation, "unit": one.unit, "vehicle_file": one.file,
                "note": one.note,
            }
            for one in found.quantities
        },
        "frequency_responses": [
            {
                "speed": one.speed, "frequency_hz": one.frequency.tolist(), "gain": one.gain.tolist(),
                "phase": one.phase.tolist(), "coherence": one.coherence.tolist(),
            }
            for one in found.responses
        ],
    }  # fmt: skip
    with atomic_write(path) as file:
        json.dump(content, file, indent=1)


def draw(found: Characteristics, vehicle: Vehicle | None, path: Path) -> Path:
    """Lines through the points that they come from, frequency responses, and the model's Bode plot."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(13, 9.5), layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(drawn(found.title), x=0.01, ha="left", fontsize=12, fontweight="bold")
        panels = figure.subplots(3, 3)
        _understeer_and_roll(found, panels[0])
        _stiffness(found, panels[0][2], panels[1])
        _responses(found, vehicle, panels[1][2], panels[2][0])
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


def _points(panel: Axes, one: Scatter, colour: str, label: str) -> None:
    rows = np.random.default_rng(0).permutation(len(one.x))[:_POINTS]
    panel.plot(one.x[rows], one.y[rows], ".", ms=1.5, color=colour, alpha=0.35)
    ends = np.array([one.x.min(), one.x.max()]) if len(one.x) else np.zeros(2)
    slope = one.slope
    panel.plot(ends, slope * ends, color=colour, lw=1.6, label=label)


def _nothing(panel: Axes, title: str, why: str) -> None:
    panel.set_title(title)
    panel.text(0.5, 0.5, why, transform=panel.transAxes, ha="center", va="center", color=MUTED)
    panel.set_xticks([])
    panel.set_yticks([])


def _understeer_and_roll(found: Characteristics, panels: Any) -> None:
    for panel, key, title, label in (
        (panels[0], "understeer", "Steering beyond the geometric angle", "road wheels [°]"),
        (panels[1], "roll", "Roll", "[°]"),
    ):
        if key not in found.scatters:
            _nothing(panel, title, "not determined")
            continue
        _points(panel, found.scatters[key], ESTIMATE, "")
        panel.set_title(title)
        panel.set_xlabel("lateral acceleration [m/s²]")
        panel.set_ylabel(label)


def _stiffness(found: Characteristics, axle_panel: Axes, panels: Any) -> None:
    if "axle front" in found.scatters:
        axle_panel.set_title("Axle forces")
        for axle, colour in (("front", ESTIMATE), ("rear", _SECOND)):
            one = found.scatters[f"axle {axle}"]
            _points(axle_panel, Scatter(one.x, one.y, np.radians(one.slope) / 1e3), colour, axle)
        axle_panel.set_xlabel("minus slip angle [°]")
        axle_panel.set_ylabel("lateral force [kN]")
        axle_panel.legend()
    else:
        _nothing(axle_panel, "Axle forces", "not determined")
    for panel, what, x in (
        (panels[0], "slip stiffness", "longitudinal slip [-]"),
        (panels[1], "cornering stiffness", "minus slip angle [rad]"),
    ):
        title = f"Tyre forces: {what}"
        if f"{what} front" not in found.scatters:
            _nothing(panel, title, "forces are known of a simulation only")
            continue
        for axle, colour in (("front", ESTIMATE), ("rear", _SECOND)):
            _points(panel, found.scatters[f"{what} {axle}"], colour, axle)
        panel.set_title(title)
        panel.set_xlabel(x)
        panel.set_ylabel("force [N]")
        panel.legend()


def _responses(found: Characteristics, vehicle: Vehicle | None, gain: Axes, phase: Axes) -> None:
    """Measured points, and the linear single-track model of the file as lines."""
    if not found.responses:
        _nothing(gain, "Yaw rate over road-wheel angle", "not coherent")
        _nothing(phase, "Phase", "not coherent")
        return
    colours = (ESTIMATE, _SECOND, "#009E73", "#CC79A7", "#E69F00")
    for one, colour in zip(found.responses, colours, strict=False):
        label = f"{3.6 * one.speed:.0f} km/h"
        gain.plot(one.frequency, one.gain, "o", ms=3, color=colour, label=label)
        phase.plot(one.frequency, np.degrees(one.phase), "o", ms=3, color=colour, label=label)
        if vehicle is not None:
            model = Bicycle2Dof()
            frequency = np.geomspace(0.1, 5, 100)
            response = Response(model, model.numbers(vehicle)).frequency_response(
                one.speed, 2 * np.pi * frequency, "yaw_rate"
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
