"""The accelerator measured: bits, clocks, resources, latency through topics, and iterations beside the thesis's."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies import fmu_tools
from studies.accelerated_covariance import compare
from studies.implementation import (
    Implementation,
    every_case,
    implementations,
    iterations_ratio,
    shares,
)
from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.faults import Faults
from vsense_ros.accelerator.kernels import KERNELS, Kernel
from vsense_ros.accelerator.kernels.suspension_motion import table
from vsense_ros.accelerator.rtl import Rtl, missing
from vsense_ros.export import fmu, fmu_check
from vsense_ros.manoeuvre import generate
from vsense_ros.model.vehicle import Vehicle

Words = NDArray[np.uint32]
SPECIAL = np.array(
    [0, 0x80000000, 0x7F800000, 0xFF800000, 0x7FC00000, 0x00800000, 0x7F7FFFFF, 1, 0x807FFFFF, 0x3F7FFFFF, 0x00FFFFFF],
    np.uint32,
)


def requests(kernel: Kernel, count: int, seed: int = 1) -> Words:
    """Requests of a kernel: random, of every condition, a part of them with special numbers in it."""
    random = np.random.default_rng(seed)
    if kernel.size:
        n = kernel.size
        q = np.linalg.qr(random.standard_normal((count, n, n)))[0]
        w = 10 ** -(random.uniform(0, 6, (count, 1)) * random.uniform(0, 1, (count, n)))
        a = (q * w[:, None, :]) @ q.transpose(0, 2, 1) * 1500
        b = random.standard_normal((count, n, 1)) * 10 ** random.uniform(-3, 4, (count, 1, 1))
        values = np.concatenate([(a + a.transpose(0, 2, 1)) / 2, b], axis=2).reshape(count, -1)
    else:
        values = random.standard_normal((count, kernel.words_in)) * 10 ** random.uniform(-3, 3, (count, 1))
    words = values.astype(np.float32).view(np.uint32)
    for i in np.flatnonzero(random.random(count) < 0.1):
        words[i, random.integers(words.shape[1])] = random.choice(SPECIAL)
    return words


def coefficients(vehicle: Vehicle) -> Words:
    """Those of a vehicle's suspension tables for the kernel of suspension motion."""
    assert vehicle.suspension is not None
    return table(dict(vehicle.suspension.front), dict(vehicle.suspension.rear))


def bit_exact(kernel: Kernel, vehicle: Vehicle, count: int, progress: Callable[[float], None]) -> tuple[int, int]:
    """Number of systems out of `count` for which hardware and mock give the same bits and clocks; and the clocks."""
    given = requests(kernel, count)
    own = coefficients(vehicle) if kernel.table_words else None
    rtl = Rtl(kernel)
    if own is not None:
        rtl.set_table(own)
    same, size = 0, max(1, count // 100)
    for begin in range(0, count, size):
        part = given[begin : begin + size]
        computed, refused, cycles = rtl.run(part)
        expected, expected_refused = kernel.run(part, own)
        alike = (computed == expected).all(axis=1) & (refused == expected_refused) & (cycles == kernel.cycles())
        same += int(alike.sum())
        progress((begin + len(part)) / count)
    return same, kernel.cycles()


def recorded(name: str) -> dict[str, Any]:
    """A file of the last run of `make hw` or `make hw-timing`."""
    path = resources.files("vsense_ros").joinpath(f"accelerator/{name}.json")
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def written(path: Path) -> dict[str, Any]:
    """What another target has written, if it was run."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


@dataclass(frozen=True)
class UnderFault:
    """A kind of fault in a fifth of all requests, one every 4 ms: how often it happened, the largest error of a
    solution over the largest of it, scaled as the accelerator scales; the longest a step waited over its deadline [-];
    how often the processor solved instead; and what the client counted."""

    requests: int
    happened: int
    worst: float
    longest: float
    fallbacks: int
    counted: dict[str, int]


def under_faults(count: int, progress: Callable[[float], None], share: float = 0.2) -> dict[str, UnderFault]:
    """Solves through a device that fails, for each kind of fault."""
    random = np.random.default_rng(5)
    root = random.standard_normal((50, 14, 14))
    systems = 1500 * (root @ root.transpose(0, 2, 1) / 14 + 0.1 * np.eye(14))
    outcomes = {}
    kinds = [field.name for field in fields(Faults) if field.name != "delay_ms"]
    for k, kind in enumerate(kinds):
        device = Device("mock", ("solve14",), faults=Faults(**{kind: share}))
        transport = Direct(device)
        client = Client(transport)
        worst = 0.0
        for i in range(count):
            transport.at(0.004 * i)
            a, b = systems[i % len(systems)], random.normal(0, 1000, 14)
            exact, solved = np.linalg.solve(a, b), client.solve(a, b)
            scale = np.sqrt(a.diagonal())
            worst = max(worst, float(np.abs((solved - exact) * scale).max() / np.abs(exact * scale).max()))
            if i % 500 == 0:
                progress((k + i / count) / len(kinds))
        counted = {name: n for name, n in client.counts.items() if n}
        happened = device.chance.happened[kind]
        longest = client.longest / client.deadline
        outcomes[kind] = UnderFault(count, happened, worst, longest, client.fallbacks, counted)
    progress(1.0)
    return outcomes


def units(vehicle: Vehicle, progress: Callable[[float], None]) -> dict[str, Any]:
    """The observer of a vehicle as units of FMI 2 and 3 on a lane change: whether FMPy validates them without a remark,
    and whether they have the bits of the exported C. Whether two cars in one process are right (`global_symbols`), and
    which `tools` drive a plant to the same place."""
    recording = generate("double_lane_change", vehicle)
    checked: dict[str, Any] = {}
    for i, version in enumerate((2, 3)):
        with TemporaryDirectory() as folder:
            path = Path(folder) / "observer.fmu"
            fmu.write(vehicle, path, version)
            agreement = fmu_check.compare(vehicle, path, version, recording)
        checked[f"fmi{version}"] = {
            "valid": not agreement.remarks, "bitwise": agreement.bitwise, "steps": agreement.steps,
            "from_python": agreement.python,
        }  # fmt: skip
        progress((i + 1) / 4)
    driven = fmu_tools.tools(vehicle)
    progress(3 / 4)
    checked |= {"global_symbols": fmu_tools.two_cars_in_one_process(vehicle), "tools": driven}
    progress(1.0)
    return checked


def implementation_table(
    vehicle: Vehicle, short: bool, progress: Callable[[str], Any]
) -> tuple[dict[str, Any], list[Implementation]]:
    """The thesis's tables again; in `short` those lines of 4 ms and his finest tolerance, on a drive of 1.2 s."""
    chosen = [case for case in every_case() if not short or (case.step, case.tolerance) == (4, 1e-5)]
    with progress("implementation table") as done:
        rows = implementations(vehicle, done, chosen, short)
    return {
        "drives": "short" if short else "thesis",
        "implementation": [asdict(row) | {"seconds": row.seconds, "his": row.his} for row in rows],
        "shares": shares(vehicle, rows),
        "iterations_ratio": iterations_ratio(rows),
        "largest_difference": max(row.difference for row in rows),
    }, rows


def results(
    vehicle: Vehicle, systems: int, asked: int, short: bool, progress: Callable[[str], Any]
) -> tuple[dict[str, Any], list[Implementation]]:
    """Everything that `make accelerator` writes, and the implementation table."""
    used, content = recorded("resources"), {}
    for name, kernel in KERNELS.items():
        variant = next(v for v, p in kernel.variants.items() if kernel.parameters | p == kernel.parameters)
        figures = used.get(f"{name}/{variant}", {})
        exact = None
        if not missing():
            with progress(f"{name}: {systems} systems") as done:
                exact, _ = bit_exact(kernel, vehicle, systems, done)
        content[name] = {
            "cycles": kernel.cycles(), **{key: figures.get(key) for key in ("dsp", "lut", "ff", "bram")},
            "systems_bit_exact": exact, "systems": systems,
        }  # fmt: skip
    nodes = {}
    for backend in ("mock", "rtl"):
        if backend == "rtl" and missing():
            continue
        try:
            from studies.accelerator_latency import through_topics

            with progress(f"node, {backend}") as done:
                times = through_topics(backend, done)
        except ImportError:
            continue
        nodes[backend] = {f"p{q:g}_ms": float(np.percentile(times, q)) for q in (50, 99)}
    table, rows = implementation_table(vehicle, short, progress)
    with progress(f"{asked} requests under each fault") as done:
        faults = under_faults(asked, done)
    with progress("units of FMI") as done:
        fmi = units(vehicle, done)
    with progress("covariance in binary32") as done:
        covariance = compare(vehicle, generate("double_lane_change", vehicle), 4.0, done)
    return {
        "kernels": content,
        "node": nodes,
        **table,
        "timing_ecp5_mhz": {name: entry["mhz"] for name, entry in recorded("timing").items()},
        **{name: written(Path(f"out/{name}.json")) for name in ("arm", "formal", "exports")},
        "fmu": fmi,
        "covariance": asdict(covariance),
        "faults": {kind: asdict(one) for kind, one in faults.items()},
    }, rows


def write(content: dict[str, Any], path: Path) -> None:
    """Write what was measured as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
