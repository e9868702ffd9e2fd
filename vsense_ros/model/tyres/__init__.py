"""Tyre models, one file each, with one interface.

A tyre is a pydantic class with its parameters, among them `standstill_speed`, and two functions:
`forces(p, load, speed_x, speed_y, rolling_speed, friction) -> (force_x, force_y, moment_z, slip_x, slip_y)`, and
`steepest_slope(p, load)`, the largest slope of the longitudinal force, which keeps time steps stable.
To add one: write its file, add it here.
"""

from vsense_ros.model.tyres import tmeasy
from vsense_ros.model.tyres.tmeasy import TMeasy

Tyre = TMeasy
FORCES = {"tmeasy": tmeasy.forces}
STEEPEST_SLOPES = {"tmeasy": tmeasy.steepest_slope}

__all__ = ["FORCES", "STEEPEST_SLOPES", "TMeasy", "Tyre"]
