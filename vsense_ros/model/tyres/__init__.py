"""Tyre models, one file each.

A tyre model is a class with its parameters and its equations (`Tyre`, base.py). To add one, write its file: it is found
in this folder by the value of its key `model`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from importlib import import_module
from inspect import isabstract
from operator import or_
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated, get_args

from pydantic import Field

from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.fiala import Fiala
from vsense_ros.model.tyres.linear import Linear
from vsense_ros.model.tyres.magic_formula import MagicFormula
from vsense_ros.model.tyres.similarity import Similarity
from vsense_ros.model.tyres.slip import relaxation_rate
from vsense_ros.model.tyres.tmeasy import TMeasy


def _every() -> Iterator[type[Tyre]]:
    """The tyres that the modules of this folder define, in the order of the files' names."""
    for module in (import_module(f"{__name__}.{entry.name}") for entry in iter_modules(__path__)):
        for value in vars(module).values():
            defined_here = isinstance(value, type) and value.__module__ == module.__name__
            if defined_here and issubclass(value, Tyre) and not isabstract(value):
                yield value


MODELS = {str(get_args(tyre.model_fields["model"].annotation)[0]): tyre for tyre in _every()}

if TYPE_CHECKING:
    AnyTyre = Tyre
else:
    AnyTyre = Annotated[reduce(or_, MODELS.values()), Field(discriminator="model")]

__all__ = [
    "MODELS",
    "AnyTyre",
    "Fiala",
    "Linear",
    "MagicFormula",
    "RelaxationLengths",
    "Similarity",
    "TMeasy",
    "Tyre",
    "TyreForces",
    "TyreInput",
    "relaxation_rate",
]
