"""A self-contained HTML page about one or more drives: it opens without a network and can be mailed as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from vsense_ros.evaluate.balance import Balance
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.html_page import embedded, write_page
from vsense_ros.evaluate.picture import BAND, ESTIMATE, MUTED, TRUTH, WHEEL_COLOURS, draw, value_limits
from vsense_ros.evaluate.signals import SIGNALS, Array, Series, curve, read_signals
from vsense_ros.evaluate.wording import HEADINGS, LEGEND, named, score_cells
from vsense_ros.messages.topics import WHEELS

BEYOND = "Tyre forces beyond what is felt, of the weight or the load at rest"
_OF_SHARES = (TRUTH, WHEEL_COLOURS["fl"], WHEEL_COLOURS["rr"])
START_UP = 20  # the first part of this many of a drive may exceed the axes of forces
ROW_HEIGHT = 190  # of one interactive plot [px]
INTERACTIVE = (
    "side_slip",
    "lateral_velocity",
    "yaw_rate",
    "speed",
    "roll",
    "lateral_acceleration",
    "longitudinal_acceleration",
)


def write_report(
    drives: Sequence[Drive],
    path: Path,
    *,
    title: str,
    pictures: Mapping[str, Path] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> Path:
    """Write the page about `drives` to `path`.

    `pictures` maps the names of drives to PNG files that exist already; the others are drawn for the page.
    `provenance` says by name where the results come from (`evaluate/provenance.py`), for the top of the page.
    """
    return write_page(
        path,
        "vsense_ros.evaluate",
        "report.html.j2",
        title=title,
        headings=HEADINGS,
        legend=LEGEND,
        provenance=provenance or {},
        plotly=get_plotlyjs(),
        drives=[_section(drive, (pictures or {}).get(drive.name)) for drive in drives],
    )


def _section(drive: Drive, picture: Path | None) -> dict[str, Any]:
    if picture is None:
        with TemporaryDirectory() as folder:
            image = draw(drive, Path(folder) / "picture")[0].read_bytes()
    else:
        image = picture.read_bytes()
    return {
        "drive": drive,
        "facts": drive.facts(),
        "rows": [
            {
                "label": SIGNALS[name].label,
                "cells": score_cells(name, result, drive.trivial.get(name)),
                "n": result.n,
                "others": [
                    (label, score_cells(name, scores[name]))
                    for label, scores in drive.baselines.items()
                    if name in scores
                ],
            }
            for name, result in drive.scores.items()
        ],
        "balance": None if drive.balance is None else drive.balance.percent,
        "unreferenced": named(drive.unreferenced),
        "sensors": drive.sensors(),
        "picture": embedded(image),
        "plot": _interactive(drive),
    }


class _Plot(NamedTuple):
    """One plot of the page: its title, the unit of its axis, and the names of the signals in it."""

    title: str
    unit: str
    names: tuple[str, ...]


def _interactive(drive: Drive) -> str:
    """Curves that can be zoomed, as a piece of HTML that needs plotly's script on the page."""
    estimates, truths = read_signals(drive.output, "vsense"), read_signals(drive.input, "reference")
    plots = _plots(estimates)
    if not plots:
        return ""
    start = min(int(series.stamp[0]) for series in (*estimates.values(), *truths.values()))
    titles = [plot.title.capitalize() for plot in plots] + ([BEYOND] if drive.balance is not None else [])
    figure = make_subplots(
        rows=len(titles), cols=1, shared_xaxes=True, vertical_spacing=0.18 / len(plots), subplot_titles=titles
    )
    for row, plot in enumerate(plots, start=1):
        _add_signals(figure, row, plot, estimates, truths, start)
    if drive.balance is not None:
        for trace in _unbalanced(drive.balance, start):
            trace.legend = _legend(len(titles))
            figure.add_trace(trace, row=len(titles), col=1)
        figure.update_yaxes(title_text="[%]", row=len(titles), col=1)
    _lay_out(figure, len(titles))
    config = {
        "displaylogo": False,
        "responsive": True,
        "showSendToCloud": False,
        "modeBarButtonsToRemove": ["select2d", "lasso2d"],
    }
    named = re.sub(r"\W+", "-", f"plot-{drive.name}")
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=config, div_id=named))


def _plots(estimates: Mapping[str, Series]) -> list[_Plot]:
    """The plots of the signals that are estimated: one for each, and one for the four wheels in each direction."""
    plots = [_Plot(SIGNALS[name].label, SIGNALS[name].shown_unit, (name,)) for name in INTERACTIVE if name in estimates]
    for letter, direction in (("z", "vertical"), ("y", "lateral"), ("x", "longitudinal")):
        names = tuple(name for wheel in WHEELS if (name := f"wheel_force_{wheel}_{letter}") in estimates)
        if names:
            plots.append(_Plot(f"{direction} tyre force", "kN", names))
    return plots


def _add_signals(
    figure: go.Figure,
    row: int,
    plot: _Plot,
    estimates: Mapping[str, Series],
    truths: Mapping[str, Series],
    start: int,
) -> None:
    """Draw the signals of a plot into a row of the figure, each kind of curve once in its legend, with limits that show
    them all."""
    explained: set[str] = set()
    for name in plot.names:
        wheel = name.split("_")[2] if name.startswith("wheel_force_") else ""
        label, colour = wheel.upper() or "estimate", WHEEL_COLOURS.get(wheel, ESTIMATE)
        for trace in _traces(estimates[name], truths.get(name), start, label, colour):
            trace.showlegend = trace.name is not None and trace.name not in explained
            explained.add(trace.name)
            trace.legend = _legend(row)
            figure.add_trace(trace, row=row, col=1)
    limits = [_limits(estimates[name], truths.get(name)) for name in plot.names]
    span = (min(low for low, _ in limits), max(high for _, high in limits))
    figure.update_yaxes(title_text=f"[{plot.unit}]", range=span, row=row, col=1)


def _lay_out(figure: go.Figure, rows: int) -> None:
    """Give all plots the looks of the page, a legend of their own, and one axis of time."""
    figure.update_xaxes(title_text="time [s]", row=rows, col=1)
    figure.update_xaxes(showgrid=True, gridcolor="#ececec", zeroline=False, linecolor="#b8b8b8")
    figure.update_yaxes(showgrid=True, gridcolor="#ececec", zeroline=False, linecolor="#b8b8b8")
    figure.update_annotations(font={"size": 13, "color": TRUTH}, x=0.0, xanchor="left")
    figure.update_layout(
        height=ROW_HEIGHT * rows + 90,
        margin={"l": 62, "r": 12, "t": 60, "b": 44},
        plot_bgcolor="white",
        paper_bgcolor="white",
        font={"family": "system-ui, DejaVu Sans, sans-serif", "size": 12, "color": MUTED},
        hovermode="x",
        hoversubplots="axis",
        **{
            _legend(row): {
                "orientation": "h", "x": 1.0, "xanchor": "right", "yanchor": "bottom", "font": {"size": 11},
                "y": figure.layout[f"yaxis{row if row > 1 else ''}"].domain[1],
            }
            for row in range(1, rows + 1)
        },
    )  # fmt: skip
    # One axis for all plots, so that the cursor is a line through all of them.
    figure.update_traces(xaxis=f"x{rows}" if rows > 1 else "x")
    figure.update_xaxes(showspikes=True, spikemode="across", spikethickness=1, spikecolor=TRUTH, spikesnap="cursor")


def _legend(row: int) -> str:
    """Name of the legend of a plot."""
    return "legend" if row == 1 else f"legend{row}"


def _limits(estimate: Series, truth: Series | None) -> tuple[float, float]:
    """Limits of an axis that show the curves after start-up; a force has no band drawn into its plot with others."""
    if not estimate.signal.name.startswith("wheel_force_"):
        return value_limits(estimate, truth)
    shown = estimate.shown()
    settled = shown[len(shown) // START_UP :]
    reference = truth.shown() if truth is not None else settled
    low, high = float(min(settled.min(), reference.min())), float(max(settled.max(), reference.max()))
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


def _unbalanced(balance: Balance, start: int) -> list[go.Scatter]:
    """Shares of the weight and of the axles' loads that do not balance [%]; where the inertial sensor measures no load,
    of the forces along and across the car, and the yaw moment."""
    traces = []
    loads = [name for name in ("vertical force", "front load", "rear load") if name in balance.measured]
    for name, colour in zip(loads or balance.measured, _OF_SHARES, strict=False):
        share = 100 * balance.of(name)
        seconds, shown = curve(balance.stamp, start, share)
        line = {"color": colour, "width": 1.2}
        traces.append(go.Scatter(x=_short(seconds, 3), y=_short(shown, 2), mode="lines", line=line, name=name))
    return traces


def _traces(estimate: Series, truth: Series | None, start: int, label: str, colour: str) -> list[go.Scatter]:
    """Band, estimate and reference of one signal."""
    traces: list[go.Scatter] = []
    if (band := estimate.band()) is not None:
        times, shown, two = curve(estimate.stamp, start, estimate.shown(), band)
        around, edge = outline(times, shown - two, shown + two)
        traces.append(
            go.Scatter(
                x=_short(around, 3),
                y=_short(edge, 5),
                mode="lines",
                line={"width": 0},
                fill="toself",
                fillcolor=f"rgba{(*(int(BAND[i : i + 2], 16) for i in (1, 3, 5)), 0.5)}",
                name="±2σ",
                hoverinfo="skip",
                legendgroup="band",
            )
        )
    line = {"color": colour, "width": 1.4}
    seconds, y = _points(estimate, start)
    traces.append(go.Scatter(x=seconds, y=y, mode="lines", line=line, name=label, legendgroup=label))
    if truth is not None:
        seconds, y = _points(truth, start)
        traces.append(
            go.Scatter(
                x=seconds,
                y=y,
                mode="lines",
                line={"color": TRUTH, "width": 1.0, "dash": "dash"},
                name="reference",
                legendgroup="reference",
            )
        )
    return traces


def outline(times: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The outline of a band (n,) as one closed line around each stretch in which it is known, with NaN between them: a
    fill between two lines that are interrupted would cover what lies between the stretches."""
    finite = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    stretches = [part for part in np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1) if len(part)]
    x = [np.concatenate([times[part], times[part][::-1], [np.nan]]) for part in stretches]
    y = [np.concatenate([high[part], low[part][::-1], [np.nan]]) for part in stretches]
    return np.concatenate([*x, []]), np.concatenate([*y, []])


def _points(series: Series, start: int) -> tuple[list[float], list[float]]:
    """Times [s] and values of a curve, rounded."""
    times, shown = curve(series.stamp, start, series.shown())
    return _short(times, 3), _short(shown, 5)


def _short(values: Any, digits: int) -> list[float]:
    """Rounded numbers: the page carries them as text."""
    return [round(float(value), digits) for value in values]
