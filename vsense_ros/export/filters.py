"""A GNSS/INS filter as C99 sources: the operations that run in Python, around functions of its equations.

Each state space is a file of its own, since the operations are made for one size of the covariance. Another file has
what a reading of each sensor is to them, and what they pass on to one another. The struct is the filter's memory in
Python, element by element.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.codegen.c99 import c_function
from vsense_ros.codegen.forms import number
from vsense_ros.errors import InputError
from vsense_ros.estimation.cascade import Cascade, InputLink, MeasurementLink
from vsense_ros.estimation.dense import UNLIMITED, Jacobians
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import largest_nis
from vsense_ros.estimation.state_space import Measurement
from vsense_ros.export.sources import (
    PREFIX,
    identifier,
    in_single_precision,
    packaged,
    require_prefix,
    templates,
    write_all,
)
from vsense_ros.files.names import harmless
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import NEVER, Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.heading_bank import HYPOTHESES, HeadingBank
from vsense_ros.navigation.memory import Memory
from vsense_ros.navigation.reading_use import Use, usable
from vsense_ros.navigation.readings import SLOWEST_COURSE, SPEED, SPIN_SLIP, Components, RollingSpeed
from vsense_ros.navigation.space import NavigationSpace

_INCLUDED = ("estimation/algebra.c", "codegen/kernel.c", "estimation/innovation.c", "estimation/ekf.c")
_READINGS = "navigation/readings.c"
_ALONE = "one"  # what a part is called in C that is the whole filter
_AT_PART = ("mean", "inputs", "parameters")


def write(vehicle: Vehicle, name: str, folder: Path, prefix: str = PREFIX, *, single: bool = False) -> list[Path]:
    """Write the filter of this name with the sensors and numbers of a vehicle into `folder`, which is made where it is
    missing; returns the files. Names of types and functions begin with `prefix`. With `single` every number is
    binary32.

    Raises `InputError` for an unknown filter, for one whose sensors the vehicle lacks, and for one that draws random
    numbers, and for a prefix that C does not take.
    """
    require_prefix(prefix)
    sensors = usable(vehicle.sensing())
    filter: Aided = FILTERS[name].make(vehicle, sensors)
    contents = _Contents(FILTERS[name].name, vehicle, filter, sensors)
    environment = templates()
    values = contents.values()
    texts = {f"{name}.{end}": environment.get_template(f"filter.{end}.j2").render(values) for end in ("h", "c")}
    for part in values["parts"]:
        texts[part["file"]] = environment.get_template("part.c.j2").render(values | {"part": part})
    texts |= packaged((*_INCLUDED, _READINGS))
    if single:
        texts = {name: in_single_precision(text) for name, text in texts.items()}
    return write_all(folder, texts, prefix)


def sources(name: str, folder: Path) -> list[Path]:
    """Those of the files made by `write` that are compiled."""
    return sorted(folder.glob(f"{name}.c")) + sorted(folder.glob(f"{name}_part_*.c"))


class _Contents:
    """What the templates refer to."""

    def __init__(self, name: str, vehicle: Vehicle, filter: Aided, sensors: dict[str, SensorBase]) -> None:
        self.name, self.vehicle, self.filter, self.sensors = name, vehicle, filter, sensors
        self.definition = DEFINITIONS[name][1]
        self.cascade = filter.filter if isinstance(filter.filter, Cascade) else None
        self.is_bank = isinstance(filter.filter, HeadingBank)
        if not (self.cascade or self.is_bank or isinstance(filter.filter, Ekf)):
            raise InputError(
                f"{name}: a particle filter is not written as C: it draws its random numbers by NumPy's generator, "
                "which C has not, so that no check could distinguish a wrong filter from another draw; mekf_2b is the "
                "same model, and is written"
            )
        self.numbers = car_numbers(vehicle, sensors.values())
        self.functions: list[str] = []

    def values(self) -> dict[str, Any]:
        """For all templates."""
        parts = [self._part(key, *part) for key, part in self.definition.parts.items()]
        used = {key: use for key, use in self.filter.use.items() if self.filter.uses(key)}
        memories = {memory: self._memory(memory) for use in used.values() for memory in use.remembered}
        sensors = [self._sensor(key, use, [memories[one] for one in use.remembered]) for key, use in used.items()]
        measurements = self._measurements(sensors)
        passes = [self._pass(key) for key in self.definition.parts] if self.cascade else []
        links = [link for one in passes for link in one["links"]]
        return self._constants() | {
            "sources": [f"{self.name}.c", *(part["file"] for part in parts)],
            "parts": parts,
            "at": {part["name"]: f"&filter->{part['name']}" if self.cascade else "filter" for part in parts},
            "passes": passes,
            "measurements": measurements,
            "memories": list(memories.values()),
            "sensors": sensors,
            "spreads": any(link["variances"] for link in links) or any(one["links"] for one in measurements),
            "judges": any(sensor["measurements"] for sensor in sensors),
            "functions": "\n".join(self.functions),
        }

    def _measurements(self, sensors: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """The measurements by which any of these sensors corrects the filter, or that are conditions of one."""
        used = {one["name"] for sensor in sensors for one in (*sensor["measurements"], *sensor["conditions"])}
        return [
            self._measurement(one.name, len(one.deviations)) for one in self.definition.measurements if one.name in used
        ]

    def _constants(self) -> dict[str, Any]:
        """Names and numbers of the filter as a whole."""
        inputs = self.filter.input_names
        return {
            "name": self.name,
            "title": FILTERS[self.name].title,
            "vehicle": harmless(self.vehicle.name),
            "kind": "cascade" if self.cascade else "bank" if self.is_bank else "single",
            "inputs": inputs,
            "since_fix": self.filter.since_fix,
            "never": number(NEVER),
            "speed_place": inputs.index(SPEED) if SPEED in inputs else 0,
            "hypotheses": HYPOTHESES,
            "yaw": next(iter(self.definition.parts.values()))[0].names.index("yaw") if self.is_bank else 0,
            "slowest_course": number(SLOWEST_COURSE),
            "spin_slip": number(SPIN_SLIP),
        }

    def _part(self, key: str, system: NavigationSpace, measurements: tuple[Measurement, ...]) -> dict[str, Any]:
        """What the templates refer to for one state space."""
        made = Jacobians(system, measurements)
        transition, retract, *sense = made.written
        start = system.start(self.numbers)
        part = _name(key)
        arguments = ["part->mean", *(f"part->{n}" if getattr(system, n) else "0" for n in _AT_PART[1:])]
        return {
            "name": part,
            "file": f"{self.name}_part_{part}.c",
            "meaning": f"the filter {key}" if key else "the state space",
            "states": system.names,
            "errors": system.error_names,
            "inputs": system.inputs,
            "parameters": system.parameters,
            "measurements": [{"name": one.name, "components": len(one.deviations)} for one in measurements],
            "functions": "\n".join(_of_kernel(one) for one in made.written if one is not retract or not system.is_flat),
            "arguments": ", ".join(arguments),
            "largest": _list(system.largest.get(one, UNLIMITED) for one in system.names),
            "row": _list(made.row),
            "column": _list(made.column) or "0",
            "place": _list(made.place) or "0",
            "placed": len(made.place),
            "elements": transition.nnz_out(1),
            "added": transition.nnz_out(2),
            "deviations": _list(np.sqrt(np.diag(start.covariance))),
            "mean": _list(start.mean),
            "numbers": _list(self.numbers[one] for one in system.parameters),
            "senses": ", ".join(f"run_{one.name()}" for one in sense),
            "components": _list(len(one.deviations) for one in measurements),
            "flat": system.is_flat,
        }

    def _written(self, kind: str, function: ca.Function) -> str:
        """Write a function into the file of the links; returns its name there."""
        name = f"{kind}_{len(self.functions)}"
        self.functions.append(c_function(function, [f"r{i}" for i in range(function.n_out())], name))
        return name

    def _pass(self, key: str) -> dict[str, Any]:
        """The inputs of a part of a cascade."""
        assert self.cascade is not None
        links = [one for one in self.cascade.passed_inputs if one.link.target == key]
        return {
            "name": _name(key),
            "taken": self.cascade.taken[key],
            "links": [self._input_link(one) for one in links],
        }

    def _input_link(self, one: InputLink) -> dict[str, Any]:
        return {
            "function": self._written("passed_input", one.function),
            "source": _name(one.link.source),
            "components": len(one.link.names),
            "errors": one.function.size2_out(1),
            "places": one.places,
            "variances": one.variances,
        }

    def _measurement(self, name: str, components: int) -> dict[str, Any]:
        """Which parts a measurement from outside corrects."""
        direct: Sequence[str] = list(self.definition.parts)
        links: tuple[MeasurementLink, ...] = ()
        if self.cascade is not None:
            direct, links = self.cascade.corrected[name]
        return {
            "name": name,
            "components": components,
            "direct": [_name(key) for key in direct],
            "links": [self._measurement_link(one) for one in links],
        }

    def _measurement_link(self, one: MeasurementLink) -> dict[str, Any]:
        return {
            "function": self._written("passed_measurement", one.function),
            "source": _name(one.link.source),
            "target": _name(one.link.target),
            "measurement": one.link.measurement,
            "components": one.function.size1_out(0),
            "errors": one.function.size2_out(1),
        }

    def _memory(self, memory: Memory) -> dict[str, Any]:
        """Inputs that are remembered."""
        part = memory.remembered.part
        system, at = self.definition.parts[part][0], f"filter->{_name(part)}." if self.cascade else "filter->"
        arguments = [f"{at}mean", *(f"{at}{n}" if getattr(system, n) else "0" for n in _AT_PART[1:])]
        return {
            "function": self._written("remembered", memory.function),
            "part": _name(part),
            "arguments": ", ".join(arguments),
            "covariance": f"{at}covariance",
            "places": list(zip(memory.places, memory.own, strict=True)),
        }

    def _sensor(self, key: str, use: Use, memories: list[dict[str, Any]]) -> dict[str, Any]:
        """What a reading of one sensor does."""
        sensor = self.sensors[key]
        size = len(sensor.deviations())
        speed = ""
        if isinstance(use.speed, RollingSpeed):
            speed = f"0.5 * {number(use.speed.radius)} * (value[2] + value[3])"
        elif use.speed is not None:
            speed = "hypot(value[0], value[1])"
        return {
            "name": identifier(key),
            "meaning": (type(sensor).__doc__ or "").strip().splitlines()[0],
            "size": size,
            "limit": number(largest_nis(use.gate, size)),
            "variance": _list(sensor.deviations() ** 2),
            "inputs": use.inputs,
            "speed": speed,
            "memories": [one["function"] for one in memories],
            "measurements": [
                {
                    "name": name,
                    "components": len(usual),
                    "limit": number(own),
                    "usual": _list(usual),
                    "function": "" if isinstance(make, Components) else getattr(make, "__name__", ""),
                    "made": [f"value[{i}]" for i in make.places] if isinstance(make, Components) else [],
                    "variances": [f"variance[{i}]" for i in make.places] if isinstance(make, Components) else [],
                }
                for name, make, own, usual in use.measurements
            ],
            "conditions": [
                {"name": name, "components": len(variances), "variances": _list(variances)}
                for name, _, variances in use.conditions
            ],
            "is_fix": self.filter.since_fix is not None and key in self.filter.fixes,
        }


def _name(key: str) -> str:
    """Name of a part in C."""
    return identifier(key) or _ALONE


def _of_kernel(function: ca.Function) -> str:
    """A function, and `run_` of it, which takes arguments and results as a `struct kernel` has them."""
    name, results = function.name(), [f"r{i}" for i in range(function.n_out())]
    given = ", ".join([*(f"a[{i}]" for i in range(function.n_in())), *(f"r[{i}]" for i in range(function.n_out()))])
    return c_function(function, results) + (
        f"static int run_{name}(const double **a, double **r, long long *integers, double *numbers, int memory) {{\n"
        f"    (void)integers, (void)numbers, (void)memory;\n    {name}({given});\n    return 0;\n}}\n"
    )


def _list(values: Iterable[float]) -> str:
    return ", ".join(repr(int(v)) if float(v).is_integer() and abs(v) < 1e9 else number(float(v)) for v in values)
