"""Straight code on scalars as a graph of values, each computed once: what all printers of C begin with."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from vsense_ros.codegen.instructions import instructions

INPUT, CONSTANT = -1, -2  # operations of values that nothing is computed for
COMMUTATIVE = frozenset((ca.OP_ADD, ca.OP_MUL, ca.OP_FMIN, ca.OP_FMAX, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR))
_LOGICAL = frozenset((ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR))
_UNARY_TWICE = frozenset((ca.OP_SQ, ca.OP_TWICE))  # CasADi lists their operand twice


@dataclass
class Values:
    """Values by number, each after its operands.

    `operations` are CasADi's numbers, or `INPUT` and `CONSTANT`; `operands` the numbers of values; `places` argument
    and element of an input; `constants` the numbers that are known. `results` lists (result, element, value).
    """

    operations: list[int] = field(default_factory=list)
    operands: list[tuple[int, ...]] = field(default_factory=list)
    places: dict[int, tuple[int, int]] = field(default_factory=dict)
    constants: dict[int, float] = field(default_factory=dict)
    results: list[tuple[int, int, int]] = field(default_factory=list)

    def computed(self, value: int) -> bool:
        """True if an operation computes a value."""
        return self.operations[value] >= 0

    def is_logical(self, value: int) -> bool:
        """True if a value can be nothing but 0 or 1."""
        return self.operations[value] in _LOGICAL


def values_of(function: ca.Function, known_values: Mapping[int, Sequence[float]] | None = None) -> Values:
    """The values of a function on scalars; arguments with `known_values`, by index, become constants, with no
    simplification. What divides several values is inverted once, and multiplies: a division takes as long as ten
    multiplications.

    Raises `ValueError` for a function that is not straight code on scalars.
    """
    if not function.is_a("SXFunction", False):
        raise ValueError(f"{function.name()} is not straight code on scalars; expand it first")
    known_values = known_values or {}
    values = Values()
    numbers: dict[tuple[object, ...], int] = {}
    present: dict[int, int] = {}  # what CasADi's variables hold

    def number(key: tuple[object, ...], operation: int, operands: tuple[int, ...] = ()) -> int:
        if key not in numbers:
            numbers[key] = len(values.operations)
            values.operations.append(operation)
            values.operands.append(operands)
        return numbers[key]

    divided = _divided(function)
    for instruction in instructions(function):
        operation, read, write = instruction.operation, instruction.read, instruction.write[0]
        if operation == ca.OP_OUTPUT:
            values.results.append((write, instruction.write[1], present[read[0]]))
        elif operation == ca.OP_ASSIGN:
            present[write] = present[read[0]]
        elif operation == ca.OP_INPUT and read[0] in known_values:
            value = number((INPUT, read), CONSTANT)
            values.constants[value] = float(known_values[read[0]][read[1]])
            present[write] = value
        elif operation == ca.OP_INPUT:
            value = number((INPUT, read), INPUT)
            values.places[value] = (read[0], read[1])
            present[write] = value
        elif operation == ca.OP_CONST:
            constant = instruction.constant
            value = number((CONSTANT, constant, math.copysign(1, constant)), CONSTANT)
            values.constants[value] = constant
            present[write] = value
        else:
            operands = tuple(present[k] for k in read[: 1 if operation in _UNARY_TWICE else None])
            if operation == ca.OP_DIV and divided[instruction.position] > 1:
                operation = ca.OP_MUL
                operands = operands[0], number((ca.OP_INV, operands[1:]), ca.OP_INV, operands[1:])
            order = tuple(sorted(operands)) if operation in COMMUTATIVE else operands
            present[write] = number((operation, order), operation, operands)
    return values


def _divided(function: ca.Function) -> dict[int, int]:
    """How many values the divisor of each division divides, by the index of the division."""
    makers: dict[int, int] = {}  # instructions that made what CasADi's variables hold
    divisors: dict[int, int] = {}
    for instruction in instructions(function):
        if instruction.operation == ca.OP_DIV:
            divisors[instruction.position] = makers[instruction.read[1]]
        if instruction.operation != ca.OP_OUTPUT:
            makers[instruction.write[0]] = instruction.position
    counts = Counter(divisors.values())
    return {i: counts[divisor] for i, divisor in divisors.items()}
