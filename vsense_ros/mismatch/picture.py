"""Pictures of a mismatch: signals as recorded, of the model and of the extended model, and when the error arises.

They are SVG, so that a page can carry them and a printer loses nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from math import ceil

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import detrend

from vsense_ros.evaluate.picture import ESTIMATE, STYLE, TRUTH
from vsense_ros.evaluate.signals import thin
from vsense_ros.mismatch.answer_schema import EffectEntry, ProfilePoint, Segment
from vsense_ros.mismatch.signals import difference
from vsense_ros.mismatch.words import SIGNAL_UNITS, heading, size_unit
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]

BEFORE = "#D55E00"
AFTER = ESTIMATE


@dataclass(frozen=True)
class PictureSettings:
    """Layout of the pictures of an answer."""

    others: int = 9  # signals that are shown besides the most affected one
    columns: int = 3  # of panels
    stretch_gap: float = 100.0  # [m] between stretches of road that are drawn apart
    labelled: int = 3  # stretches of time whose share is written beside them


PICTURE = PictureSettings()


@dataclass(frozen=True)
class Trace:
    """One signal in one window, as measured and as simulated with the base parameters fitted, and with what was found.

    `t` (n,) since the beginning of the recording [s]; `measured`, `before` and `after` (n,) in `unit`.
    """

    recording: str
    window: int
    held_out: bool
    signal: str
    unit: str
    t: Array
    measured: Array
    before: Array
    after: Array

    def error(self, simulated: Array) -> Array:
        """(n,) measured minus simulated, in the way in which the signal is compared."""
        differences = difference({self.signal: self.measured}, {self.signal: simulated})
        return differences.get(self.signal, self.measured - simulated)

    @property
    def errors(self) -> tuple[float, float]:
        """Root mean square of the error before and after."""
        return rms(self.error(self.before)), rms(self.error(self.after))

    @property
    def shown(self) -> tuple[str, float]:
        """What people read the signal in, and the factor to it."""
        return SIGNAL_UNITS.get(self.unit, (self.unit, 1.0))

    @property
    def changed(self) -> bool:
        return not np.allclose(self.before, self.after, rtol=0.0, atol=1e-9)


def rms(value: Array) -> float:
    return float(np.sqrt(np.mean(value**2)))


def most_affected(traces: Sequence[Trace], signals: Sequence[str]) -> Trace | None:
    """The window with the largest error in the first of `signals` that has any; one that no fit saw, if possible."""
    for signal in [*signals, *(trace.signal for trace in traces)]:
        of_signal = [trace for trace in traces if trace.signal == signal]
        if of_signal:
            return max(of_signal, key=lambda trace: (trace.held_out, trace.errors[0]))
    return None


def before_and_after(trace: Trace) -> bytes:
    """One signal in one window: the curves above, their errors below."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.0, 4.9), facecolor="white")
        grid = figure.add_gridspec(
            2, 1, left=0.062, right=0.995, top=0.93, bottom=0.095, hspace=0.12, height_ratios=(2.4, 1)
        )
        curves = figure.add_subplot(grid[0])
        errors = figure.add_subplot(grid[1], sharex=curves)
        _curves(curves, trace)
        curves.tick_params(labelbottom=False)
        curves.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1, fontsize=9.5)
        unit, factor = trace.shown
        for name, simulated, colour in _simulations(trace):
            error = trace.error(simulated) * factor
            rows = thin(error)
            errors.plot(trace.t[rows], error[rows], color=colour, lw=1.1, label=name)
        errors.axhline(0.0, color="#b8b8b8", lw=0.8, zorder=1)
        curves.set_ylabel(_said(trace))
        errors.set_ylabel(f"error [{unit}]")
        errors.set_xlabel("time in the recording [s]")
        curves.margins(x=0.005)
        return _svg(figure)


def other_signals(traces: Sequence[Trace], shown: Trace, signals: Sequence[str]) -> bytes | None:
    """The other signals in the window of `shown`, the most affected first; None where there are none."""
    beside = {
        trace.signal: trace
        for trace in traces
        if (trace.recording, trace.window, trace.held_out) == (shown.recording, shown.window, shown.held_out)
        and trace.signal != shown.signal
    }
    order = [name for name in signals if name in beside] + [name for name in beside if name not in signals]
    if not order:
        return None
    chosen = [beside[name] for name in order[: PICTURE.others]]
    rows = ceil(len(chosen) / PICTURE.columns)
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.0, 1.95 * rows + 0.35), facecolor="white", layout="constrained")
        every = figure.subplots(rows, PICTURE.columns, squeeze=False, sharex=True).ravel()
        for axes, trace in zip(every, chosen, strict=False):
            _curves(axes, trace)
            axes.set_title(_said(trace))
            axes.margins(x=0.01)
        for axes in every[len(chosen) :]:
            axes.set_visible(False)
        for axes in every[max(0, len(chosen) - PICTURE.columns) : len(chosen)]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("time [s]")
        return _svg(figure)


def when(segments: Sequence[Segment], traces: Sequence[Trace]) -> bytes | None:
    """Which stretches of the recordings carry the error; None where nothing is known of it.

    The height of a bar is the error's share per time, so that a long stretch does not look worse than a short one.
    """
    if not segments:
        return None
    names = list(dict.fromkeys(segment.recording for segment in segments))
    largest = sorted(segments, key=lambda segment: segment.share, reverse=True)[: PICTURE.labelled]
    highest = max(*(segment.density for segment in segments), 1e-12)
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.0, 0.62 * len(names) + 0.62), facecolor="white", layout="constrained")
        axes = figure.add_subplot()
        for row, name in enumerate(names):
            spans = {(trace.t[0], trace.t[-1]) for trace in traces if trace.recording == name and not trace.held_out}
            for begin, end in spans:
                axes.plot((begin, end), (-row, -row), color="#c9c9c5", lw=2.4, solid_capstyle="butt", zorder=1)
            for segment in segments:
                if segment.recording != name:
                    continue
                begin, length = segment.begin, segment.end - segment.begin
                height = 0.62 * segment.density / highest
                axes.bar(begin, height, length, -row, align="edge", color=BEFORE, edgecolor="white", lw=1.0, zorder=2)
                if any(segment is one for one in largest):
                    axes.text(
                        begin + length / 2, -row + height + 0.03, f"{100 * segment.share:.0f} %",
                        ha="center", va="bottom", fontsize=8.0, color=TRUTH,
                    )  # fmt: skip
        axes.set_yticks([-row for row in range(len(names))], [_plain(name) for name in names])
        axes.set_ylim(-len(names) + 0.9, 0.9)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", labelsize=9.0, labelcolor=TRUTH)
        axes.set_xlabel("time in the recording [s]")
        axes.margins(x=0.005)
        return _svg(figure)


def road_profile(effect: EffectEntry) -> bytes:
    """An effect that is another at every place: its size along the way, with the 90 % interval."""
    size = effect.parameters[0]
    unit, factor = size_unit(size)
    stretches: dict[float, list[ProfilePoint]] = {}
    for point in effect.profile or ():
        stretches.setdefault(point.stretch, []).append(point)
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.0, 2.6), facecolor="white", layout="constrained")
        axes = figure.add_subplot()
        begin = 0.0
        for points in stretches.values():
            at = np.array([point.distance for point in points])
            at = begin + at - at[0]
            values = np.array([[point.value, *point.interval_90] for point in points]) + size.value
            value, low, high = values.T * factor
            axes.fill_between(at, low, high, color=AFTER, alpha=0.18, lw=0)
            axes.plot(at, value, color=AFTER, lw=1.3, marker="o", ms=2.5)
            begin = at[-1] + PICTURE.stretch_gap
        axes.axhline(0.0, color="#b8b8b8", lw=0.8, zorder=1)
        axes.set_xlabel("way along the road [m]")
        name = effect.id if size.name == "relative" else size.name
        axes.set_ylabel(f"{heading(name)}{f' [{unit}]' if unit else ''}")
        axes.margins(x=0.005)
        return _svg(figure)


def _simulations(trace: Trace) -> list[tuple[str, Array, str]]:
    """Name, values and colour of each simulation; one alone where nothing was added to the model."""
    if not trace.changed:
        return [("model, re-fitted", trace.before, BEFORE)]
    return [
        ("before: model, re-fitted", trace.before, BEFORE),
        ("after: extended model, re-fitted", trace.after, AFTER),
    ]


def _curves(axes: Axes, trace: Trace) -> None:
    """Measured and simulated over time; both without constant and slope where they are compared so, which would hide
    the error."""
    _, factor = trace.shown
    measured = detrend(trace.measured) if _drifts(trace.signal) else trace.measured
    rows = thin(measured)
    axes.plot(trace.t[rows], measured[rows] * factor, color=TRUTH, lw=1.3, label="measured", zorder=2)
    for name, simulated, colour in _simulations(trace):
        value = (measured - trace.error(simulated)) * factor
        rows = thin(value)
        axes.plot(trace.t[rows], value[rows], color=colour, lw=1.3, label=name, zorder=3)


def _drifts(name: str) -> bool:
    """True if a signal is compared up to a constant and a slope."""
    signal = compared_signals().get(name)
    return signal is not None and signal.drifting


def _said(trace: Trace) -> str:
    """What an axis shows, in words."""
    return f"{heading(trace.signal)}{', without slope' if _drifts(trace.signal) else ''} [{trace.shown[0]}]"


def _plain(words: str) -> str:
    """Names are no formulas, whatever signs they hold."""
    return words.replace("$", r"\$")


def _svg(figure: Figure) -> bytes:
    FigureCanvasSVG(figure)
    target = BytesIO()
    figure.savefig(target, format="svg", metadata={"Date": None})
    return target.getvalue()
