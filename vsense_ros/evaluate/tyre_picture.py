"""One picture of a tyre: what it does along, across and in between, at several loads, and how it lags."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vsense_ros.evaluate.picture import MUTED, STYLE
from vsense_ros.files.names import drawn
from vsense_ros.model.parameter import symbols, vector
from vsense_ros.model.tyres import Tyre, TyreInput, relaxation_rate

Array = NDArray[np.float64]

LOADS = (2000.0, 4000.0, 6000.0, 8000.0)  # [N]
NOMINAL = 4000.0  # [N] of the panels that show one load
SPEED = 20.0  # [m/s]
ANGLES = (0.0, 2.0, 4.0, 8.0)  # [°] slip angles of the combined panels
CAMBERS = (-6.0, -3.0, 0.0, 3.0, 6.0)  # [°]
SHADES = ("#9ecae1", "#56B4E9", "#0072B2", "#08306b", "#000000")


class Curves(NamedTuple):
    """Forces and aligning moment of a tyre over n states, (n,) each."""

    longitudinal: Array  # force [N]
    lateral: Array  # force [N]
    moment: Array  # [N m]


class Bench:
    """A tyre on a bench that rolls it at `SPEED` and sets its slips."""

    def __init__(self, tyre: Tyre) -> None:
        self.tyre = tyre
        p, symbolic = symbols(tyre)
        state = ca.SX.sym("state", 6)
        wheel = TyreInput(*ca.vertsplit(state))
        self._forces = ca.Function("forces", [p, state], [ca.vertcat(*symbolic.forces(wheel))])
        self._length = ca.Function("length", [p, state], [ca.SX(symbolic.relaxation_lengths(wheel).lateral)])
        self._p = vector(tyre)

    def _state(self, load: Array, slip: Array, angle: Array, camber: Array) -> Array:
        """Driven and braked by its spin; `angle` [rad] is the slip angle of ISO 8855, positive to the left."""
        load, slip, angle, camber = np.broadcast_arrays(*(np.atleast_1d(x) for x in (load, slip, angle, camber)))
        ones = np.ones(load.shape)
        return np.array([load, SPEED * ones, SPEED * np.tan(angle), SPEED * (1 + slip), ones, camber])

    def forces(self, load: Any, slip: Any = 0.0, angle: Any = 0.0, camber: Any = 0.0) -> Curves:
        """Forces and aligning moment of the tyre."""
        state = self._state(load, slip, angle, camber)
        longitudinal, lateral, moment, *_ = np.asarray(self._forces.map(state.shape[1])(self._p, state))
        return Curves(longitudinal, lateral, moment)

    def relaxation(self, load: Any, angle: Any = 0.0) -> Array:
        """Relaxation length of the lateral force [m], (n,)."""
        state = self._state(load, np.zeros(1), angle, np.zeros(1))
        return np.asarray(self._length.map(state.shape[1])(self._p, np.asarray(state)))[0]


def draw(tyre: Tyre, title: str, path: Path) -> Path:
    """Write the picture of a tyre; the format is that of the file's name."""
    bench = Bench(tyre)
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(11, 9.2), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(3, 3)
        figure.suptitle(drawn(title), x=0.01, ha="left", fontsize=12, fontweight="bold")
        _pure(bench, panels[0])
        _combined(bench, panels[1])
        _rest(bench, panels[2])
        figure.savefig(path, dpi=80)
    return path


def _label(panel: Axes, title: str, x: str, y: str, legend: str = "") -> None:
    panel.set_title(title)
    panel.set_xlabel(x)
    panel.set_ylabel(y)
    panel.axhline(0, color=MUTED, linewidth=0.6, zorder=0)
    if legend:
        panel.legend(title=legend, fontsize=7, title_fontsize=7, handlelength=1.2)


def _pure(bench: Bench, panels: Any) -> None:
    slips, degrees = np.linspace(-0.4, 0.4, 321), np.linspace(-15, 15, 301)
    for load, colour in zip(LOADS, SHADES, strict=False):
        name = f"{load / 1000:g} kN"
        panels[0].plot(slips, bench.forces(load, slips).longitudinal / 1000, color=colour, label=name)
        _, lateral, moment = bench.forces(load, 0.0, np.radians(degrees))
        panels[1].plot(degrees, lateral / 1000, color=colour, label=name)
        panels[2].plot(degrees, moment, color=colour, label=name)
    _label(panels[0], "Longitudinal force", "longitudinal slip", "kN", "load")
    _label(panels[1], "Lateral force", "slip angle [°]", "kN", "load")
    _label(panels[2], "Aligning moment", "slip angle [°]", "N m", "load")


def _combined(bench: Bench, panels: Any) -> None:
    slips = np.concatenate([-np.geomspace(1, 1e-3, 200), np.geomspace(1e-3, 1, 200)])
    for degrees, colour in zip(ANGLES, SHADES, strict=False):
        forces = bench.forces(NOMINAL, slips, -np.radians(degrees))
        longitudinal, lateral = forces.longitudinal / 1000, forces.lateral / 1000
        name = f"{-degrees:g}°" if degrees else "0°"
        shown = np.abs(slips) <= 0.4
        panels[0].plot(slips[shown], longitudinal[shown], color=colour, label=name)
        panels[1].plot(slips[shown], lateral[shown], color=colour, label=name)
        panels[2].plot(longitudinal, lateral, color=colour, label=name)
    for slip in (-0.1, -0.03, 0.03, 0.1):
        forces = bench.forces(NOMINAL, slip, np.radians(np.linspace(-20, 20, 200)))
        panels[2].plot(forces.longitudinal / 1000, forces.lateral / 1000, color="#E69F00", linewidth=0.7)
    _label(panels[0], "Longitudinal force while cornering, 4 kN", "longitudinal slip", "kN", "slip angle")
    _label(panels[1], "Lateral force while driving, 4 kN", "longitudinal slip", "kN", "slip angle")
    _label(panels[2], "Friction ellipse, 4 kN", "longitudinal force [kN]", "lateral force [kN]")
    panels[2].plot([], [], color="#E69F00", linewidth=0.7, label="slip ±0.03, ±0.1")
    panels[2].legend(fontsize=7)
    panels[2].set_aspect("equal", adjustable="datalim")


def _rest(bench: Bench, panels: Any) -> None:
    loads, tiny = np.linspace(100, 9000, 120), 1e-4
    slope_x = (bench.forces(loads, tiny).longitudinal - bench.forces(loads, -tiny).longitudinal) / (2 * tiny)
    slope_y = (bench.forces(loads, 0.0, -tiny).lateral - bench.forces(loads, 0.0, tiny).lateral) / (2 * tiny)
    panels[0].plot(loads / 1000, slope_x / 1000, color=SHADES[2], label="longitudinal [kN]")
    panels[0].plot(loads / 1000, slope_y / 1000, color="#D55E00", label="lateral [kN/rad]")
    _label(panels[0], "Slope at zero slip", "load [kN]", "")
    panels[0].legend(fontsize=7)
    panels[0].set_ylim(bottom=0)

    degrees = np.linspace(-8, 8, 161)
    for camber, colour in zip(CAMBERS, SHADES, strict=True):
        lateral = bench.forces(NOMINAL, 0.0, np.radians(degrees), np.radians(camber)).lateral
        panels[1].plot(degrees, lateral / 1000, color=colour, label=f"{camber:g}°")
    _label(panels[1], "Lateral force of a leaning wheel, 4 kN", "slip angle [°]", "kN", "inclination")

    time = np.linspace(0, 0.15, 300)
    for step, colour in ((-1.0, SHADES[1]), (-4.0, SHADES[2]), (-8.0, SHADES[3])):
        angle = np.radians(step)
        length = bench.relaxation(NOMINAL, angle).item()
        rate = float(relaxation_rate(length, SPEED, bench.tyre.standstill_speed))
        before, after = (bench.forces(NOMINAL, 0.0, a).lateral.item() / 1000 for a in (0.0, angle))
        rising = after + (before - after) * np.exp(-rate * time)
        panels[2].plot(time, rising, color=colour, label=f"to {step:g}°: {length:.2f} m")
    _label(panels[2], "Step of the slip angle at 20 m/s, 4 kN", "time [s]", "lateral force [kN]", "relaxation length")
