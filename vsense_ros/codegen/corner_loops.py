"""What a function does alike for its four corners as loops of C99, and the rest as straight code around them.

Written out, the equations of a corner stand there four times: code that no longer fits the cache of a vehicle
computer. `side_by_side.py` finds what is alike. Here a function becomes stages: scalars first, then one loop over the
corners with all that can be computed from them, and on to the next stage with what needs the results of all corners.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

from vsense_ros.codegen.forms import number
from vsense_ros.codegen.side_by_side import CORNERS, Four, Kind, Packing, Step

_UNPLACED = -1  # where the value of a corner goes nowhere


class CornerLoops:
    """The statements of a function. `arguments` and `results` are what its arguments and results are called; `form`
    gives C's words for an operation of CasADi, whose first operand may be known to be 0 or 1."""

    def __init__(
        self, packing: Packing, arguments: Sequence[str], results: Sequence[str], form: Callable[[int, bool], str]
    ) -> None:
        self.packing, self.values = packing, packing.values
        self.arguments, self.results, self.form = arguments, results, form
        self.order = packing.in_order()
        self.numbers = {step: i for i, step in enumerate(self.order)}
        self.stores: dict[int, list[tuple[int, int]]] = defaultdict(list)
        for result, element, value in self.values.results:
            self.stores[value].append((result, element))
        self.slots: dict[Step, int] = {}  # rows of `v`
        self.now = 0  # the stage that is being written
        self.tables: list[str] = []
        self.read: set[int] = set()  # arguments
        self.stages: dict[Step, int] = {}
        for step in self.order:
            needs = self.packing.needs(step)
            self.stages[step] = max((self.stages[need] + self._waits(step, need) for need in needs), default=0)
        self.last: dict[Step, int] = {}  # of vectors that are read when their loop is over, the last stage that does
        for step in self.order:
            if self._is_computed(step):
                for operand, is_whole in self._read_by(step):
                    if is_whole or self.stages[step] > self.stages[operand]:
                        self.last[operand] = max(self.last.get(operand, 0), self.stages[step])
            if self._is_looped(step) and any(_place(e) is None for _, e in self._stores_of(step)):
                self.last.setdefault(step, self.stages[step])

    def statements(self) -> list[str]:
        """Those of the function, with declarations of all that it works on."""
        stages: dict[int, tuple[list[Step], list[Step]]] = defaultdict(lambda: ([], []))
        for step in self.order:
            stages[self.stages[step]][self._is_looped(step)].append(step)
        body: list[str] = []
        free: list[int] = []
        rows = 0
        for self.now in sorted(stages):
            scalars, looped = stages[self.now]
            for step in scalars:
                body += self._alone(step)
            for step in looped:
                if step in self.last:
                    if not free:
                        free.append(rows)
                        rows += 1
                    self.slots[step] = free.pop()
            if looped:
                lines = [f"    {line}" for step in looped for line in self._in_corner(step)]
                body += [f"for (int c = 0; c < {CORNERS}; c++) {{", *lines, "}"]
                for step in looped:
                    body += self._stores_apart(step)
            finished = [step for step in self.slots if self.last[step] == self.now]
            free += [self.slots.pop(step) for step in finished]
        return [*self.tables, *([f"double v[{rows}][{CORNERS}];"] if rows else []), *body]

    def _is_looped(self, step: Step) -> bool:
        return step.vector is not None and self.packing.kinds[step.vector] is Kind.OPERATION

    def _is_computed(self, step: Step) -> bool:
        """True if a statement makes it; the others are read where they are needed."""
        if step.vector is None:
            return self.values.computed(step.scalar) and step.scalar not in self.packing.lanes
        return self._is_looped(step) or self._is_gathered(step.vector)

    def _is_gathered(self, four: Four) -> bool:
        """True if it is put together before the loop."""
        return self.packing.kinds[four] is Kind.GATHERED or (
            self.packing.kinds[four] is Kind.INPUTS and self._input(four) is None
        )

    def _waits(self, step: Step, need: Step) -> bool:
        """True if a step needs the results of other corners than its own, and so the end of their loop."""
        return self._is_looped(need) and not self._is_looped(step)

    def _read_by(self, step: Step) -> Iterator[tuple[Step, bool]]:
        """The vectors that loops make and a step reads, and whether it does so across corners."""
        for need in self.packing.needs(step):
            if self._is_looped(need):
                yield need, self._waits(step, need)
            elif not self._is_computed(need):
                yield from self._read_by(need)

    # Text

    def _alone(self, step: Step) -> Iterator[str]:
        """Outside of the loops: a value, and where it goes."""
        if step.vector is not None:
            if self._is_gathered(step.vector):
                elements = ", ".join(self._read(Step(None, value)) for value in step.vector)
                yield f"const double {self._name(step)}[] = {{{elements}}};"
            return
        if self._is_computed(step):
            needs = (self._read(need) for need in self.packing.needs(step))
            yield f"const double {self._name(step)} = {self._form_of(step.scalar).format(*needs)};"
        if step.scalar not in self.packing.lanes:
            for result, element in self.stores.get(step.scalar, ()):
                yield f"{self.results[result]}[{element}] = {self._read(step)};"

    def _in_corner(self, step: Step) -> Iterator[str]:
        """Within the loop: the value of corner c, and where it goes."""
        assert step.vector is not None
        needs = (self._read(need) for need in self.packing.needs(step))
        name = self._name(step)
        yield f"const double {name} = {self._form_of(step.vector[0]).format(*needs)};"
        if step in self.slots:
            yield f"v[{self.slots[step]}][c] = {name};"
        for result, elements in self._stores_of(step):
            if (place := _place(elements)) is not None:
                yield f"{self.results[result]}[{place}] = {name};"

    def _stores_apart(self, step: Step) -> Iterator[str]:
        """Statements after the loop that store elements of results which lie without order."""
        for result, elements in self._stores_of(step):
            if _place(elements) is None:
                for c, element in enumerate(elements):
                    if element != _UNPLACED:
                        yield f"{self.results[result]}[{element}] = v[{self.slots[step]}][{c}];"

    def _stores_of(self, step: Step) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Results that a vector goes to, and to which element of it each corner."""
        assert step.vector is not None
        lanes = [self.stores.get(value, []) for value in step.vector]
        for i in range(max(map(len, lanes))):
            targets = [lane[i] if i < len(lane) else (_UNPLACED, _UNPLACED) for lane in lanes]
            for result in dict.fromkeys(result for result, _ in targets if result != _UNPLACED):
                yield result, tuple(element if of_corner == result else _UNPLACED for of_corner, element in targets)

    def _form_of(self, value: int) -> str:
        return self.form(self.values.operations[value], self.values.is_logical(self.values.operands[value][0]))

    def _name(self, step: Step) -> str:
        return f"a{self.numbers[step]}"

    def _read(self, step: Step) -> str:
        """The text that stands for a value where it is needed."""
        values, lanes = self.values, self.packing.lanes
        if step.vector is None:
            value = step.scalar
            if value in lanes:
                return f"v[{self.slots[Step(lanes[value][0])]}][{lanes[value][1]}]"
            if values.computed(value):
                return self._name(step)
            return self._argument(*values.places[value]) if value in values.places else number(values.constants[value])
        kind = self.packing.kinds[step.vector]
        if kind is Kind.OPERATION:
            return self._name(step) if self.stages[step] == self.now else f"v[{self.slots[step]}][c]"
        if kind is Kind.SAME:
            return self._read(Step(None, step.vector[0]))
        if kind is Kind.PERMUTED:
            from_lanes = [lanes[value][1] for value in step.vector]
            return f"v[{self.slots[Step(self.packing.operands[step.vector][0])]}][{self._corner(from_lanes)}]"
        if kind is Kind.CONSTANTS:
            return self._table("double", [number(values.constants[value]) for value in step.vector])
        return self._input(step.vector) or f"{self._name(step)}[c]"

    def _input(self, four: Four) -> str | None:
        """Elements of an argument that lie in order, as corner c reads them; None for others."""
        if self.packing.kinds[four] is not Kind.INPUTS:
            return None
        places = [self.values.places[value] for value in four]
        place = _place([element for _, element in places]) if len({argument for argument, _ in places}) == 1 else None
        return None if place is None else self._argument(places[0][0], place)

    def _corner(self, lanes: Sequence[int]) -> str:
        return _place(lanes) or self._table("char", list(map(str, lanes)))

    def _table(self, kind: str, elements: Sequence[str]) -> str:
        name = f"k{len(self.tables)}"
        self.tables.append(f"static const {kind} {name}[] = {{{', '.join(elements)}}};")
        return f"{name}[c]"

    def _argument(self, argument: int, element: int | str) -> str:
        self.read.add(argument)
        return f"{self.arguments[argument]}[{element}]"


def _place(elements: Sequence[int]) -> str | None:
    """The element of corner c, where from left to right, and from front to rear, it is as far each time."""
    first, right, rear, last = elements
    across, along = right - first, rear - first
    if min(elements) < 0 or last != first + across + along:
        return None
    if (across, along) == (1, 2):
        return f"{first} + c" if first else "c"
    terms = [str(first)] if first or not (across or along) else []
    terms += [f"{step} * ({which})" for step, which in ((across, "c % 2"), (along, "c / 2")) if step]
    return " + ".join(terms).replace("+ -", "- ")
