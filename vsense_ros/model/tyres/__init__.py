"""Tyre models, one file each, with one interface.

A tyre is a pydantic class with its parameters, among them `standstill_speed`, and functions of the same names in every
file. `p` is a tyre or a namespace of symbols shaped like one:

`forces(p, load, speed_x, speed_y, rolling_speed, friction, camber=0, side=1)` gives longitudinal force, lateral force
[N], aligning moment [N m], longitudinal slip and lateral slip [-] in the axes of the contact patch. `load` is the wheel
load [N]; `speed_x`, `speed_y` the velocity of the contact point, `rolling_speed` effective radius times spin [m/s];
`friction` scales the road's grip, 1 being the road the tyre was measured on; `camber` is the inclination angle [rad],
positive where the top leans to the right (ISO 8855); `side` is 1 for a wheel on the left of the car, -1 on the right.

`relaxation_lengths(p, …)` takes the same and gives the distances [m] over which the longitudinal and the lateral force
build up. A model that has the forces among its states lets them follow with `relaxation_rate`; others leave it out.

`steepest_slope(p, load)` is the largest slope of the longitudinal force [N], which keeps time steps stable;
`cornering_stiffness(p, load)` the slope of the lateral force at zero slip [N/rad].

To add one: write its file, add it here.
"""

from typing import Annotated

from pydantic import Field

from vsense_ros.model.tyres import fiala, linear, magic_formula, similarity, tmeasy
from vsense_ros.model.tyres.fiala import Fiala
from vsense_ros.model.tyres.linear import Linear
from vsense_ros.model.tyres.magic_formula import MagicFormula
from vsense_ros.model.tyres.similarity import Similarity
from vsense_ros.model.tyres.slip import relaxation_rate
from vsense_ros.model.tyres.tmeasy import TMeasy

Tyre = Annotated[TMeasy | MagicFormula | Similarity | Fiala | Linear, Field(discriminator="model")]

_FILES = {
    "tmeasy": tmeasy,
    "magic_formula": magic_formula,
    "similarity": similarity,
    "fiala": fiala,
    "linear": linear,
}
FORCES = {name: file.forces for name, file in _FILES.items()}
RELAXATION_LENGTHS = {name: file.relaxation_lengths for name, file in _FILES.items()}
STEEPEST_SLOPES = {name: file.steepest_slope for name, file in _FILES.items()}
CORNERING_STIFFNESSES = {name: file.cornering_stiffness for name, file in _FILES.items()}

__all__ = [
    "CORNERING_STIFFNESSES",
    "FORCES",
    "RELAXATION_LENGTHS",
    "STEEPEST_SLOPES",
    "Fiala",
    "Linear",
    "MagicFormula",
    "Similarity",
    "TMeasy",
    "Tyre",
    "relaxation_rate",
]
