"""CasADi functions as C for the processor at hand, in the form in which CasADi loads functions again.

CasADi's own generator keeps all values in a few hundred variables that it uses again and again, asks at each result
whether it is wanted, and writes a function as one piece. Here a value is a constant, and long functions come in parts:
a quarter of the time to compile, a fifth less to run. Corners that are computed alike share vector operations
(`side_by_side.py`), and a function that multiplies the matrices which others make (CasADi's MX) does so in loops.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources

import casadi as ca

from vsense_ros.codegen.forms import SCALAR, VECTOR, number, zeros
from vsense_ros.codegen.instructions import Instruction, MatrixPrinter, multiplies
from vsense_ros.codegen.side_by_side import CORNERS, Alike, Four, Kind, Packing, Step, packed
from vsense_ros.codegen.values import CONSTANT, INPUT, values_of

PART = 1000  # statements in one C function: compilers take more than twice the time for twice as many


@dataclass(frozen=True)
class Corners:
    """How a function's arguments belong to corners (see `Alike`), and arguments that are `known`, by name: they make
    corners alike whose numbers differ."""

    alike: Alike
    known: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def known_of(self, function: ca.Function) -> dict[int, Sequence[float]]:
        """The known arguments of a function, by their place."""
        names = [function.name_in(i) for i in range(function.n_in())]
        return {names.index(name): numbers for name, numbers in self.known.items() if name in names}


def source(functions: Sequence[ca.Function], corners: Corners | None = None) -> str:
    """C of the functions, for `casadi.external`; known arguments are left out.

    Raises `ValueError` for functions with operations that have no counterpart here.
    """
    helpers = resources.files("vsense_ros.codegen").joinpath("simd.c").read_text(encoding="utf-8")
    written = _Written(corners)
    interfaces = [_interface(function, written.name(function), corners) for function in functions]
    return "\n".join((f"#define LANES {CORNERS}", helpers, *written.texts, *interfaces))


class _Written:
    """The texts of functions, each after those that it calls."""

    def __init__(self, corners: Corners | None) -> None:
        self.corners = corners
        self.texts: list[str] = []
        self._names: dict[int, tuple[ca.Function, str]] = {}

    def name(self, function: ca.Function) -> str:
        """What a function is called in C, where it is written if it is not yet: several may have one name in CasADi."""
        key = hash(function)
        if key not in self._names:
            name = f"{function.name()}_{len(self._names)}"
            self._names[key] = function, name
            make = _matrices if multiplies(function, CORNERS) else _straight
            self.texts.append(make(function, name, self))
        return self._names[key][1]


def can_write(function: ca.Function) -> bool:
    """True if `source` takes a function: others solve equations, say, or repeat a function in a loop, which is better
    left to CasADi than written out."""
    try:
        if function.is_a("SXFunction", False) or multiplies(function, CORNERS):
            _Written(None).name(function)
            return True
    except (ValueError, RuntimeError):
        pass
    return False


def _known(function: ca.Function, corners: Corners | None) -> dict[int, Sequence[float]]:
    return {} if corners is None else corners.known_of(function)


def _straight(function: ca.Function, name: str, written: _Written) -> str:
    """A function of scalars, in parts."""
    plain = function if function.is_a("SXFunction", False) else function.expand(function.name(), {"cse": True})
    corners = written.corners
    values = values_of(plain, _known(plain, corners))
    names = [plain.name_in(i) for i in range(plain.n_in())]
    return _Text(name, packed(values, names, corners.alike) if corners else Packing(values)).function()


class _Text:
    """The text of a function of scalars and of vectors of four."""

    def __init__(self, name: str, packing: Packing) -> None:
        self.name, self.packing, self.values = name, packing, packing.values
        self.numbers: dict[Step, int] = {}
        self.results: dict[int, list[tuple[int, int]]] = defaultdict(list)
        for result, element, value in self.values.results:
            self.results[value].append((result, element))

    def variable(self, step: Step) -> str:
        return f"{'a' if step.vector is None else 'v'}{self.numbers.setdefault(step, len(self.numbers))}"

    def function(self) -> str:
        order = self.packing.in_order()
        steps = [step for step in order if not self.packing.is_at_hand(step)]
        parts = [steps[begin : begin + PART] for begin in range(0, len(steps), PART)]
        bodies, scalars, vectors = self._parts(parts)
        calls = "".join(f"    {self.name}_{place}(in, out, w, v);\n" for place in range(len(parts)))
        at_hand = (s for s in order if self.packing.is_at_hand(s) and s.vector is None and s.scalar in self.results)
        remaining_stores = "".join(f"    {line}\n" for step in at_hand for line in self._stores(step, self.text(step)))
        return (
            f"{''.join(bodies)}static void {self.name}_of(const double *const *in, double *const *out) {{\n"
            f"    double w[{scalars + 1}];\n    lanes v[{vectors + 1}];\n    "
            f"(void)w, (void)v;\n{calls}{remaining_stores}}}\n"
        )

    def _parts(self, parts: Sequence[Sequence[Step]]) -> tuple[list[str], int, int]:
        """Their texts, and how many scalars and vectors they leave to each other at most."""
        last = {need: place for place, part in enumerate(parts) for step in part for need in self.packing.needs(step)}
        places: dict[Step, str] = {}
        free: dict[str, list[str]] = {"w": [], "v": []}
        counts = {"w": 0, "v": 0}
        bodies = []
        for place, part in enumerate(parts):
            lines = list(self._reads(part, places))
            for step in part:
                lines.append(self._statement(step))
                if step.vector is None:
                    lines += self._stores(step, self.variable(step))
                if last.get(step, place) > place:
                    array = "w" if step.vector is None else "v"
                    if not free[array]:
                        free[array].append(f"{array}[{counts[array]}]")
                        counts[array] += 1
                    places[step] = free[array].pop()
                    lines.append(f"{places[step]} = {self.variable(step)};")
            for step in [step for step in places if last[step] == place]:
                free[places[step][0]].append(places.pop(step))
            bodies.append(
                f"static __attribute__((noinline)) void {self.name}_{place}"
                "(const double *const *in, double *const *out, double *w, lanes *v) {\n"
                + "\n".join((*lines, "(void)in, (void)out, (void)w, (void)v;\n}\n"))
            )
        return bodies, counts["w"], counts["v"]

    def _reads(self, part: Sequence[Step], places: Mapping[Step, str]) -> Iterator[str]:
        """Declarations of the values that a part needs and does not compute."""
        defined = set(part)
        for need in dict.fromkeys(need for step in part for need in self.packing.needs(step)):
            if need not in defined:
                text = self.text(need) if self.packing.is_at_hand(need) else places[need]
                yield f"const {_type(need)} {self.variable(need)} = {text};"

    def _statement(self, step: Step) -> str:
        return f"const {_type(step)} {self.variable(step)} = {self.text(step)};"

    def _stores(self, step: Step, text: str) -> list[str]:
        return [f"out[{result}][{element}] = {text};" for result, element in self.results.get(step.scalar, ())]

    def text(self, step: Step) -> str:
        """The expression that makes a value."""
        if step.vector is not None:
            return self._vector(step.vector)
        value = step.scalar
        if value in self.packing.lanes:
            vector, lane = self.packing.lanes[value]
            return f"{self.variable(Step(vector))}[{lane}]"
        operation = self.values.operations[value]
        if operation == INPUT:
            return "in[{}][{}]".format(*self.values.places[value])
        if operation == CONSTANT:
            return number(self.values.constants[value])
        return _form(SCALAR, operation).format(*(self.variable(need) for need in self.packing.needs(step)))

    def _vector(self, four: Four) -> str:
        kind = self.packing.kinds[four]
        if kind is Kind.CONSTANTS:
            return _together(number(self.values.constants[value]) for value in four)
        if kind is Kind.INPUTS:
            argument, element = self.values.places[four[0]]
            if all(self.values.places[value] == (argument, element + lane) for lane, value in enumerate(four)):
                return f"*(const apart *)(in[{argument}] + {element})"
            return _together("in[{}][{}]".format(*self.values.places[value]) for value in four)
        if kind is Kind.PERMUTED:
            vector = self.variable(Step(self.packing.operands[four][0]))
            return _together(f"{vector}[{self.packing.lanes[value][1]}]" for value in four)
        needs = [self.variable(need) for need in self.packing.needs(Step(four))]
        if kind is Kind.GATHERED:
            return _together(needs)
        if kind is Kind.SAME:
            return f"all({needs[0]})"
        return _form(VECTOR, self.values.operations[four[0]]).format(*needs)


def _type(step: Step) -> str:
    return "double" if step.vector is None else "lanes"


def _together(texts: Iterator[str] | Sequence[str]) -> str:
    return f"(lanes){{{', '.join(texts)}}}"


def _form(forms: Mapping[int, str], operation: int) -> str:
    if operation not in forms:
        raise ValueError(f"CasADi's operation {operation} has no counterpart in native code")
    return forms[operation]


class _Matrices(MatrixPrinter):
    """Function calls on arrays of pointers, and products by vector operations."""

    def __init__(self, written: _Written, known: Container[int]) -> None:
        self._written, self._known = written, known

    def argument(self, place: int) -> str:
        """An element of the arguments; one that is known is none."""
        return "0" if place in self._known else f"in[{place}]"

    def output(self, result: int, name: str, size: int) -> str:
        """Statements that copy a value to a result as a whole."""
        return f"memcpy(out[{result}], {name or zeros(size)}, {size} * sizeof(double));"

    def call(self, instruction: Instruction, arguments: Sequence[str], results: Sequence[str]) -> list[str]:
        """The results, and a call with pointers to everything."""
        called = instruction.matrix.which_function()
        name = self._written.name(called)
        sizes = [max(called.nnz_out(k), 1) for k in range(called.n_out())]
        pointers = ", ".join(argument or zeros(called.nnz_in(k)) for k, argument in enumerate(arguments))
        return [
            *(f"double {result}[{size}];" for result, size in zip(results, sizes, strict=True)),
            f"{name}_of((const double *const[]){{{pointers}}}, (double *const[]){{{', '.join(results)}}});",
        ]

    def product(self, matrix: ca.MX, begin: str, left: str, right: str, name: str) -> list[str]:
        """Column by column, of which four rows at a time.

        The last rows overlap with those before where four do not divide their number.
        """
        rows, columns = matrix.shape
        sparsity = matrix.dep(2).sparsity()
        blocks = [*range(0, rows - CORNERS, CORNERS), rows - CORNERS]
        declared = [
            f"static const int {name}_ends[] = {{{', '.join(map(str, sparsity.colind()))}}};",
            f"static const int {name}_rows[] = {{{', '.join(map(str, sparsity.row()))}}};",
            f"double {name}[{rows * columns}];",
            f"for (int j = 0; j < {columns}; j++) {{",
        ]
        begins = (f"*(const apart *)({begin} + {rows} * j + {block})" if begin else "all(0)" for block in blocks)
        sums = [f"lanes s{block} = {value};" for block, value in zip(blocks, begins, strict=True)]
        add = [f"s{block} += *(const apart *)(x + {block}) * all({right}[k]);" for block in blocks]
        stores = [f"*(apart *)({name} + {rows} * j + {block}) = s{block};" for block in blocks]
        loop = [
            f"for (int k = {name}_ends[j]; k < {name}_ends[j + 1]; k++) {{",
            f"const double *x = {left} + {rows} * {name}_rows[k];",
            *add,
            "}",
        ]
        return [*declared, *sums, *loop, *stores, "}"]


def _matrices(function: ca.Function, name: str, written: _Written) -> str:
    """A function that calls others and multiplies what they make."""
    lines = _Matrices(written, _known(function, written.corners)).statements(function)
    text = "\n".join((*lines, "(void)in;\n}\n"))
    return f"static void {name}_of(const double *const *in, double *const *out) {{\n{text}"


def _interface(function: ca.Function, inner: str, corners: Corners | None) -> str:
    """What CasADi asks a library for (casadi.external), and the function as it calls it: arguments that are missing are
    zero, results that are not wanted go nowhere."""
    name, known = function.name(), _known(function, corners)
    inputs = [i for i in range(function.n_in()) if i not in known]
    outputs = range(function.n_out())
    lines = [
        *_described(name, "in", [(function.name_in(i), function.sparsity_in(i)) for i in inputs]),
        *_described(name, "out", [(function.name_out(i), function.sparsity_out(i)) for i in outputs]),
    ]
    arguments = ["0"] * function.n_in()
    for k, i in enumerate(inputs):
        arguments[i] = f"arg[{k}] ? arg[{k}] : zero"
    results = [f"res[{i}] ? res[{i}] : w" for i in outputs]
    zeros = max((function.nnz_in(i) for i in inputs), default=0) + 1
    work = max(function.nnz_out(i) for i in outputs) + 1
    return "\n".join(
        (
            *lines,
            f"int {name}_work(long long *arg, long long *res, long long *iw, long long *w) {{",
            f"    *arg = {len(inputs)}, *res = {len(outputs)}, *iw = 0, *w = {work};\n    return 0;\n}}",
            f"int {name}(const double **arg, double **res, long long *iw, double *w, int mem) {{",
            f"    static const double zero[{zeros}];",
            f"    const double *const in[] = {{{', '.join(arguments)}}};",
            f"    double *const out[] = {{{', '.join(results)}}};",
            f"    (void)iw, (void)mem;\n    {inner}_of(in, out);\n    return 0;\n}}\n",
        )
    )


def _described(name: str, side: str, parts: Sequence[tuple[str, ca.Sparsity]]) -> list[str]:
    """How many arguments or results there are, what they are called and which elements they have."""
    shapes = [[*s.shape, 1] if s.is_dense() else s.compress() for _, s in parts]
    cases = [f"case {i}: return {name}_{side}_{i};" for i in range(len(parts))]
    names = [f'case {i}: return "{word}";' for i, (word, _) in enumerate(parts)]
    return [
        f"long long {name}_n_{side}(void) {{ return {len(parts)}; }}",
        *(
            f"static const long long {name}_{side}_{i}[] = {{{', '.join(map(str, shape))}}};"
            for i, shape in enumerate(shapes)
        ),
        f"const long long *{name}_sparsity_{side}(long long i) {{ switch (i) {{ {' '.join(cases)} }} return 0; }}",
        f"const char *{name}_name_{side}(long long i) {{ switch (i) {{ {' '.join(names)} }} return 0; }}",
    ]
