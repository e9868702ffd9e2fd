"""CasADi functions as C for several cars side by side, each in a lane of the processor's vectors.

A car's equations are thousands of scalar operations: one car alone uses a quarter or an eighth of what a vector unit
does with one instruction. Several runs, with inputs of their own, fill it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources

import casadi as ca

from vsense_ros.codegen.forms import VECTOR, number
from vsense_ros.codegen.values import CONSTANT, INPUT, Values, values_of

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
        """True if it is read once more, rather than kept, where another part needs it."""
        return not self.operands


def _function(function: ca.Function) -> str:
    name, values = function.name(), _values(function)
    parts = [range(begin, min(begin + PART, len(values))) for begin in range(0, len(values), PART)]
    last_needed: dict[int, int] = {}  # place of the part
    for place, part in enumerate(parts):
        last_needed |= dict.fromkeys((k for i in part for k in values[i].operands), place)
    places: dict[int, int] = {}  # in `work`, of values that outlive their part
    free: list[int] = []
    bodies, work_size = [], 0
    for place, part in enumerate(parts):
        lasting = {i for i in part if last_needed.get(i, 0) > place and not values[i].again}
        for i in lasting:
            places[i] = free.pop() if free else work_size
            work_size = max(work_size, places[i] + 1)
        bodies.append(
            f"static __attribute__((noinline)) void {name}_{place}"
            f"(const lanes *const *in, lanes *const *out, lanes *work) {{\n{_body(values, part, lasting, places)}}}\n"
        )
        finished = [i for i in places if last_needed[i] == place]
        free += [places.pop(i) for i in finished]
    calls = "".join(f"    {name}_{place}(in, out, work);\n" for place in range(len(parts)))
    return (
        f"enum {{ {name.upper()}_WORK = {work_size} }};\n{''.join(bodies)}"
        f"static void {name}(const lanes *const *in, lanes *const *out, lanes *work) {{\n{calls}}}\n"
    )


def _body(values: Sequence[_Value], part: range, lasting: set[int], places: Mapping[int, int]) -> str:
    """Statements of a part, which reads what comes from before where it first needs it."""
    lines: list[str] = []
    defined: set[int] = set()

    def define(i: int, text: str) -> None:
        lines.append(f"const lanes a{i} = {text};")
        defined.add(i)

    for i in part:
        value = values[i]
        if value.again:
            continue  # until it is needed
        for operand in value.operands:
            if operand not in defined:
                recomputed = values[operand].again
                define(operand, values[operand].text if recomputed else f"work[{places[operand]}]")
        text = value.text.format(*(f"a{operand}" for operand in value.operands))
        if value.out:
            lines.append(f"{value.out} = {text};")
            continue
        define(i, text)
        if i in lasting:
            lines.append(f"work[{places[i]}] = a{i};")
    return "\n".join((*lines, ""))


def _values(function: ca.Function) -> list[_Value]:
    """What the statements make; a result is written as soon as it is known."""
    values = values_of(function)
    results: dict[int, list[str]] = defaultdict(list)
    for result, element, value in values.results:
        results[value].append(f"out[{result}][{element}]")
    statements: list[_Value] = []
    places: list[int] = []
    for i in range(len(values.operations)):
        statement = _value(function, values, i)
        places.append(len(statements))
        statements.append(replace(statement, operands=tuple(places[operand] for operand in statement.operands)))
        statements += [_Value("{0}", (places[i],), target) for target in results[i]]
    return statements


def _value(function: ca.Function, values: Values, i: int) -> _Value:
    operation = values.operations[i]
    if operation == INPUT:
        return _Value("in[{}][{}]".format(*values.places[i]))
    if operation == CONSTANT:
        return _Value(f"all({number(values.constants[i])})")
    if operation not in VECTOR:
        raise ValueError(f"{function.name()} has an operation that lanes do not know, CasADi's number {operation}")
    return _Value(VECTOR[operation], values.operands[i])
