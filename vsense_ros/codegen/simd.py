"""CasADi functions as C for several cars side by side, each in a lane of the processor's vectors.

A car's equations are thousands of scalar operations: one car alone uses a quarter or an eighth of what a vector unit
does with one instruction. Several runs, with inputs of their own, fill it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import casadi as ca

# What C has to say for an operation of CasADi's.
_OPERATIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_INV: "1 / {0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}",
    ca.OP_FABS: "size_of({0})", ca.OP_SIGN: "sign_of({0})", ca.OP_FMIN: "smaller({0}, {1})",
    ca.OP_FMAX: "greater({0}, {1})", ca.OP_LT: "one_where({0} < {1})", ca.OP_LE: "one_where({0} <= {1})",
    ca.OP_EQ: "one_where({0} == {1})", ca.OP_NE: "one_where({0} != {1})", ca.OP_NOT: "one_where({0} == 0)",
    ca.OP_AND: "one_where(({0} != 0) & ({1} != 0))", ca.OP_OR: "one_where(({0} != 0) | ({1} != 0))",
    ca.OP_IF_ELSE_ZERO: "zero_unless({0} != 0, {1})",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"lanes_{name}({{0}})"
        for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log")
    },
    ca.OP_ATAN2: "lanes_atan2({0}, {1})", ca.OP_POW: "lanes_pow({0}, {1})", ca.OP_CONSTPOW: "lanes_pow({0}, {1})",
}  # fmt: skip
# Statements in one C function: compilers take more than twice the time for twice as many.
PART = 500


def source(functions: Sequence[ca.Function]) -> str:
    """C of the functions, each as `static void name(const lanes *const *in, lanes *const *out, lanes *work)`, with
    dense arguments and results, one element of all lanes after the other, and the number of `lanes` that `work` needs
    as a constant NAME_WORK. Raises `ValueError` for a function that is not straight code on scalars, or that has an
    operation which lanes do not know.
    """
    helpers = resources.files("vsense_ros.codegen").joinpath("simd.c").read_text(encoding="utf-8")
    return "\n".join((helpers, *(_function(function) for function in functions)))


@dataclass(frozen=True)
class _Value:
    """What a statement makes: an expression of other values, by their numbers; `out` where it is a result instead."""

    text: str
    operands: tuple[int, ...] = ()
    out: str = ""

    @property
    def again(self) -> bool:
        """Whether it is read once more, rather than kept, where another part needs it."""
        return not self.operands


def _function(function: ca.Function) -> str:
    name, values = function.name(), _values(function)
    parts = [range(begin, min(begin + PART, len(values))) for begin in range(0, len(values), PART)]
    last_needed: dict[int, int] = {}  # number of the part
    for number, part in enumerate(parts):
        last_needed |= dict.fromkeys((k for i in part for k in values[i].operands), number)
    places: dict[int, int] = {}  # in `work`, of values that outlive their part
    free: list[int] = []
    bodies, most = [], 0
    for number, part in enumerate(parts):
        lasting = {i for i in part if last_needed.get(i, 0) > number and not values[i].again}
        for i in lasting:
            places[i] = free.pop() if free else most
            most = max(most, places[i] + 1)
        bodies.append(
            f"static __attribute__((noinline)) void {name}_{number}"
            f"(const lanes *const *in, lanes *const *out, lanes *work) {{\n{_body(values, part, lasting, places)}}}\n"
        )
        over = [i for i in places if last_needed[i] == number]
        free += [places.pop(i) for i in over]
    calls = "".join(f"    {name}_{number}(in, out, work);\n" for number in range(len(parts)))
    return (
        f"enum {{ {name.upper()}_WORK = {most} }};\n{''.join(bodies)}"
        f"static void {name}(const lanes *const *in, lanes *const *out, lanes *work) {{\n{calls}}}\n"
    )


def _body(values: Sequence[_Value], part: range, lasting: set[int], places: Mapping[int, int]) -> str:
    """Statements of a part, which reads what comes from before where it first needs it."""
    lines: list[str] = []
    known: set[int] = set()

    def define(i: int, text: str) -> None:
        lines.append(f"const lanes a{i} = {text};")
        known.add(i)

    for i in part:
        value = values[i]
        if value.again:
            continue  # until it is needed
        for operand in value.operands:
            if operand not in known:
                again = values[operand].again
                define(operand, values[operand].text if again else f"work[{places[operand]}]")
        text = value.text.format(*(f"a{operand}" for operand in value.operands))
        if value.out:
            lines.append(f"{value.out} = {text};")
            continue
        define(i, text)
        if i in lasting:
            lines.append(f"work[{places[i]}] = a{i};")
    return "\n".join((*lines, ""))


def _values(function: ca.Function) -> list[_Value]:
    """What the instructions make, each value once. Vector units divide slowly: what divides is inverted once, and
    multiplies."""
    if not function.is_a("SXFunction", False):
        raise ValueError(f"{function.name()} is not straight code on scalars; expand it first")
    found: list[_Value] = []
    present: dict[int, int] = {}  # what CasADi's variables hold
    inverse: dict[int, int] = {}  # numbers of what divides, and of their inverses

    def new(text: str, *operands: int, out: str = "") -> int:
        found.append(_Value(text, operands, out))
        return len(found) - 1

    for i in range(function.n_instructions()):
        operation, read = function.instruction_id(i), function.instruction_input(i)
        write = function.instruction_output(i)
        if operation == ca.OP_INPUT:
            present[write[0]] = new(f"in[{read[0]}][{read[1]}]")
        elif operation == ca.OP_OUTPUT:
            new("{0}", present[read[0]], out=f"out[{write[0]}][{write[1]}]")
        elif operation == ca.OP_CONST:
            present[write[0]] = new(f"all({_constant(function.instruction_constant(i))})")
        elif operation == ca.OP_DIV:
            numerator, divisor = (present[k] for k in read)
            if divisor not in inverse:
                inverse[divisor] = new("1 / {0}", divisor)
            present[write[0]] = new("{0} * {1}", numerator, inverse[divisor])
        elif operation in _OPERATIONS:
            present[write[0]] = new(_OPERATIONS[operation], *(present[k] for k in read))
        else:
            raise ValueError(f"{function.name()} has an operation that lanes do not know, CasADi's number {operation}")
    return found


def _constant(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return repr(value) if math.isfinite(value) else f"{'-' if value < 0 else ''}INFINITY"
