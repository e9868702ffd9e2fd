"""The usual case of a CAN message, compiled once: from the bits of a frame to the values of all outputs in SI.

Nearly every frame has a value of every signal, and no other signal judges it. For these a function is written out with
the shift, mask, scale, bounds and conversion of each mapped signal as numbers, as a compiler of a DBC would write it in
C. Signals that nobody maps do not occur in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class UsualValue:
    """One value of an output: where its signal is in the data as one number, what it means, and what is usual.

    The physical value is raw × `scale` + `offset`, believed from `lowest` to `highest` and where the raw number is none
    of `codes`; that in SI is (`gain` × it + `addend`) / `divisor`, believed from `least` to `most` before the division.
    """

    big_endian: bool
    shift: int
    mask: int
    sign: int  # bit of the sign; 0 for none
    scale: float
    offset: float
    lowest: float
    highest: float
    gain: float
    addend: float
    least: float
    most: float
    divisor: float
    codes: frozenset[int] = frozenset()

    @property
    def raw_range(self) -> tuple[int, int]:
        """The least and the largest number that the bits can be."""
        return (-self.sign, self.sign - 1) if self.sign else (0, self.mask)

    @property
    def usual(self) -> tuple[int, int]:
        """The least and the largest raw number whose value is believed, the second less than the first for none: both
        conversions are monotonic, also as they are rounded, so that bounds of values are bounds of the bits."""
        first, last = self.raw_range
        for holds in (
            lambda value: value >= self.lowest,
            lambda value: value <= self.highest,
            lambda value: self.gain * value + self.addend >= self.least,
            lambda value: self.gain * value + self.addend <= self.most,
        ):
            begin, end = self._where(holds)
            first, last = max(first, begin), min(last, end)
        return first, last

    def _where(self, holds: Callable[[float], bool]) -> tuple[int, int]:
        """The raw numbers for whose values a bound holds, which are all up to one of them, or from it on."""
        least, most = self.raw_range
        at_least, at_most = (holds(raw * self.scale + self.offset) for raw in (least, most))
        if at_least == at_most:
            return (least, most) if at_least else (most, least - 1)
        low, high = least, most  # it holds for one of them
        while high - low > 1:
            middle = (low + high) // 2
            if holds(middle * self.scale + self.offset) == at_least:
                low = middle
            else:
                high = middle
        return (least, low) if at_least else (high, most)


Values = tuple[float, ...]
Usual = Callable[[bytes], tuple[Values, ...] | None]


def usual_values(outputs: Sequence[Sequence[UsualValue]], length: int) -> Usual:
    """What makes the values of all outputs from the data of a frame of at least `length` bytes: a tuple for each output
    in the order of its values, or None where one of them is not usual."""
    every = [value for output in outputs for value in output]
    known: dict[str, object] = {"from_bytes": int.from_bytes, "inf": math.inf, "nan": math.nan}
    known |= {f"codes{i}": value.codes for i, value in enumerate(every)}
    lines = ["def values(data):"]
    if any(value.big_endian for value in every):
        lines.append(f"    big = from_bytes(data[:{length}], 'big')")
    if not all(value.big_endian for value in every):
        lines.append("    little = from_bytes(data, 'little')")
    for i, value in enumerate(every):
        lines += [f"    {line}" for line in _lines_of(value, i)]
    numbers = iter(range(len(every)))
    made = ["".join(f"value{next(numbers)}, " for _ in output) for output in outputs]
    lines.append(f"    return ({''.join(f'({one}), ' for one in made)})")
    exec("\n".join(lines), known)  # numbers alone, none of the names in the database
    function: Usual = known["values"]  # type: ignore[assignment]
    return function


def _lines_of(value: UsualValue, i: int) -> list[str]:
    """How the value with this number follows from the data; `repr` of a number is that number to the last bit."""
    word = "big" if value.big_endian else "little"
    lines = [f"raw = {word} >> {value.shift} & {value.mask}" if value.shift else f"raw = {word} & {value.mask}"]
    if value.sign:
        lines.append(f"if raw & {value.sign}: raw -= {value.mask + 1}")
    first, last = value.usual
    unusual = [] if (first, last) == value.raw_range else [f"not {first} <= raw <= {last}"]
    unusual += [f"raw in codes{i}"] if any(first <= code <= last for code in value.codes) else []
    if unusual:
        lines.append(f"if {' or '.join(unusual)}: return None")
    si = f"raw * {value.scale!r} + {value.offset!r}"
    if (value.gain, value.addend) != (1.0, 0.0):
        si = f"({si}) * {value.gain!r} + {value.addend!r}"
    return [*lines, f"value{i} = {si}" if value.divisor == 1.0 else f"value{i} = ({si}) / {value.divisor!r}"]
