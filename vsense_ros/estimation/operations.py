"""What C does on the memory of a linearised system, in one call each: operations.c, for every filter alike."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from importlib import resources
from math import inf
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Course, Followed, Given, Measured, Step, impossible_at
from vsense_ros.estimation.gaussian import COMPONENTS

ADDRESS = ctypes.c_void_p
_EVENT = Struct("3P2d3q")  # `struct event` of operations.c


def library(name: str, states: int, *sources: str, **defined: int) -> ctypes.CDLL | None:
    """Compiled from the package's C files that define a filter with an error of `states` elements, and macros that they
    need; None where there is no compiler."""
    files = ("estimation/algebra.c", "codegen/kernel.c", *sources, "estimation/operations.c")
    package = resources.files("vsense_ros")
    macros = [f"#define {macro} {value}" for macro, value in {"STATES": states, **defined}.items()]
    parts = [package.joinpath(file).read_text(encoding="utf-8") for file in files]
    built = codegen.library(name, "\n".join([*macros, *parts]))
    return None if built is None else ctypes.CDLL(str(built))


def unknown_sensor(name: str, sensors: Sequence[str]) -> InputError:
    """What to say of a sensor that a filter does not know."""
    return InputError(f"the filter has no sensor {name!r}; it has: {', '.join(sensors) or 'none'}")


def misfit(sensor: str, components: int, value: Array) -> InputError:
    """What to say of a measurement with another number of components."""
    return InputError(f"a measurement of {sensor!r} has {components} components, but got {len(value)}")


class _Call(NamedTuple):
    """`struct call` of operations.c: where it stands, its limit, scale and result, and the measurement (m,)."""

    address: int
    numbers: Any  # a memoryview, in which single numbers are set at once
    value: Array
    variance: Array

    @classmethod
    def of(cls, live: int, sensor: int, components: int) -> _Call:
        """The structure for corrections by this sensor."""
        numbers = np.zeros(5 + 2 * COMPONENTS)
        numbers[:2].view(np.int64)[:] = live, sensor
        value, variance = np.split(numbers[5:], 2)
        return cls(numbers.ctypes.data, numbers.data[2:5], value[:components], variance[:components])


class Operations:
    """Compiled operations of one filter, `live`, whose arrays must stay where they are.

    `sensors` have a structure and a number of components m. `h` (1,) is the length of a step, an argument of the
    filter's functions. What the last correction found stands in `whitened` (16,) and `factor` (256,), as in
    `Innovation`: of the first the m first elements count, of the other the m m first. `impossible` is what to say of a
    step that cannot be made.
    """

    def __init__(
        self,
        compiled: ctypes.CDLL,
        live: ctypes.Structure,
        sensors: Mapping[str, tuple[ctypes.Structure, int]],
        h: Array,
        innovation: tuple[Array, Array],
        impossible: str,
    ) -> None:
        self.whitened, self.factor = innovation
        self._structures = live, sensors
        self._live, self._impossible = ctypes.addressof(live), impossible
        self._length: Any = h.data
        self._sensors = {name: ctypes.addressof(structure) for name, (structure, _) in sensors.items()}
        self._calls = {name: _Call.of(self._live, self._sensors[name], m) for name, (_, m) in sensors.items()}
        self._step, self._measure = compiled.vsense_step, compiled.vsense_measure
        self._advance, self._repeat = compiled.vsense_advance, compiled.vsense_repeat
        self._follow, self._is_valid = compiled.vsense_follow, compiled.vsense_is_valid
        self._is_valid.argtypes = [ADDRESS]
        self._step.argtypes = [ADDRESS, ADDRESS]
        self._measure.argtypes, self._measure.restype = [ADDRESS], None
        self._advance.argtypes = [ADDRESS, ADDRESS, ctypes.c_int, ctypes.c_double, ADDRESS]
        self._repeat.argtypes = [ADDRESS, ctypes.c_int, ctypes.c_char_p, *[ADDRESS] * 4]
        self._follow.argtypes = [*[ADDRESS] * 2, *[ctypes.c_int] * 3, ctypes.c_double, *[ADDRESS] * 5, ctypes.c_int]
        self._follow.argtypes += [ADDRESS]

    def process(self, h: float) -> int:
        """Address of what a step of `h` [s] reads besides its length; 0: nothing."""
        return 0

    def predict(self, h: float) -> None:
        """As `Linearised.step`."""
        self._length[0] = h
        if not self._step(self._live, self.process(h)):
            raise FloatingPointError(self._impossible)

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """Correct, and return the normalized innovation squared: as `Filter.correct`."""
        call = self._calls.get(sensor)
        if call is None:
            raise unknown_sensor(sensor, tuple(self._calls))
        address, numbers, values, variances = call
        if len(value) != len(values):
            raise misfit(sensor, len(values), value)
        values[:], variances[:] = value, variance
        numbers[0], numbers[1] = limit, scale
        self._measure(address)
        return float(numbers[2])

    def is_valid(self) -> bool:
        """As `Filter.is_valid`."""
        return bool(self._is_valid(self._live))

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`."""
        kept, steps, h = step
        return bool(self._advance(self._live, kept.address, steps, h, self.process(h)))

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """As `Filter.repeat`."""
        if not events:
            return 0, False, []
        rows, values, variances = [], [], []
        for step, event in events:
            kept, process, steps, h = 0, 0, 0, 0.0
            if step is not None:
                (_, kept), steps, h = step
                process = self.process(h)
            if isinstance(event, Measured):
                self._check(event)
                sensor, value, variance, limit = event
                row = _EVENT.pack(self._sensors[sensor], kept, process, h, limit, steps, 0, len(value))
            else:
                first, value = event
                variance = value
                row = _EVENT.pack(0, kept, process, h, inf, steps, first, len(value))
            rows.append(row)
            values.append(value)
            variances.append(variance)
        measured, moved, nis = np.concatenate(values + variances, dtype=float), ctypes.c_int(), np.zeros(len(rows))
        first = measured.ctypes.data
        addresses = first, first + measured.nbytes // 2, nis.ctypes.data, ctypes.addressof(moved)
        done = self._repeat(self._live, len(rows), b"".join(rows), *addresses)
        return done, bool(moved.value), nis[: done + moved.value].tolist()

    def follow(self, course: Course, size: int, every: int = 0) -> Followed:
        """As `Filter.follow`, of a filter whose memory has this `size`."""
        self._check(Measured(course.sensor, course.values[0], course.variance, np.inf))
        inputs, values, variance = (np.ascontiguousarray(a, dtype=float) for a in course[1:4])
        count, nis = len(values), np.full(len(values), np.nan)
        kept = np.zeros((-(-count // every) if every else 0, size))
        done = self._follow(
            self._live, self._sensors[course.sensor], count, inputs.shape[1], values.shape[1], course.h,
            self.process(course.h), inputs.ctypes.data, values.ctypes.data, variance.ctypes.data, nis.ctypes.data,
            every, kept.ctypes.data,
        )  # fmt: skip
        if done < count:
            raise impossible_at(done, course)
        return Followed(nis, kept)

    def _check(self, event: Measured) -> None:
        if event.sensor not in self._calls:
            raise unknown_sensor(event.sensor, tuple(self._calls))
        components = len(self._calls[event.sensor].value)
        if len(event.value) != components:
            raise misfit(event.sensor, components, event.value)
