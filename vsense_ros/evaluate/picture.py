"""One picture of a drive: where it went, what the car did, how well that was estimated, what the tyres carried.

The colours are those of Okabe and Ito (2008), which people with any colour vision tell apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.metrics import SignalScore, align
from vsense_ros.evaluate.signals import MOST_POINTS, SIGNALS, Array, Series, Signal, curve, read_signals
from vsense_ros.files.names import drawn
from vsense_ros.messages.topics import WHEELS

ESTIMATE = "#0072B2"
TRUTH = "#1a1a1a"
BAND = "#9ecae1"
MUTED = "#6b6b6b"
WHEEL_COLOURS = {"fl": "#0072B2", "fr": "#D55E00", "rl": "#56B4E9", "rr": "#E69F00"}
COLUMNS = (1.0, 1.25, 1.0)  # relative widths
LONGEST_MAP = 4.0  # length over width of a path, beyond which its width is stretched to be seen
SHOWN_OVER_TIME = ("speed", "yaw_rate", "lateral_velocity", "side_slip")

STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": MUTED,
    "axes.edgecolor": "#b8b8b8",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#ececec",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "svg.hashsalt": "vsense",
}


def figure_of(drive: Drive) -> Figure:
    """The picture as a figure, in the style of the project."""
    with matplotlib.rc_context(dict(STYLE)):
        return compose(drive)


def draw(drive: Drive, path: Path) -> list[Path]:
    """Write `<path>.png` and `<path>.svg`; returns both."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = compose(drive)
        targets = [path.with_name(path.name + ".png"), path.with_name(path.name + ".svg")]
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(targets[0], dpi=150)
        figure.savefig(targets[1], metadata={"Date": None})
    return targets


def compose(drive: Drive) -> Figure:
    """The picture as a figure of 16 x 11.5 inches."""
    estimates = read_signals(drive.output, "vsense")
    truths = read_signals(drive.input, "reference")
    start = min((int(series.stamp[0]) for series in (*estimates.values(), *truths.values())), default=0)
    figure = Figure(figsize=(16.0, 11.5), facecolor="white")
    FigureCanvasAgg(figure)
    _head(figure, drive)
    upper = figure.add_gridspec(
        4, 3, left=0.045, right=0.985, top=0.875, bottom=0.335, wspace=0.16, hspace=0.3, width_ratios=COLUMNS
    )
    side = upper[:, 0].subgridspec(2, 1, height_ratios=(3.4, 1.0), hspace=0.24)
    _map(figure.add_subplot(side[0]), estimates, truths)
    _accelerations(figure.add_subplot(side[1]), estimates, truths, start)
    _over_time(figure, upper, drive.scores, estimates, truths, start)
    lower = figure.add_gridspec(
        1, 3, left=0.045, right=0.985, top=0.265, bottom=0.05, wspace=0.16, width_ratios=COLUMNS
    )
    _tyre_forces(figure.add_subplot(lower[0, 0]), "z", "Vertical tyre force", estimates, truths, start)
    _tyre_forces(figure.add_subplot(lower[0, 1]), "y", "Lateral tyre force", estimates, truths, start)
    _friction(figure.add_subplot(lower[0, 2]), estimates, start)
    return figure


def _head(figure: Figure, drive: Drive) -> None:
    figure.text(0.045, 0.962, drawn(drive.title), fontsize=17.0, fontweight="bold", va="center", color=TRUTH)
    facts = drive.facts()
    if np.isfinite(drive.step_us_median):
        facts.append(f"{drive.step_us_median:.0f} µs a step")
    if np.isfinite(drive.realtime_factor):
        facts.append(f"{drive.realtime_factor:.3g} × real time")
    facts.append(f"{drive.messages_lost} messages lost")
    lines = ["   ·   ".join(facts), *filter(None, [drive.way])]
    figure.text(0.045, 0.941, "\n".join(lines), fontsize=9.5, va="top", color=MUTED, linespacing=1.5)


def _map(axes: Axes, estimates: Mapping[str, Series], truths: Mapping[str, Series]) -> None:
    position = estimates.get("position") or truths.get("position")
    if position is None:
        axes.set_title("Path")
        _say(axes, "no position")
        return
    rows = np.unique(np.linspace(0, len(position) - 1, min(len(position), MOST_POINTS)).astype(int))
    origin = position.value[rows[0]]
    turn = _along_the_path(position.value[rows] - origin)
    path = (position.value[rows] - origin) @ turn.T
    if "position" in estimates and "position" in truths:
        truth = truths["position"].value
        true_path = (truth[:: max(1, len(truth) // MOST_POINTS)] - origin) @ turn.T
        axes.plot(true_path[:, 0], true_path[:, 1], color=TRUTH, lw=0.9, ls=(0, (4, 3)), zorder=3, label="reference")
    axes.plot(path[:, 0], path[:, 1], color="#8a8a8a", lw=5.2, solid_capstyle="round", zorder=1)
    slip = estimates.get("side_slip")
    if slip is not None:
        axes.set_title("Path, coloured by side slip")
        value = np.interp(position.stamp[rows], slip.stamp, slip.shown(), left=0.0, right=0.0)
        limit = max(float(np.quantile(np.abs(value), 0.995)), 0.1)
        segments = np.stack([path[:-1], path[1:]], axis=1)
        lines = LineCollection(list(segments), cmap="coolwarm", norm=Normalize(-limit, limit))
        lines.set(array=value[:-1], linewidth=4.0, capstyle="round", zorder=2)
        axes.add_collection(lines)
        bar = axes.figure.colorbar(lines, ax=axes, shrink=0.55, aspect=24, pad=0.03)
        bar.ax.spines[:].set_visible(False)
        bar.set_label("side slip [°]")
    else:
        axes.set_title("Path")
    axes.plot(*path[0], marker="o", ms=7, mfc="white", mec=TRUTH, mew=1.4, ls="none", zorder=4, label="start")
    axes.margins(0.08)
    if np.array_equal(turn, np.eye(2)):
        axes.set_aspect("equal", adjustable="datalim")
        lost = _heading_unknown(estimates)
        axes.set_xlabel("x from the start [m], heading unknown" if lost else "east of the start [m]")
        axes.set_ylabel("y from the start [m]" if lost else "north of the start [m]")
    else:
        low, high = float(path[:, 1].min()), float(path[:, 1].max())
        half = max(0.75 * (high - low), 1.0)
        axes.set_ylim((low + high) / 2.0 - half, (low + high) / 2.0 + half)
        axes.set_xlabel("along the drive [m]")
        axes.set_ylabel("to its left [m], stretched")
    axes.legend(loc="upper right")


def _heading_unknown(estimates: Mapping[str, Series]) -> bool:
    """True if the estimate of the heading on the map says for most of the drive that it knows none, so that the path
    may be turned by any angle: without GNSS, or any other sensor that knows north."""
    yaw = estimates.get("yaw")
    return yaw is not None and yaw.deviation is not None and bool(np.median(yaw.deviation) >= yaw.signal.unknown)


def _along_the_path(path: Array) -> Array:
    """(2, 2) rotation that lays a long and narrow path along the horizontal; identity for any other path, and for
    places that are all the same, which have no direction."""
    if len(path) < 2:
        return np.eye(2)
    _, extent, axes = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)
    if extent[0] <= LONGEST_MAP * extent[1]:
        return np.eye(2)
    along = axes[0] if axes[0] @ (path[-1] - path[0]) >= 0.0 else -axes[0]
    return np.array([along, [-along[1], along[0]]])


def _accelerations(axes: Axes, estimates: Mapping[str, Series], truths: Mapping[str, Series], start: int) -> None:
    """Lateral and longitudinal acceleration over time; a g-g cloud would hide when it happened."""
    axes.set_title("Acceleration")
    shown = [("lateral_acceleration", ESTIMATE, "lateral"), ("longitudinal_acceleration", "#D55E00", "longitudinal")]
    if not any(name in estimates for name, _, _ in shown):
        _say(axes, "not estimated")
        return
    for name, colour, label in shown:
        if name in truths:
            axes.plot(*_curve(truths[name], start), color=TRUTH, lw=0.8, ls=(0, (4, 3)), zorder=3)
        if name in estimates:
            axes.plot(*_curve(estimates[name], start), color=colour, label=label, zorder=2)
    axes.set_ylabel("[m/s²]")
    axes.set_xlabel("time [s]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    axes.margins(x=0.01)


def _over_time(
    figure: Figure,
    grid: GridSpec,
    scores: Mapping[str, SignalScore],
    estimates: Mapping[str, Series],
    truths: Mapping[str, Series],
    start: int,
) -> None:
    first: Axes | None = None
    for row, name in enumerate(SHOWN_OVER_TIME):
        axes = figure.add_subplot(grid[row, 1], sharex=first)
        first = first or axes
        errors = figure.add_subplot(grid[row, 2], sharex=first)
        signal = SIGNALS[name]
        axes.set_title(signal.label.capitalize())
        axes.set_ylabel(f"[{signal.shown_unit}]")
        errors.set_ylabel(f"[{signal.shown_unit}]")
        _signal(axes, estimates.get(name), truths.get(name), start)
        _residual(errors, scores.get(name), estimates.get(name), truths.get(name), start)
        if row == 0 and axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.0)
        for panel in (axes, errors):
            panel.tick_params(labelbottom=row == len(SHOWN_OVER_TIME) - 1)
    if first is not None:
        first.margins(x=0.01)
        for panel in (axes, errors):
            panel.set_xlabel("time [s]")


def _signal(axes: Axes, estimate: Series | None, truth: Series | None, start: int) -> None:
    if truth is not None:
        axes.plot(*_curve(truth, start), color=TRUTH, lw=1.0, ls=(0, (4, 3)), label="reference", zorder=3)
    if estimate is None:
        _say(axes, "not estimated")
        return
    axes.plot(*_curve(estimate, start), color=ESTIMATE, label="estimate", zorder=2)
    if (band := estimate.band()) is not None:
        seconds, value, two = curve(estimate.stamp, start, estimate.shown(), band)
        axes.fill_between(seconds, value - two, value + two, color=BAND, alpha=0.55, lw=0.0, label="±2σ", zorder=1)
    axes.set_ylim(value_limits(estimate, truth))


def value_limits(estimate: Series, truth: Series | None) -> tuple[float, float]:
    """What an axis must show, in the shown unit: the curves, and the band once the first twentieth has gone by, in
    which it may be many times as wide as the signal."""
    shown = estimate.shown()
    low, high = float(shown.min()), float(shown.max())
    if truth is not None:
        low, high = min(low, float(truth.shown().min())), max(high, float(truth.shown().max()))
    if (band := estimate.band()) is not None:
        settled = np.arange(len(shown)) >= len(shown) // 20
        settled &= np.isfinite(band)
        low = float((shown - band).min(where=settled, initial=low))
        high = float((shown + band).max(where=settled, initial=high))
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _residual(
    axes: Axes, result: SignalScore | None, estimate: Series | None, truth: Series | None, start: int
) -> None:
    if result is None or estimate is None or truth is None:
        axes.set_title("Error")
        _say(axes, "no reference in this recording" if truth is None else "not estimated")
        return
    signal = estimate.signal
    axes.set_title("Error")
    axes.text(1.0, 1.045, in_words(signal, result), transform=axes.transAxes, ha="right", fontsize=8.0, color=MUTED)
    aligned = align(estimate, truth)
    error = aligned.error[:, 0] * signal.shown_per_unit
    axes.axhline(0.0, color="#b8b8b8", lw=0.8, zorder=1)
    axes.plot(*curve(aligned.stamp, start, error), color=ESTIMATE, lw=1.0, zorder=3)
    if (band := estimate.band()) is not None:
        seconds, _, two = curve(aligned.stamp, start, error, np.interp(aligned.stamp, estimate.stamp, band))
        axes.fill_between(seconds, -two, two, color=BAND, alpha=0.45, lw=0.0, zorder=0)
    limit = 1.15 * max(float(np.quantile(np.abs(error), 0.999)), 1e-9)
    axes.set_ylim(-limit, limit)


def _tyre_forces(
    axes: Axes,
    letter: str,
    title: str,
    estimates: Mapping[str, Series],
    truths: Mapping[str, Series],
    start: int,
) -> None:
    axes.set_title(title)
    for wheel in WHEELS:
        name = f"wheel_force_{wheel}_{letter}"
        if name in truths:
            axes.plot(*_curve(truths[name], start), color=TRUTH, lw=0.7, ls=(0, (4, 3)), zorder=3)
        if name in estimates:
            axes.plot(*_curve(estimates[name], start), color=WHEEL_COLOURS[wheel], label=wheel.upper(), lw=1.1)
    axes.set_ylabel("[kN]")
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.0)
    else:
        _say(axes, "not estimated")


def _friction(axes: Axes, estimates: Mapping[str, Series], start: int) -> None:
    """Horizontal over vertical force of each tyre: how much of the friction is in use."""
    axes.set_title("Friction in use")
    peaks: list[float] = []
    for wheel in WHEELS:
        forces = [estimates.get(f"wheel_force_{wheel}_{letter}") for letter in "xyz"]
        if any(force is None for force in forces):
            continue
        x, y, z = (force for force in forces if force is not None)
        stamp = np.intersect1d(np.intersect1d(x.stamp, y.stamp), z.stamp)
        if not len(stamp):
            continue
        values = [force.value[np.searchsorted(force.stamp, stamp), 0] for force in (x, y, z)]
        friction = np.where(values[2] > 50.0, np.hypot(values[0], values[1]) / np.maximum(values[2], 50.0), np.nan)
        peaks.append(float(np.quantile(np.nan_to_num(friction), 0.999)))
        seconds, _, shown = curve(stamp, start, np.nan_to_num(friction), friction)
        axes.plot(seconds, shown, color=WHEEL_COLOURS[wheel], lw=1.0, label=wheel.upper())
    axes.set_ylabel("|F$_{xy}$| / F$_z$ [–]")
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)
    if peaks:
        axes.set_ylim(0.0, 1.1 * max(*peaks, 0.05))
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.0)
    else:
        _say(axes, "not estimated")


def in_words(signal: Signal, result: SignalScore) -> str:
    """A score as one line."""
    unit = signal.shown_unit if signal.shown_unit.startswith("°") else " " + signal.shown_unit
    nrmsd = "" if result.nrmsd_percent is None or not signal.ranged else f" = {result.nrmsd_percent:.2g} %"
    lag = "" if result.lag_s is None else f"   lag {result.lag_s * 1e3:+.0f} ms"
    rmse, bias = result.rmse * signal.shown_per_unit, result.bias * signal.shown_per_unit
    return f"RMSE {rmse:.3g}{unit}{nrmsd}   bias {bias:+.2g}{unit}{lag}"


def _say(axes: Axes, words: str) -> None:
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color=MUTED, style="italic")
    axes.grid(visible=False)


def _curve(series: Series, start: int) -> tuple[Array, ...]:
    return curve(series.stamp, start, series.shown())
