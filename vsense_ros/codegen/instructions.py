"""What a CasADi function does, instruction by instruction: the one walk that all printers of C share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca

from vsense_ros.codegen.forms import zeros

_OF_MATRICES = frozenset((ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CALL, ca.OP_MTIMES, ca.OP_HORZSPLIT))


class Instruction(NamedTuple):
    """One instruction of a function: which variables of CasADi's it reads and writes; of an input `read` is the
    argument and its element, of an output `write` the result and its element."""

    function: ca.Function
    position: int
    operation: int
    read: tuple[int, ...]
    write: tuple[int, ...]

    @property
    def matrix(self) -> ca.MX:
        """The expression that it computes, in a function of matrices."""
        return self.function.instruction_MX(self.position)

    @property
    def constant(self) -> float:
        """The number that it sets, in a function of scalars."""
        return float(self.function.instruction_constant(self.position))


def instructions(function: ca.Function) -> Iterator[Instruction]:
    """All instructions of a function, in order."""
    for i in range(function.n_instructions()):
        read, write = function.instruction_input(i), function.instruction_output(i)
        yield Instruction(function, i, function.instruction_id(i), tuple(read), tuple(write))


def multiplies(function: ca.Function, least_rows: int) -> bool:
    """True if a function is a sequence of calls and products of matrices, each with a dense one of at least
    `least_rows` on the left."""
    if not function.is_a("MXFunction", False):
        return False
    for instruction in instructions(function):
        if instruction.operation not in _OF_MATRICES:
            return False
        if instruction.operation == ca.OP_MTIMES:
            left = instruction.matrix.dep(1)
            if not left.is_dense() or left.size1() < least_rows or not instruction.matrix.is_dense():
                return False
        if instruction.operation == ca.OP_CONST and not instruction.matrix.is_zero():
            return False
    return True


class MatrixPrinter(ABC):
    """How a kind of C says what a function of matrices does. A matrix of zeros has the name ""."""

    @abstractmethod
    def argument(self, place: int) -> str:
        """Name of an argument of the function."""

    @abstractmethod
    def output(self, result: int, name: str, size: int) -> str:
        """Statement that copies a matrix with this many elements to a result of the function."""

    @abstractmethod
    def call(self, instruction: Instruction, arguments: Sequence[str], results: Sequence[str]) -> list[str]:
        """Statements that declare the results of another function, and call it."""

    @abstractmethod
    def product(self, matrix: ca.MX, begin: str, left: str, right: str, name: str) -> list[str]:
        """Statements for `name` = begin + left right, with a dense matrix on the left and one that may be sparse."""

    def statements(self, function: ca.Function) -> list[str]:
        """The body of a function that `multiplies`."""
        lines: list[str] = []
        names: dict[int, str] = {}  # of what CasADi's variables hold
        for instruction in instructions(function):
            results = [f"m{instruction.position}_{k}" for k in range(len(instruction.write))]
            operands = [names[k] for k in instruction.read] if instruction.operation != ca.OP_INPUT else []
            if instruction.operation == ca.OP_OUTPUT:
                lines.append(self.output(instruction.write[0], operands[0], function.nnz_out(instruction.write[0])))
                continue
            if instruction.operation == ca.OP_INPUT:
                results = [self.argument(instruction.read[0])]
            elif instruction.operation == ca.OP_CONST:
                results = [""]
            elif instruction.operation == ca.OP_HORZSPLIT:
                sizes = [instruction.matrix.get_output(k).nnz() for k in range(len(results))]
                split_vector = operands[0] or zeros(sum(sizes))
                results = [f"({split_vector} + {sum(sizes[:k])})" for k in range(len(sizes))]
            elif instruction.operation == ca.OP_CALL:
                lines += self.call(instruction, operands, results)
            else:
                begin, left, right = operands
                left, right = (name or zeros(instruction.matrix.dep(k).nnz()) for k, name in ((1, left), (2, right)))
                lines += self.product(instruction.matrix, begin, left, right, results[0])
            names |= dict(zip(instruction.write, results, strict=True))
        return lines
