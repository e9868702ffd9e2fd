"""Tyre models, one file each, with one interface.

A tyre is a pydantic class with its parameters and a function
`forces(p, load, speed_x, speed_y, rolling_speed, friction) -> (force_x, force_y, moment_z, slip_x, slip_y)`.
To add one: write its file, add it here.
"""

from vsense_ros.model.tyres import tmeasy
from vsense_ros.model.tyres.tmeasy import TMeasy

Tyre = TMeasy
FORCES = {"tmeasy": tmeasy.forces}

__all__ = ["FORCES", "TMeasy", "Tyre"]
