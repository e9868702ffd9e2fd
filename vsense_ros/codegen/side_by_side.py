"""Operations that a function does alike for each of its four corners, found and put into the lanes of vectors.

A car's corners are computed by the same equations. Written out for each they are four times the code, and instructions
come one by one. Here values are compared from the results down: where four values, one of each corner, are made by the
same operation, one vector operation makes them, and its operands are looked at in the same way (packing of isomorphic
statements: Larsen & Amarasinghe 2000). What differs between corners stays scalar, and is put together where a vector
needs it. Nothing has to be alike for the result to be right, only for it to be fast.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from vsense_ros.codegen.values import COMMUTATIVE, CONSTANT, INPUT, Values

CORNERS = 4
Four = tuple[int, ...]  # a value of each corner

# What an element of an argument is, the same word for all corners, and whose it is, None if it is no corner's.
Alike = Callable[[str, int], tuple[Hashable, int | None]]


class Kind(Enum):
    """The way in which a vector is made."""

    OPERATION = "one operation on vectors"
    SAME = "one value in all lanes"
    CONSTANTS = "numbers"
    INPUTS = "elements of arguments"
    PERMUTED = "lanes of one other vector"
    GATHERED = "scalars"


class Step(NamedTuple):
    """The value that a statement makes: a vector, or a scalar."""

    vector: Four | None
    scalar: int = -1


@dataclass
class Packing:
    """Which values are computed in vectors; `operands` are those of vectors by operations, or what is permuted."""

    values: Values
    kinds: dict[Four, Kind] = field(default_factory=dict)
    operands: dict[Four, tuple[Four, ...]] = field(default_factory=dict)
    lanes: dict[int, tuple[Four, int]] = field(default_factory=dict)  # vector and lane of values that an operation made

    def needs(self, step: Step) -> Iterator[Step]:
        """The steps whose results a step uses."""
        if step.vector is None:
            if step.scalar in self.lanes:
                yield Step(self.lanes[step.scalar][0])
            else:
                yield from (Step(None, value) for value in self.values.operands[step.scalar])
            return
        kind = self.kinds[step.vector]
        if kind is Kind.SAME:
            yield Step(None, step.vector[0])
        elif kind is Kind.GATHERED:
            yield from (Step(None, value) for value in step.vector)
        else:
            yield from map(Step, self.operands.get(step.vector, ()))

    def is_at_hand(self, step: Step) -> bool:
        """True if it is read where it is needed, and nothing computes it."""
        if step.vector is None:
            return not self.values.computed(step.scalar)
        return self.kinds[step.vector] in (Kind.CONSTANTS, Kind.INPUTS)

    def in_order(self) -> list[Step]:
        """The steps to the results, each after what it needs. Raises `RecursionError` if some wait for each other."""
        order: list[Step] = []
        begun: dict[Step, bool] = {}  # and whether it is over
        stack = [Step(None, value) for _, _, value in reversed(self.values.results)]
        while stack:
            step = stack[-1]
            if step in begun:
                stack.pop()
                if not begun[step]:
                    begun[step] = True
                    order.append(step)
                continue
            begun[step] = False
            for need in reversed(list(self.needs(step))):
                if begun.get(need) is False:
                    raise RecursionError("vectors that wait for each other")
                if need not in begun:
                    stack.append(need)
        return order


def packed(values: Values, names: list[str], alike: Alike) -> Packing:
    """The values of the corners put into vectors; `names` are those of the arguments."""
    shapes, corners = _shapes(values, names, alike)
    packing = Packing(values)
    for seed in _seeds(values, shapes, corners):
        if not any(value in packing.lanes for value in seed):
            _pack(packing, seed, shapes)
    try:
        packing.in_order()
    except RecursionError:
        return Packing(values)
    return packing


def _shapes(values: Values, names: list[str], alike: Alike) -> tuple[list[int], list[int]]:
    """Two numbers for each value: one that is equal for expressions of equal form, and the corners that the value
    depends on, a bit for each."""
    shapes, corners = [0] * len(values.operations), [0] * len(values.operations)
    for i, operation in enumerate(values.operations):
        if operation == INPUT:
            argument, element = values.places[i]
            word, corner = alike(names[argument], element)
            shapes[i], corners[i] = hash((INPUT, word)), 0 if corner is None else 1 << corner
        elif operation == CONSTANT:
            shapes[i] = hash((CONSTANT,))
        else:
            below = [shapes[operand] for operand in values.operands[i]]
            shapes[i] = hash((operation, *(sorted(below) if operation in COMMUTATIVE else below)))
            for operand in values.operands[i]:
                corners[i] |= corners[operand]
    return shapes, corners


def _seeds(values: Values, shapes: list[int], corners: list[int]) -> list[Four]:
    """Values of the same form, one for each corner; those first that most depends on."""
    groups: dict[int, list[list[int]]] = defaultdict(lambda: [[] for _ in range(CORNERS)])
    corner_of_bit = {1 << corner: corner for corner in range(CORNERS)}
    for i, shape in enumerate(shapes):
        if values.computed(i) and corners[i] in corner_of_bit:
            groups[shape][corner_of_bit[corners[i]]].append(i)
    complete = (group for group in groups.values() if all(len(candidates) == 1 for candidates in group))
    return sorted((tuple(candidates[0] for candidates in group) for group in complete), key=max, reverse=True)


def _pack(packing: Packing, seed: Four, shapes: list[int]) -> None:
    """Put four values into a vector, and then what makes them."""
    stack = [seed]
    while stack:
        four = stack.pop()
        if four not in packing.kinds:
            packing.kinds[four] = kind = _kind(packing, four)
            if kind is Kind.PERMUTED:
                packing.operands[four] = (packing.lanes[four[0]][0],)
            elif kind is Kind.OPERATION:
                packing.lanes |= {value: (four, lane) for lane, value in enumerate(four)}
                packing.operands[four] = _operands(packing.values, four, shapes)
                stack += packing.operands[four]


def _kind(packing: Packing, four: Four) -> Kind:
    operations = {packing.values.operations[value] for value in four}
    if len(set(four)) == 1:
        return Kind.SAME
    if operations == {CONSTANT}:
        return Kind.CONSTANTS
    if operations == {INPUT}:
        return Kind.INPUTS
    if all(value in packing.lanes for value in four) and len({packing.lanes[value][0] for value in four}) == 1:
        return Kind.PERMUTED
    free = not any(value in packing.lanes for value in four)
    return Kind.OPERATION if free and len(operations) == 1 else Kind.GATHERED


def _operands(values: Values, four: Four, shapes: list[int]) -> tuple[Four, ...]:
    """The operands of a vector operation: where their order is free, such that the lanes are of one form."""
    first, *further = (values.operands[value] for value in four)
    lanes = [first]
    for following in further:
        swapped = following[::-1]
        free = values.operations[four[0]] in COMMUTATIVE
        fits = [shapes[i] for i in swapped] == [shapes[i] for i in first] != [shapes[i] for i in following]
        lanes.append(swapped if free and fits else following)
    return tuple(zip(*lanes, strict=True))
