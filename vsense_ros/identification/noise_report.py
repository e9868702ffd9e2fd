"""What tuning came to: tables for a terminal, and a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.evaluate.consistency import Consistency
from vsense_ros.evaluate.picture import ESTIMATE, MUTED, STYLE
from vsense_ros.evaluate.signals import SIGNALS
from vsense_ros.files.names import drawn
from vsense_ros.identification.noise import Figures, Tuning

_WIDTH = 120  # of the tables
_BEFORE, _AFTER, _EXPECTED = "#E69F00", ESTIMATE, "#cfcfcf"


def show(tuning: Tuning, console: Console) -> None:
    """The numbers, and the filter's consistency before and after."""
    console.width = max(console.width, _WIDTH)
    table = _table("standard deviation", "before", "after", "")
    for number in tuning.numbers:
        verdict = f"± {100 * number.deviation:.0f} %" if number.determined else "not determined"
        verdict = "at its bound" if number.at_bound else verdict
        table.add_row(number.path, f"{number.before:.3g}", f"{number.after:.3g}", verdict)
    console.print(table)
    for title, before, after in _pairs(tuning):
        console.print(Text(f"\n{title}", style="bold"))
        console.print(_sensors(before, after))
        if before.errors:
            console.print()
            console.print(_errors(before, after))


def _pairs(tuning: Tuning) -> list[tuple[str, Figures, Figures]]:
    pairs = [("Recordings that were tuned on", tuning.before, tuning.after)]
    if tuning.held_out is not None:
        pairs.append(("Held out", *tuning.held_out))
    return pairs


def _table(first: str, *headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    table.add_column(first, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _sensors(before: Figures, after: Figures) -> Table:
    table = _table(
        "before → after", "messages", "refused", "log-likelihood\nper message", "NIS\nper component", "95 %",
        "lag-1\ncorrelation", "95 %",
    )  # fmt: skip
    for name in after.sensors:
        pair = [figures.sensors[name] for figures in (before, after)]
        low, high = pair[1].nis_interval
        table.add_row(
            Text(name),
            str(pair[1].messages),
            _change(pair, "refused", "d"),
            _change(pair, "log_likelihood", ".3f"),
            _change(pair, "nis", ".2f"),
            f"{low:.2f} … {high:.2f}",
            _change(pair, "lag_1", "+.2f"),
            f"±{pair[1].lag_1_bound:.2f}",
        )
    return table


def _change(pair: list[Consistency], field: str, form: str) -> str:
    return " → ".join(format(getattr(consistency, field), form) for consistency in pair)


def _errors(before: Figures, after: Figures) -> Table:
    table = _table("before → after", "RMSE", "NEES", "within 95 %")
    for name in after.errors:
        signal = SIGNALS[name]
        pair = [figures.errors[name] for figures in (before, after)]
        rmse = " → ".join(f"{errors.rmse * signal.shown_per_unit:.3g}" for errors in pair)
        table.add_row(
            signal.label,
            f"{rmse} {signal.shown_unit}",
            " → ".join(f"{errors.nees:.2f}" for errors in pair),
            " → ".join(f"{100 * errors.inside:.0f} %" for errors in pair),
        )
    return table


def draw(tuning: Tuning, path: Path) -> Path:
    """Write the picture; the format is that of the file's name."""
    pairs = _pairs(tuning)
    with matplotlib.rc_context(dict(STYLE)):
        rows = len(tuning.after.sensors) + 1
        figure = Figure(figsize=(13, (0.36 * rows + 1.2) * len(pairs)), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(len(pairs), 3, squeeze=False)
        for (title, before, after), (nis, lag, errors) in zip(pairs, panels, strict=True):
            _nis(nis, title, before, after)
            _lag(lag, before, after)
            _nees(errors, before, after)
        before, after, *_ = panels[0, 0].get_lines()
        shown = {"before": before, "after": after, "95 % of filters that are right": panels[0, 0].patches[0]}
        figure.legend(shown.values(), shown, loc="outside lower right", ncols=len(shown))
        figure.savefig(path, dpi=110)
    return path


def _nis(axes: Axes, title: str, before: Figures, after: Figures) -> None:
    axes.set_title(f"{drawn(title)}: NIS per component")
    _points(axes, *([consistency.nis for consistency in figures.sensors.values()] for figures in (before, after)))
    for row, consistency in enumerate(after.sensors.values()):
        low, high = consistency.nis_interval
        axes.barh(row, high - low, left=low, height=0.7, color=_EXPECTED, zorder=1)
    _rows(axes, list(after.sensors))
    _around_one(axes)


def _lag(axes: Axes, before: Figures, after: Figures) -> None:
    axes.set_title("Lag-1 correlation of the innovations")
    _points(axes, *([consistency.lag_1 for consistency in figures.sensors.values()] for figures in (before, after)))
    for row, consistency in enumerate(after.sensors.values()):
        axes.barh(
            row, 2 * consistency.lag_1_bound, left=-consistency.lag_1_bound, height=0.7, color=_EXPECTED, zorder=1
        )
    _rows(axes, list(after.sensors))
    axes.axvline(0, color=MUTED, linewidth=0.6, zorder=2)
    axes.set_xlim(-1, 1)


def _nees(axes: Axes, before: Figures, after: Figures) -> None:
    axes.set_title("NEES")
    if not after.errors:
        axes.text(0.5, 0.5, "no reference", transform=axes.transAxes, ha="center", va="center", color=MUTED)
        axes.set_axis_off()
        return
    _points(axes, *([errors.nees for errors in figures.errors.values()] for figures in (before, after)))
    _rows(axes, [SIGNALS[name].label for name in after.errors])
    _around_one(axes)


def _points(axes: Axes, before: list[float], after: list[float]) -> None:
    rows = np.arange(len(before))
    axes.plot(before, rows, "o", color=_BEFORE, markersize=6, zorder=3)
    axes.plot(after, rows, "o", color=_AFTER, markersize=6, zorder=4)
    axes.hlines(rows, before, after, color=MUTED, linewidth=0.8, zorder=2)


def _rows(axes: Axes, names: list[str]) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)


def _around_one(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.axvline(1, color=MUTED, linewidth=0.6, zorder=2)
    low, high = axes.get_xlim()
    reach = max(high, 1 / low, 2.2)
    axes.set_xlim(1 / reach, reach)
    ticks = [tick for tick in (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 100, 300, 1000)
             if 1 / reach <= tick <= reach]  # fmt: skip
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
