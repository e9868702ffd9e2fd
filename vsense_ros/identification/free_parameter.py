"""What a fit may change: one unknown, and the numbers of the car that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.parameter_set import ParameterSet, Values

Array = NDArray[np.float64]

Change = Callable[[Values, float], dict[str, float]]  # values by name, offset → the values that it changes


@dataclass(frozen=True)
class FreeParameter:
    """One unknown of a fit, as an offset from its nominal value: zero is what the vehicle file says.

    The prior of the offset is normal with zero mean and the standard deviation `deviation`.
    """

    name: str
    unit: str  # of the offset, its deviation and its bounds
    deviation: float
    low: float
    high: float
    apply: Change
    form: str = ""  # variant of the effect that it belongs to
    place: tuple[str, float] | None = None  # number that it changes at one place of the road alone, and abscissa [m]
    step: float = 0.0  # a likely offset, where that is not the deviation
    starts: tuple[float, ...] = (0.0,)  # offsets to begin a fit from; of all parameters the first, the second …

    @property
    def likely(self) -> float:
        """An offset that shows what the parameter does."""
        return self.step or self.deviation

    def names(self, values: Values) -> tuple[str, ...]:
        """Names of the numbers that it changes."""
        return tuple(self.apply(values, 0.0))

    def value(self, values: Values) -> float:
        """The first of the numbers that it changes."""
        return next(iter(self.apply(values, 0.0).values()))


def scaled(*names: str) -> Change:
    """Numbers that an offset makes larger by this share of themselves."""
    return lambda values, offset: {name: values[name] * (1 + offset) for name in names}


def multiplied(powers: Values) -> Change:
    """Numbers that an offset multiplies by exp(power · offset): they keep their sign, and one may grow as another
    falls. A name stands for all numbers below it (`sensors.imu.force_noise` for its three elements)."""

    def change(values: Values, offset: float) -> dict[str, float]:
        return {
            number: values[number] * float(np.exp(power * offset))
            for name, power in powers.items()
            for number in _below(values, name)
        }

    return change


def added(*names: str) -> Change:
    """Numbers that an offset is added to; those that are not there yet are zero."""
    return lambda values, offset: {name: values.get(name, 0.0) + offset for name in names}


def joined(free_parameters: Sequence[FreeParameter]) -> FreeParameter:
    """Several that are alike, as one that changes them all by the same offset."""

    def change(values: Values, offset: float) -> dict[str, float]:
        changed: dict[str, float] = {}
        for parameter in free_parameters:
            changed.update(parameter.apply({**values, **changed}, offset))
        return changed

    return replace(free_parameters[0], name=" + ".join(parameter.name for parameter in free_parameters), apply=change)


def _below(values: Values, name: str) -> Sequence[str]:
    """The number of a name, or all those below it. Raises `KeyError` if there is none."""
    numbers = [name] if name in values else [number for number in values if number.startswith(f"{name}.")]
    if not numbers:
        raise KeyError(f"there is no number {name}")
    return numbers


def with_offsets(
    start: ParameterSet, free_parameters: Sequence[FreeParameter], offsets: Array | Sequence[float]
) -> ParameterSet:
    """The parameter set with the offsets (k,) of all free parameters applied, one after the other."""
    for parameter, offset in zip(free_parameters, offsets, strict=True):
        start = start.changed(parameter.apply(start.values, float(offset)))
    return start
