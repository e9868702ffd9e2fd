"""A tyre rig as in Leung 2010 (section 3.3, figures 3.4 and 3.5): a plank is pulled away below a tyre that is held at a
slip angle, under its load, at three pressures; the lateral force is read over the way that the tyre has rolled.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vsense_ros.evaluate.picture import MUTED, STYLE
from vsense_ros.files.names import drawn
from vsense_ros.model.effects.tyre_underinflation import TyreUnderinflation
from vsense_ros.model.tyres import Tyre, TyreInput

Array = NDArray[np.float64]

ANGLES = (0.0, -2.0, -4.0, -6.0, -8.0)  # [°] at which the thesis holds its tyre
PRESSURES = (18.0, 20.0, 22.0)  # [psi]
NOMINAL_PRESSURE = 20.0  # [psi] at which the tyre is what its file says
TRAVEL = 1.0  # [m] of the plank
LOAD = 4000.0  # [N]
CONICITY = 0.02  # lateral force over load of a tyre that rolls straight
_SPEED = 5.0  # [m/s]: forces build up over a way, whatever the speed, but slip is blurred near standstill
_SHADES = ("#9ecae1", "#56B4E9", "#0072B2", "#08306b", "#000000")


@dataclass(frozen=True)
class TyreRig:
    """A tyre under a `load` [N], with a `conicity` (force to the left over load) and the pressure [psi]."""

    tyre: Tyre
    load: float = LOAD
    conicity: float = 0.0
    pressure: float = NOMINAL_PRESSURE

    def pull(self, angle: float, distance: Array) -> Array:
        """Lateral force (n,) [N] after ways (n,) [m] at a slip angle [rad] that begins with the first of them.

        The force follows its steady value over the relaxation length, which is a cornering stiffness over a lateral
        stiffness and so changes with the pressure as that does.
        """
        stiffness = self._stiffness()
        wheel = TyreInput(self.load, _SPEED, _SPEED * np.tan(angle) * stiffness, _SPEED)
        forces, length = self.tyre.forces(wheel).lateral, self.tyre.relaxation_lengths(wheel).lateral
        steady, rolled = (float(ca.DM(value)) for value in (forces, length))
        built_up = 1 - np.exp(-distance / (rolled * stiffness)) if rolled > 0 else np.ones(len(distance))
        return steady * built_up + self.conicity * self.load

    def settled(self, angles: Array) -> Array:
        """Lateral forces (n,) [N] at slip angles (n,) [rad] after a long way."""
        return np.array([self.pull(angle, np.array([1e3]))[0] for angle in angles.tolist()])

    def _stiffness(self) -> float:
        """Cornering stiffness over that at the nominal pressure, as the effect `tyre_underinflation` has it."""
        share = float(TyreUnderinflation.model_fields["cornering"].default)
        return 1 - share * (1 - self.pressure / NOMINAL_PRESSURE)


def draw_rig(tyre: Tyre, title: str, path: Path) -> Path:
    """Force over displacement (figure 3.4) and over slip angle at three pressures (figure 3.5)."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(
            f"{drawn(title)} on a rig, {LOAD / 1000:g} kN", x=0.01, ha="left", fontsize=12, fontweight="bold"
        )
        left, right = figure.subplots(1, 2)
        distance = np.linspace(0.0, TRAVEL, 400)
        rig = TyreRig(tyre, conicity=CONICITY)
        for angle, colour in zip(ANGLES, _SHADES, strict=True):
            left.plot(distance, rig.pull(np.radians(angle), distance), color=colour, label=f"{angle:g}°")
        left.set_title(f"Lateral force over displacement, conicity {CONICITY:g}")
        left.set_xlabel("displacement of the plank [m]")
        left.set_ylabel("[N]")
        left.legend(title="slip angle", title_fontsize=8)
        angles = np.linspace(-10, 10, 81)
        for pressure, colour in zip(PRESSURES, _SHADES[1:4], strict=True):
            force = TyreRig(tyre, conicity=CONICITY, pressure=pressure).settled(np.radians(angles))
            right.plot(angles, force, color=colour, label=f"{pressure:g} psi")
        right.set_title("Settled lateral force over slip angle")
        right.set_xlabel("slip angle [°]")
        right.axhline(0, color=MUTED, linewidth=0.6, zorder=0)
        right.axvline(0, color=MUTED, linewidth=0.6, zorder=0)
        right.legend()
        figure.savefig(path, dpi=90)
    return path
