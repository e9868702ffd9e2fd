"""Frequency responses of handling models over speeds (Leung 2010, figures 3.11, 3.12 and D.1 to D.5)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from vsense_ros.evaluate.picture import MUTED
from vsense_ros.model.handling.response import Response

SPEEDS = tuple(range(10, 101, 10))  # [km/h]
FREQUENCIES = np.geomspace(0.1, 100, 300)  # [rad/s]
_LINES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1)))


def bode(
    responses: Mapping[str, Response],
    size: Axes,
    phase: Axes,
    speeds: tuple[int, ...] = SPEEDS,
    output: str = "lateral_velocity",
) -> None:
    """Magnitude and phase of lateral velocity over road-wheel angle at `speeds` [km/h]: colours are speeds, kinds of
    lines models."""
    shades = colormaps["viridis"](np.linspace(0.0, 0.92, len(speeds)))
    for (name, response), line in zip(responses.items(), _LINES, strict=False):
        for kph, colour in zip(speeds, shades, strict=True):
            gains = response.frequency_response(kph / 3.6, FREQUENCIES, output)
            label = f"{kph} km/h" if line == "-" else None
            size.plot(FREQUENCIES, np.abs(gains), color=colour, ls=line, lw=1.1, label=label)
            phase.plot(FREQUENCIES, np.degrees(np.unwrap(np.angle(gains))), color=colour, ls=line, lw=1.1)
        if name:
            phase.plot([], [], color=MUTED, ls=line, label=name)
    output_name = output.replace("_", " ").capitalize()
    size.set_title(f"{output_name} over road-wheel angle")
    size.set_ylabel("[m/s/rad]")
    size.set_yscale("log")
    size.legend(fontsize=6.5, ncols=2)
    phase.set_title("Its phase")
    phase.set_ylabel("[°]")
    if len(responses) > 1:
        phase.legend(fontsize=7)
    for panel in (size, phase):
        panel.set_xscale("log")
        panel.set_xlabel("frequency [rad/s]")
