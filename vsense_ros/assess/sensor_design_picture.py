"""Pictures of a design: the charts of Leung 2010 (figures 4.49 to 4.51) with these sensors marked, and what filters
make of the drive."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from vsense_ros.assess.drives import STEP
from vsense_ros.assess.sensor_design import GRADES, Design
from vsense_ros.evaluate.picture import BAND, ESTIMATE, MUTED, STYLE, TRUTH
from vsense_ros.manoeuvre.receivers import RECEIVERS
from vsense_ros.navigation import accuracy

_MARK = "#D55E00"
_COLOURS = (ESTIMATE, "#56B4E9", "#E69F00", "#009E73", "#CC79A7")
_LONGEST = 120.0  # [s] of a gyro by itself


def draw(design: Design, path: Path) -> Path:
    """One page of six panels."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(12.5, 7.4), layout="constrained")
        FigureCanvasAgg(figure)
        plan, errors = design.plan.manoeuvre, design.plan.errors
        title = f"{plan} at {design.budget.speed:.1f} m/s, fixes of {errors.fix:g} m/s at {1 / errors.fix_period:g} Hz"
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        panels = figure.subplots(2, 3)
        _side_slip(design, panels[0][0])
        _course(design, panels[0][1])
        _heading(design, panels[0][2])
        _over_time(design, panels[1][0])
        _shares(design, panels[1][1])
        _budget(design, panels[1][2])
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
    return path


def _side_slip(design: Design, panel: Axes) -> None:
    """Figure 4.49."""
    most = max(1.0, 1.3 * max(design.budget.parts["course of a fix"], design.budget.parts["heading"]))
    axis = np.linspace(0.0, most, 101)
    course, heading = np.meshgrid(axis, axis)
    levels = most * np.arange(0.1, 1.5, 0.1)
    lines = panel.contour(course, heading, np.hypot(course, heading), levels=levels, cmap="viridis", linewidths=1.0)
    panel.clabel(lines, fontsize=7, fmt="%.2g°")
    panel.plot(
        design.budget.parts["course of a fix"], design.budget.parts["heading"], "o", color=_MARK, label="this design"
    )
    panel.set(
        title="Side slip of a fix by course and heading", xlabel="course [°]", ylabel="heading [°]", aspect="equal"
    )
    panel.legend()


def _course(design: Design, panel: Axes) -> None:
    """Figure 4.50."""
    speed = np.geomspace(0.5, 50.0, 400)
    for (name, receiver), colour in zip(RECEIVERS.items(), _COLOURS, strict=True):
        panel.plot(speed, np.degrees(accuracy.course(receiver.velocity, speed)), color=colour, label=name)
    panel.plot(design.budget.speed, design.budget.parts["course of a fix"], "o", color=_MARK)
    panel.set(title="Course of a fix", xlabel="speed [m/s]", ylabel="[°]", xscale="log", yscale="log")
    panel.legend()


def _heading(design: Design, panel: Axes) -> None:
    """Figure 4.51."""
    time = np.linspace(0.0, max(_LONGEST, 1.2 * design.budget.turning), 200)
    own = [("this design", design.plan.errors.gyro)]
    for (name, gyro), colour in zip(
        [*((key, grade.gyro) for key, grade in GRADES.items()), *own], (*_COLOURS[:3], _MARK), strict=True
    ):
        line = "--" if name == "this design" else "-"
        panel.plot(time, np.degrees(accuracy.heading_by_gyro(time, gyro.noise, STEP)), line, color=colour, label=name)
    panel.axvline(design.budget.turning, color=MUTED, lw=0.8)
    panel.annotate(
        "longest turn",
        (design.budget.turning, 0.0),
        xytext=(4, 4),
        textcoords="offset points",
        color=MUTED,
        fontsize=7.5,
    )
    panel.set(title="Heading by the gyro alone, its bias known", xlabel="[s]", ylabel="[°]", ylim=(0, None))
    panel.legend(loc="upper left")


def _over_time(design: Design, panel: Axes) -> None:
    if not design.best:
        panel.set_axis_off()
        return
    one = design.filters[design.best]
    deviation = np.where(np.isfinite(one.deviation), one.deviation, np.nan)
    panel.fill_between(
        one.t, one.estimated - 2 * deviation, one.estimated + 2 * deviation, color=BAND, lw=0, label="2 σ stated"
    )
    panel.plot(one.t, one.estimated, color=ESTIMATE, label=design.best)
    panel.plot(one.t, one.true, color=TRUTH, lw=0.9, label="truth")
    if design.plan.outage is not None:
        panel.axvspan(*design.plan.outage, color="#f3e3d3", lw=0, zorder=0, label="no fixes")
    extent = float(np.ptp(one.true)) or 1.0
    panel.set(
        title="Side slip", xlabel="[s]", ylabel="[°]", ylim=(one.true.min() - extent / 2, one.true.max() + extent / 2)
    )
    panel.legend(fontsize=7, ncols=2)


def _shares(design: Design, panel: Axes) -> None:
    names = [name for name, one in design.filters.items() if one.side_slip is not None]
    for i, name in enumerate(names):
        slip = design.filters[name].side_slip
        assert slip is not None  # by the names
        for k, (what, value) in enumerate(
            (
                ("error", slip.rmse),
                ("of it by noise", slip.noise),
                ("by its model", slip.model),
                ("stated", slip.stated),
            )
        ):
            panel.barh(i + 0.2 * (k - 1.5), value, 0.18, color=_COLOURS[k], label=what if i == 0 else None)
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    panel.set(title="Side slip by filter, RMS", xlabel="[°]")
    if design.wanted is not None:
        panel.axvline(design.wanted, color=_MARK, lw=1.0, label="wanted")
    panel.legend(fontsize=7)


def _budget(design: Design, panel: Axes) -> None:
    parts = {**design.budget.parts, "together": design.budget.total}
    panel.barh(list(parts), list(parts.values()), 0.6, color=[ESTIMATE] * (len(parts) - 1) + [TRUTH])
    for i, value in enumerate(parts.values()):
        panel.annotate(f"{value:.2g}°", (value, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    panel.invert_yaxis()
    panel.set(title="Course less heading, by closed forms", xlabel="[°]")
    panel.margins(x=0.15)
