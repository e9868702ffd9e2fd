"""One way to declare a number with a unit, and to turn a tree of them into a vector and back.

A vehicle file, its validation, its documentation and the symbols in the equations all come from these declarations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Model = TypeVar("Model", bound=BaseModel)
Triple: TypeAlias = tuple[float, float, float]
Scalar: TypeAlias = ca.SX | float  # a parameter in an equation: a number, or the symbol that `symbols` puts there


class Part(BaseModel):
    """What every part of a vehicle file is: unchangeable, without unknown keys, and with finite numbers alone."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def parameter(unit: str, description: str, **constraints: Any) -> Any:
    """A pydantic field for a physical quantity; `constraints` are pydantic's (gt, ge, lt, le, default …)."""
    return Field(description=description, json_schema_extra={"unit": unit}, **constraints)


def numbers(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Dotted names and values of all numeric fields, depth first in order of declaration."""
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from numbers(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            yield prefix + name, value


def units(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Dotted names, units and descriptions of `numbers`, in the same order."""
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from units(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            extra = field.json_schema_extra
            unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
            yield prefix + name, unit, field.description or ""


def vector(model: BaseModel) -> NDArray[np.float64]:
    """Values of `numbers`, (n,)."""
    return np.array([value for _, value in numbers(model)])


def symbols(model: Model, name: str = "p") -> tuple[ca.SX, Model]:
    """A symbolic vector in the order of `vector`, and a copy of `model` with its elements in place of the numbers.

    The copy keeps the type, so that a type checker knows its fields, and its methods, so that an equation that is
    written for numbers gives an expression; it is not validated.
    """
    p = ca.SX.sym(name, sum(1 for _ in numbers(model)))
    return p, _with_numbers(model, iter(ca.vertsplit(p)))


def with_expressions(model: Model, changes: Mapping[str, Scalar]) -> Model:
    """A copy in which the numbers with these dotted names are expressions, as in `symbols`; it is not validated."""
    return _with_numbers(model, (changes.get(name, value) for name, value in numbers(model)))


def _with_numbers(model: Model, values: Iterator[Scalar]) -> Model:
    """A copy in which the next of the `values` stand in place of the numbers, in the order of `numbers`."""
    fields: dict[str, Any] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            fields[name] = _with_numbers(value, values)
        else:
            fields[name] = next(values) if isinstance(value, float) else value
    return type(model).model_construct(**fields)


def with_values(model: Any, changes: dict[str, float]) -> Any:
    """A copy of `model` in which the fields with these dotted names have new values, validated again.

    Raises `KeyError` for a name that the model does not have.
    """
    present = dict(numbers(model))
    data = model.model_dump()
    for dotted, value in changes.items():
        if dotted not in present:
            raise KeyError(f"{dotted!r} is no parameter; known are {', '.join(present)}")
        *path, leaf = dotted.split(".")
        node = data
        for part in path:
            node = node[part]
        node[leaf] = float(value)
    return type(model).model_validate(data)
