"""Physical effects that a model may have or lack, one file each.

A vehicle file lists those that its car has below `physics: effects:`, by id, with their parameters; every effect with
zero size changes nothing. `Effect` (base.py) says where effects enter the equations. To add one, write its file, with
the name of its id.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from pydantic import Field, create_model

from vsense_ros.model.effects.base import Effect
from vsense_ros.model.parameter import Part


def _every() -> Iterator[type[Effect]]:
    """The effects that the modules of this folder define, in the order of their names; of a class and those that are
    made of it, the last."""
    for module in iter_modules(__path__):
        values = vars(import_module(f"{__name__}.{module.name}")).values()
        classes = [value for value in values if isinstance(value, type) and issubclass(value, Effect)]
        yield from [kind for kind in classes if getattr(kind, "id", "") == module.name][-1:]


EVERY = {effect.id: effect for effect in _every()}
BY_ID = {id: effect for id, effect in EVERY.items() if effect.known}  # the library: physics that has a name


class _Effects(Part):
    """Effects of a car, its road and its sensors by id; those left out are absent."""

    def present(self) -> tuple[Effect, ...]:
        """The effects that the file lists, whatever their size."""
        return tuple(value for name in type(self).model_fields if (value := getattr(self, name)) is not None)


if TYPE_CHECKING:
    Effects = _Effects
else:
    Effects = create_model(
        "Effects",
        __base__=_Effects,
        **{id: (effect | None, Field(default=None, description=effect.sentence)) for id, effect in EVERY.items()},
    )

__all__ = ["BY_ID", "EVERY", "Effect", "Effects"]
