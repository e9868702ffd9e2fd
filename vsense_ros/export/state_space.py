"""A filter of one state space as C99 sources: the operations that run in Python, around functions of its equations."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import casadi as ca
import jinja2
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import UNLIMITED, Jacobians
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS

_PARTS = ("estimation/algebra.c", "codegen/kernel.c", "estimation/found.c", "estimation/ekf.c")


def write(vehicle: Vehicle, name: str, folder: Path) -> list[Path]:
    """Write the filter of this name with the numbers of a vehicle into `folder`, which is made where it is missing;
    returns the files. Raises `InputError` for an unknown filter, and for one of several state spaces."""
    definition = DEFINITIONS[FILTERS[name].name][1]
    numbers = car_numbers(vehicle, vehicle.sensing().values())
    if not isinstance(definition.make(numbers), Ekf):
        raise InputError(f"{name}: only an extended Kalman filter of one state space can be written as C")
    ((system, measurements),) = definition.parts.values()
    made = Jacobians(system, measurements)
    transition, retract, *sense = made.written
    start = definition.start(numbers)
    values = {
        "title": FILTERS[name].title,
        "name": name,
        "states": system.names,
        "errors": system.error_names,
        "inputs": system.inputs,
        "parameters": system.parameters,
        "measurements": [{"name": one.name, "components": len(one.deviations)} for one in measurements],
        "functions": _functions(made.written),
        "largest": _list(system.largest.get(one, UNLIMITED) for one in system.names),
        "row": _list(made.row),
        "column": _list(made.column),
        "place": _list(made.place) or "0",
        "placed": len(made.place),
        "elements": transition.nnz_out(1),
        "added": transition.nnz_out(2),
        "deviations": _list(np.sqrt(np.diag(start.covariance))),
        "mean": _list(start.mean),
        "values": _list(numbers[one] for one in system.parameters) or "0",
        "senses": ", ".join(one.name() for one in sense) or "0",
        "components": _list(len(one.deviations) for one in measurements) or "0",
        "flat": system.is_flat,
        "work": {
            "transition": _work([transition]),
            "retract": _work([retract]),
            "sense": _work(sense or [transition]),
        },
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("vsense_ros.export", "templates"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    texts = {f"{name}.{end}": environment.get_template(f"filter.{end}.j2").render(values) for end in ("h", "c")}
    for part in _PARTS:
        texts[Path(part).name] = resources.files("vsense_ros").joinpath(part).read_text(encoding="utf-8")
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in texts]


def _functions(functions: Iterable[ca.Function]) -> str:
    """Their C, as CasADi writes it, for this file alone."""
    generator = ca.CodeGenerator("functions.c", {"with_header": False, "with_export": False})
    for one in functions:
        generator.add(one)
    return str(generator.dump())


def _work(functions: Iterable[ca.Function]) -> dict[str, int]:
    """What the largest of some functions needs, at least 1 of each."""
    sizes: Any = np.array([(f.sz_arg(), f.sz_res(), f.sz_iw(), f.sz_w()) for f in functions]).max(axis=0)
    return dict(zip(("arguments", "results", "integers", "numbers"), np.maximum(sizes, 1).tolist(), strict=True))


def _list(values: Iterable[float]) -> str:
    return ", ".join(repr(int(v)) if float(v).is_integer() and abs(v) < 1e9 else repr(float(v)) for v in values)
