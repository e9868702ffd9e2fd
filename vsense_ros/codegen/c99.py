"""CasADi expressions as C99 functions with plain arguments, for compilers and readers that know nothing of CasADi.

CasADi's own generator is made for functions that CasADi loads again: 64-bit integers, arrays of pointers, a dozen
functions that describe each function. Here a function is what an engineer would write: pointers in, pointers out.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Container, Sequence

import casadi as ca

from vsense_ros import codegen
from vsense_ros.codegen import native
from vsense_ros.codegen.corner_loops import CornerLoops
from vsense_ros.codegen.forms import SCALAR, zeros
from vsense_ros.codegen.instructions import Instruction, MatrixPrinter, instructions, multiplies
from vsense_ros.codegen.side_by_side import Packing, packed
from vsense_ros.codegen.values import values_of

# Floating-point numbers are not compared by == and !=, as coding standards ask. NaN differs from all, as by these. What
# is true is a number, which a comparison in C is not.
_OPERATIONS = SCALAR | {
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SIGN: "{0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : 0.0",
    ca.OP_LT: "{0} < {1} ? 1.0 : 0.0",
    ca.OP_LE: "{0} <= {1} ? 1.0 : 0.0",
    ca.OP_EQ: "{0} <= {1} && {0} >= {1} ? 1.0 : 0.0",
    ca.OP_NE: "{0} <= {1} && {0} >= {1} ? 0.0 : 1.0",
    ca.OP_IF_ELSE_ZERO: "{0} <= 0.0 && {0} >= 0.0 ? 0.0 : {1}",
    ca.OP_NOT: "{0} <= 0.0 && {0} >= 0.0 ? 1.0 : 0.0",
    ca.OP_AND: "({0} <= 0.0 && {0} >= 0.0) || ({1} <= 0.0 && {1} >= 0.0) ? 0.0 : 1.0",
    ca.OP_OR: "{0} <= 0.0 && {0} >= 0.0 && {1} <= 0.0 && {1} >= 0.0 ? 0.0 : 1.0",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})"
        for name in ("asinh", "acosh", "atanh", "floor", "ceil", "erf", "log1p", "expm1")
    },
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}}, {{1}})"
        for name in ("fmin", "fmax", "fmod", "copysign", "hypot")
    },
}


_KNOWN = "known"  # in the place of an argument that is known, and so is none of the function in C


def wrapped(text: str, indent: str = "") -> str:
    """A line of C as several of at most 120 characters; the first begins where it is put, behind `indent`."""
    lines = textwrap.wrap(text, 120, initial_indent=indent, subsequent_indent=indent + "    ")
    return "\n".join(lines).removeprefix(indent)


def c_function(
    function: ca.Function, results: Sequence[str], name: str = "", corners: native.Corners | None = None
) -> str:
    """A static C99 function that does what `function` does, with its name if none is given; its arguments and then
    `results` name its parameters. If it multiplies matrices which other functions make, those come before it. With
    `corners` it does in loops what is alike for them, and their known arguments are left out.

    Matrices are column-major and have the elements that CasADi stores. Raises `NotImplementedError` for an operation
    that C's library lacks.
    """
    operations = {instruction.operation for instruction in instructions(function)}
    if ca.OP_MTIMES in operations and multiplies(function, 1):
        return _matrices(function, results, name or function.name(), corners)
    return _scalars(function, results, name or function.name(), corners)


def _scalars(function: ca.Function, results: Sequence[str], name: str, corners: native.Corners | None) -> str:
    """A function of scalars, with loops over the corners if it has some."""
    plain = codegen.expanded(function)
    arguments = [plain.name_in(i) for i in range(plain.n_in())]
    known_values = {} if corners is None else corners.known_of(plain)
    values = values_of(plain, known_values)
    packing = Packing(values) if corners is None else packed(values, arguments, corners.alike)
    text = CornerLoops(packing, arguments, results, _form)
    body = text.statements()
    unused = [f"(void){word};" for i, word in enumerate(arguments) if i not in text.read and i not in known_values]
    unused += [f"(void){word};" for i, word in enumerate(results) if not plain.nnz_out(i)]
    return _written(function, results, name, [*unused, *body], known_values)


def _form(operation: int, logical: bool) -> str:
    """What C says for an operation of CasADi, whose first operand is 0 or 1 if it is `logical`."""
    if logical and operation == ca.OP_IF_ELSE_ZERO:
        return "{0} > 0.0 ? {1} : 0.0"
    if logical and operation == ca.OP_NOT:
        return "1.0 - {0}"
    if operation not in _OPERATIONS:
        raise NotImplementedError(f"CasADi operation {operation} has no counterpart in C99 here")
    return _OPERATIONS[operation]


def _written(
    function: ca.Function, results: Sequence[str], name: str, body: Sequence[str], known_arguments: Container[int] = ()
) -> str:
    """The text of a function with these statements, and without `known_arguments`."""
    arguments = {i: function.name_in(i) for i in range(function.n_in()) if i not in known_arguments}
    parameters = [f"const double *{argument}" for argument in arguments.values()]
    parameters += [f"double *{result}" for result in results]
    shapes = [f"{argument}[{function.nnz_in(i)}]" for i, argument in arguments.items()]
    result_shapes = [_shape(result, function.sparsity_out(i)) for i, result in enumerate(results)]
    lines = [
        wrapped(f"/* {', '.join(shapes)} -> {', '.join(result_shapes)} */"),
        wrapped(f"static void {name}({', '.join(parameters)}) {{"),
        *(wrapped(f"    {line}") for line in body),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _shape(name: str, sparsity: ca.Sparsity) -> str:
    rows, columns = sparsity.shape
    if not sparsity.is_dense():
        return f"{name}[{sparsity.nnz()} of {rows} x {columns}]"
    return f"{name}[{rows}]" if columns == 1 else f"{name}[{rows} x {columns}]"


class _Matrices(MatrixPrinter):
    """Function calls with plain arguments, and products as loops; the functions that are called stand in `before`."""

    def __init__(
        self, function: ca.Function, results: Sequence[str], name: str, corners: native.Corners | None
    ) -> None:
        self._function, self._results, self._name, self._corners = function, results, name, corners
        self.known = {} if corners is None else corners.known_of(function)
        self.before: list[str] = []

    def argument(self, place: int) -> str:
        """The parameter of this place; one that is known is none."""
        return _KNOWN if place in self.known else str(self._function.name_in(place))

    def output(self, result: int, name: str, size: int) -> str:
        """Statements that copy a value to a result, element by element."""
        return f"for (int i = 0; i < {size}; i++) {self._results[result]}[i] = {f'{name}[i]' if name else '0'};"

    def call(self, instruction: Instruction, arguments: Sequence[str], results: Sequence[str]) -> list[str]:
        """The results, and a call with all that is not known."""
        called, name = instruction.matrix.which_function(), f"{self._name}_{instruction.position}"
        outs = [called.name_out(k) for k in range(called.n_out())]
        self.before.append(c_function(called, outs, name, self._corners))
        unknown_arguments = [
            argument or zeros(called.nnz_in(k)) for k, argument in enumerate(arguments) if argument != _KNOWN
        ]
        return [
            *(f"double {result}[{max(called.nnz_out(k), 1)}];" for k, result in enumerate(results)),
            f"{name}({', '.join([*unknown_arguments, *results])});",
        ]

    def product(self, matrix: ca.MX, begin: str, left: str, right: str, name: str) -> list[str]:
        """Column by column, in plain loops."""
        rows, columns = matrix.shape
        sparsity = matrix.dep(2).sparsity()
        first = f"{begin}[{rows} * j + i]" if begin else "0"
        if sparsity.is_dense():
            terms = sparsity.size1()
            return [
                f"double {name}[{rows * columns}];",
                f"for (int j = 0; j < {columns}; j++)",
                f"for (int i = 0; i < {rows}; i++) {{",
                f"double sum = {first};",
                f"for (int k = 0; k < {terms}; k++) sum += {left}[{rows} * k + i] * {right}[{terms} * j + k];",
                f"{name}[{rows} * j + i] = sum;",
                "}",
            ]
        return [
            f"static const short {name}_ends[] = {{{', '.join(map(str, sparsity.colind()))}}};",
            f"static const short {name}_rows[] = {{{', '.join(map(str, sparsity.row()))}}};",
            f"double {name}[{rows * columns}];",
            f"for (int j = 0; j < {columns}; j++) {{",
            f"double sum[{rows}];",
            f"for (int i = 0; i < {rows}; i++) sum[i] = {first};",
            f"for (int k = {name}_ends[j]; k < {name}_ends[j + 1]; k++)",
            f"    for (int i = 0; i < {rows}; i++) sum[i] += {left}[{rows} * {name}_rows[k] + i] * {right}[k];",
            f"for (int i = 0; i < {rows}; i++) {name}[{rows} * j + i] = sum[i];",
            "}",
        ]


def _matrices(function: ca.Function, results: Sequence[str], name: str, corners: native.Corners | None) -> str:
    """A function that calls others and multiplies what they make."""
    printer = _Matrices(function, results, name, corners)
    body, known_arguments = printer.statements(function), printer.known
    words = {word for line in body for word in re.findall(r"\w+", line)}
    unused = (
        function.name_in(i)
        for i in range(function.n_in())
        if i not in known_arguments and function.name_in(i) not in words
    )
    text = _written(function, results, name, [*body, *(f"(void){word};" for word in unused)], known_arguments)
    return "\n".join([*printer.before, text])
