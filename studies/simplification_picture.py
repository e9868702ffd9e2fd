"""One picture of a manoeuvre with the full and the simplified cars: their motion, and how they differ."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from studies.simplification import FULL, GUIDES, SIGNALS, SIMPLIFIED, TABLES, Comparison, Signal
from vsense_ros.evaluate.picture import MUTED, STYLE, TRUTH
from vsense_ros.model.effects.base import CORNERS

COLOURS = {FULL: TRUTH, TABLES: "#D55E00", GUIDES: "#56B4E9"}
SHOWN = {  # signal → wheel, for those that every wheel has
    "lateral acceleration": None,
    "yaw rate": None,
    "roll": None,
    "camber of the wheels to the road": 0,
    "lateral tyre force": 0,
    "vertical tyre force": 0,
}


def draw(comparison: Comparison, path: Path) -> Path:
    """Write the picture; the format is that of the file's name."""
    signals = {signal.name: signal for signal in SIGNALS}
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(14, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(2, len(SHOWN), sharex=True, height_ratios=(1.3, 1.0))
        figure.suptitle(comparison.manoeuvre.title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for (above, below), (name, wheel) in zip(panels.T, SHOWN.items(), strict=True):
            _panel(above, below, comparison, signals[name], wheel)
        lines = {line.get_label(): line for line in panels[0, 0].get_lines()}
        figure.legend([lines[car] for car in COLOURS], list(COLOURS), loc="upper right", ncols=3)
        figure.savefig(path, dpi=75)
    return path


def _panel(above: Axes, below: Axes, comparison: Comparison, signal: Signal, wheel: int | None) -> None:
    time = comparison.motions[FULL].t
    for car in (GUIDES, FULL, TABLES):
        values = signal.of(comparison.motions[car])
        style = (0, (3, 3)) if car == TABLES else "-"
        above.plot(time, values if wheel is None else values[:, wheel], color=COLOURS[car], linestyle=style, label=car)
    for car in reversed(SIMPLIFIED):
        error = comparison.error(signal, car)
        below.plot(time, error if wheel is None else error[:, wheel], color=COLOURS[car])
    below.axhline(0, color=MUTED, linewidth=0.6, zorder=0)
    name = signal.name.removesuffix(" of the wheels to the road")
    name = name[:1].upper() + name[1:]
    above.set_title(f"{name} [{signal.unit}]" + ("" if wheel is None else f"\n{tuple(CORNERS.values())[wheel]}"))
    below.set_title("minus full car")
    below.set_xlabel("s")
