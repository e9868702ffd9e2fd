"""Observability of a filter on a drive: the states that it determines, those that it does not, and which motion
would."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from rich.console import Console
from rich.text import Text

from vsense_ros.errors import InputError
from vsense_ros.evaluate.picture import MUTED, STYLE
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.names import drawn
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.determined import MOTIONS, Determined, determined_by

Progress = Callable[[float], None]

# Motions that may determine what a drive has not, by the manoeuvre that shows them.
WAYS: Mapping[str, str] = {
    "go straight": "plain_straight",
    "accelerate and brake": "accelerate_and_brake",
    "turn": "right_turn",
    "corner at 80 km/h": "step_steer",
    "weave": "slalom",
}
LONGEST = 30.0  # [s] of each
_SHADES = ("#d9d9d9", "#ffffff", "#fde3c8", "#d6e8f5")


@dataclass(frozen=True)
class Report:
    """Observability of the states of one filter on one drive; for a state that the drive did not determine, `would` has
    the share of its deviation that remains after each motion of `WAYS`."""

    filter: str
    drive: str
    determined: Determined
    would: Mapping[str, Mapping[str, float]]


def report(
    recording: Recording,
    vehicle: Vehicle,
    name: str,
    *,
    ask: bool = True,
    progress: Progress = lambda share: None,
) -> Report:
    """Observability of the states of the filter `name` on a recording. With `ask`, the motions of `WAYS` are simulated
    with this vehicle if the recording leaves a state undetermined. Raises `InputError` as `determined_by` does."""
    determined = determined_by(recording, vehicle, name, lambda share: progress((0.3 if ask else 1.0) * share))
    missing = [state.name for state in determined.states if state.determined_at is None and state.before > 0]
    would: dict[str, dict[str, float]] = {state: {} for state in missing}
    if ask and missing:
        for i, (way, manoeuvre) in enumerate(WAYS.items()):
            shown = _shown(manoeuvre, vehicle, name)
            for state in missing:
                if shown is not None:
                    would[state][way] = shown[state]
            progress(0.3 + 0.7 * (i + 1) / len(WAYS))
    progress(1.0)
    return Report(name, recording.name or "recording", determined, would)


def _shown(manoeuvre: str, vehicle: Vehicle, name: str) -> dict[str, float] | None:
    """Shares of the deviations at start that a manoeuvre of this car leaves; None where the filter does not start."""
    simulated = record(drive(MANOEUVRES[manoeuvre], vehicle), vehicle, 1, name=manoeuvre)
    try:
        determined = determined_by(simulated.between(0.0, min(LONGEST, simulated.duration)), vehicle, name)
    except InputError:
        return None
    return {state.name: state.left for state in determined.states}


def advice(report: Report, state: str) -> str:
    """Words that name the motions which would determine a state best."""
    ways = {way: left for way, left in report.would.get(state, {}).items() if left <= 0.8}
    if not ways:
        return "none of them does" if report.would.get(state) else ""
    best = sorted(ways, key=lambda way: ways[way])[:2]
    return ", or ".join(f"{way} ({100 * ways[way]:.0f} % left)" for way in best)


def show(report: Report, console: Console) -> None:
    """Print the states, and the combinations that were not determined."""
    rest = f" on {report.drive}, {report.determined.t[-1]:.0f} s; standard deviations in SI units"
    console.print(Text.assemble((report.filter, "bold"), rest))
    headings = ("at start", "at the end", "left", "determined after")
    table = plain_table("state", *headings, "while, or what would determine it", right=headings)
    for state in report.determined.states:
        if state.before <= 0:
            continue
        known = state.determined_at is not None
        table.add_row(
            state.name, f"{state.before:.3g}", f"{state.after:.3g}", f"{100 * state.left:.0f} %",
            f"{state.determined_at:.1f} s" if known else Text("not yet", style="bold"),
            state.motion if known else advice(report, state.name),
        )  # fmt: skip
    console.print(table)
    if report.determined.undetermined is None:
        console.print("The filter is a cascade: of combinations of its states nothing is said.")
    elif report.determined.undetermined:
        console.print("Combinations that were hardly determined, weakest first (in units of deviations at start):")
        for one in report.determined.undetermined[:5]:
            console.print(f"  {one}: {100 * one.remaining:.0f} % left", soft_wrap=True)
    else:
        console.print("Every combination of states was determined.")


def draw(report: Report, path: Path) -> Path:
    """Deviations over time, over those at start, on the motion's shade."""
    shown = [i for i, state in enumerate(report.determined.states) if state.before > 0]
    columns = 3
    rows = int(np.ceil(len(shown) / columns))
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.0, 1.7 * rows + 1.0), layout="constrained")
        FigureCanvasAgg(figure)
        title = f"{report.filter} on {drawn(report.drive)}: what is left of a deviation"
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        t, motion = report.determined.t, report.determined.motion
        edges = np.flatnonzero(np.diff(motion)) + 1
        begins, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(t) - 1]])
        for panel, i in zip(panels, shown, strict=False):
            state = report.determined.states[i]
            for begin, end in zip(begins, ends, strict=True):
                panel.axvspan(t[begin], t[end], color=_SHADES[motion[begin]], lw=0, zorder=0)
            left = report.determined.deviations[:, i] / state.before
            panel.plot(t, left, color="#0072B2" if state.determined_at is not None else "#D55E00")
            panel.axhline(0.5, color=MUTED, lw=0.6, ls=":")
            panel.set_title(state.name + ("" if state.determined_at is not None else ", not determined"))
            panel.set_yscale("log")
            panel.grid(False)
        for panel in panels[len(shown) :]:
            panel.set_axis_off()
        for panel in panels[max(0, len(shown) - columns) : len(shown)]:
            panel.set_xlabel("[s]")
        handles = [
            Patch(facecolor=shade, edgecolor=MUTED, lw=0.4, label=motion)
            for shade, motion in zip(_SHADES, MOTIONS, strict=True)
        ]
        figure.legend(handles=handles, loc="upper right", ncols=4, fontsize=8)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    return path


def write(report: Report, path: Path) -> None:
    """Write the report as JSON [SI]."""
    path.parent.mkdir(parents=True, exist_ok=True)
    undetermined = report.determined.undetermined
    content = {
        "filter": report.filter,
        "drive": report.drive,
        "states": [asdict(state) for state in report.determined.states],
        "undetermined": None
        if undetermined is None
        else [{"direction": str(one), "left": one.remaining} for one in undetermined],
        "would_leave": report.would,
    }
    with atomic_write(path) as file:
        json.dump(content, file, indent=2)
        file.write("\n")
