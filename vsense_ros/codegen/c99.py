"""CasADi expressions as C99 functions with plain arguments, for compilers and readers that know nothing of CasADi.

CasADi's own generator is made for functions that CasADi loads again: 64-bit integers, arrays of pointers, a dozen
functions that describe each function. Here a function is what an engineer would write: pointers in, pointers out.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import casadi as ca

from vsense_ros import codegen

_OPERATIONS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_INV: "1 / {0}",
    ca.OP_SIGN: "({0} > 0) - ({0} < 0)",
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "!{0}",
    ca.OP_AND: "{0} && {1}",
    ca.OP_OR: "{0} || {1}",
    ca.OP_IF_ELSE_ZERO: "{0} != 0 ? {1} : 0",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_FABS: "fabs({0})",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})"
        for name in (
            *("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
            *("asinh", "acosh", "atanh", "floor", "ceil", "erf", "log1p", "expm1"),
        )
    },
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}}, {{1}})"
        for name in ("fmin", "fmax", "fmod", "copysign", "atan2", "hypot")
    },
}


def number(value: float) -> str:
    """A number as C reads it back, to the last bit."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def wrapped(text: str, indent: str = "") -> str:
    """A line of C as several of at most 120 characters; the first begins where it is put, behind `indent`."""
    lines = textwrap.wrap(text, 120, initial_indent=indent, subsequent_indent=indent + "    ")
    return "\n".join(lines).removeprefix(indent)


def c_function(function: ca.Function, results: Sequence[str]) -> str:
    """A static C99 function that does what `function` does; its arguments and then `results` name its parameters.

    Matrices are column-major, results dense. Raises `NotImplementedError` for an operation that C's library lacks.
    """
    f = codegen.expanded(function)
    arguments = [f.name_in(i) for i in range(f.n_in())]
    body: list[str] = []
    used: set[int] = set()
    for k in range(f.n_instructions()):
        operation, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            body.append(f"{results[outputs[0]]}[{outputs[1]}] = w{inputs[0]};")
        elif operation == ca.OP_CONST:
            body.append(f"w{outputs[0]} = {number(f.instruction_constant(k))};")
        elif operation == ca.OP_INPUT:
            used.add(inputs[0])
            body.append(f"w{outputs[0]} = {arguments[inputs[0]]}[{inputs[1]}];")
        elif operation in _OPERATIONS:
            expression = _OPERATIONS[operation].format(*(f"w{i}" for i in inputs))
            body.append(f"w{outputs[0]} = {expression};")
        else:
            raise NotImplementedError(f"{f.name()}: CasADi operation {operation} has no counterpart in C99 here")
    parameters = [f"const double *{name}" for name in arguments] + [f"double *{name}" for name in results]
    shapes = [f"{name}[{function.nnz_in(i)}]" for i, name in enumerate(arguments)]
    made = [
        f"{name}[{rows}]" if columns == 1 else f"{name}[{rows} x {columns}]"
        for name, (rows, columns) in zip(results, (function.size_out(i) for i in range(f.n_out())), strict=True)
    ]
    work = [f"w{i}" for i in range(f.sz_w())]
    lines = [
        wrapped(f"/* {', '.join(shapes)} -> {', '.join(made)} */"),
        wrapped(f"static void {f.name()}({', '.join(parameters)}) {{"),
        *(f"    double {', '.join(work[i : i + 16])};" for i in range(0, len(work), 16)),
        *(f"    (void){name};" for i, name in enumerate(arguments) if i not in used),
        *(f"    {line}" for line in body),
        "}",
    ]
    return "\n".join(lines) + "\n"
