"""The tables "Implementation" of Rodríguez 2020 again: an observer on a Zynq-7020 with none or one of the kernels.

Iterations are counted; times are modelled: operations that the processor has left by what one of them takes, requests
by the clocks of the kernels and the link's cost. The simplified car moves by the implicit trapezoidal rule and drives
the second manoeuvre. The full car goes in substeps of 1 ms, whose iterations are counted for a step of 4 or 8 ms, and
drives a shorter one: the same throttle and steering from 10 m/s.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import chain, groupby, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.thesis import Kind, driven, observe, observing
from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.assess.flop import Operations, flop_of_full, flop_of_simplified
from vsense_ros.assess.iterations import CountedFilter, drive_of_full
from vsense_ros.assess.partition import Device as Board
from vsense_ros.assess.partition import load_device
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.simulation.closed_loop import Trajectory
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

STEPS, TOLERANCES = (4, 8), (1e-5, 2e-4, 1e-3)
# As he has them in his table.
KERNEL_SETS: dict[str, tuple[str, ...]] = {
    "none": (),
    "solver": ("solve",),
    "mass matrix": ("body_mass",),
    "suspension": ("suspension_motion",),
}
FULL_SETS = ("none", "solver", "mass matrix")  # the full car has no suspension tables
# Computing time of 10 s [s] and iterations in a step (slides, "Implementation").
HIS: dict[tuple[str, str, str, int, float], tuple[float, float]] = {
    ("simplified", "errorEKF", "none", 4, 1e-5): (7.673, 1.554),
    ("simplified", "errorEKF", "solver", 4, 1e-5): (7.465, 1.511),
    ("simplified", "SPI", "none", 4, 1e-5): (21.114, 1.512),
    ("simplified", "SPI", "solver", 4, 1e-5): (20.158, 1.544),
    ("simplified", "SPI", "none", 8, 1e-5): (13.346, 3.055),
    ("simplified", "SPI", "solver", 8, 1e-5): (12.843, 3.134),
    ("simplified", "SPI", "none", 8, 2e-4): (9.381, 1.046),
    ("simplified", "SPI", "solver", 8, 2e-4): (8.957, 1.047),
    ("full", "errorEKF", "none", 4, 1e-5): (81.870, 9.083),
    ("full", "errorEKF", "none", 4, 1e-3): (38.284, 1.419),
    ("full", "errorEKF", "solver", 4, 1e-5): (64.957, 8.652),
    ("full", "errorEKF", "solver", 4, 1e-3): (33.459, 1.388),
    ("full", "errorEKF", "mass matrix", 4, 1e-5): (83.622, 9.153),
    ("full", "errorEKF", "suspension", 4, 1e-5): (128.009, 16.792),
}
HIS_SHARES = {"mass matrix": 11.06, "update motion": 34.15, "solver": 12.89}  # of computing time, in percent
OBSERVERS = {"errorEKF": Kind("errorEKF", "error_ekf"), "SPI": Kind("SPI_EKF", "spi", "ekf")}
DRIVE = 10.0  # [s] that a computing time is for


class Case(NamedTuple):
    """Which line of the table."""

    car: str
    observer: str
    kernels: str
    step: int  # [ms]
    tolerance: float


@dataclass(frozen=True)
class Implementation:
    """A line of the table: an observer on the Zynq as modelled. Times are for 10 s of driving."""

    car: str
    observer: str
    kernels: str
    step: int  # [ms]
    tolerance: float
    iterations: float  # in a step
    clocks: float  # of the hardware in a step, link included
    accelerator_us: float  # of a step, with the set-up of transfers
    processor_us: float
    difference: float  # of forces and velocities from those of the processor alone, of the largest
    fallbacks: int

    @property
    def seconds(self) -> float:
        """Modelled computing time of a drive [s]."""
        return 1e-6 * (self.processor_us + self.accelerator_us) * DRIVE / (1e-3 * self.step)

    @property
    def his(self) -> tuple[float, float] | None:
        """His computing time [s] and iterations."""
        return HIS.get((self.car, self.observer, self.kernels, self.step, self.tolerance))


def implementations(
    vehicle: Vehicle, progress: Callable[[float], None], cases: Sequence[Case] | None = None, short: bool = False
) -> list[Implementation]:
    """All lines of the table, or those of `cases`; in `short` the simplified car drives what the full one does."""
    cases = list(every_case()) if cases is None else cases
    board = load_device("xc7z020")
    cars = {case.car for case in cases}
    drives = {car: drive_of_full(vehicle) for car in cars if short or car == "full"}
    if "simplified" in cars - set(drives):
        drives["simplified"] = driven(vehicle, MANOEUVRES[1])
    groups = [list(group) for _, group in groupby(cases, lambda case: case._replace(kernels=""))]
    with ProcessPoolExecutor(min(os.cpu_count() or 1, len(groups))) as pool:
        # The full car's take longest: they come first, so that no processor waits for the last of them.
        order = sorted(range(len(groups)), key=lambda i: groups[i][0].car)
        jobs = {pool.submit(_lines, vehicle, groups[i], drives[groups[i][0].car], board): i for i in order}
        lines: list[list[Implementation]] = [[] for _ in groups]
        for job in as_completed(jobs):
            lines[jobs[job]] = job.result()
            progress(sum(map(len, lines)) / len(cases))
    return list(chain.from_iterable(lines))


def _lines(
    vehicle: Vehicle, cases: Sequence[Case], drive: tuple[Vehicle, Trajectory], board: Board
) -> list[Implementation]:
    """Lines that differ in their kernels alone, of which the first has none."""
    lines: list[Implementation] = []
    alone: list[Array] = []
    for case in cases:
        line, outputs = _line(vehicle, case, drive, board)
        alone = alone or outputs
        apart = max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(outputs, alone, strict=True))
        lines.append(replace(line, difference=apart))
    return lines


def every_case() -> Iterator[Case]:
    """In the order of the table: those without kernels before those with them."""
    for car, observer, step in product(("simplified", "full"), OBSERVERS, STEPS):
        for tolerance, kernels in product(TOLERANCES, FULL_SETS if car == "full" else KERNEL_SETS):
            yield Case(car, observer, kernels, step, tolerance)


def _line(
    vehicle: Vehicle, case: Case, drive: tuple[Vehicle, Trajectory], board: Board
) -> tuple[Implementation, list[Array]]:
    """One line, without its difference, and forces and velocities."""
    kernels = KERNEL_SETS[case.kernels]
    kind = OBSERVERS[case.observer]
    made = CountedFilter(case.car == "full", case.observer == "SPI", kernels, case.tolerance)
    recording = record(drive[1], drive[0], 0, name=case.car, biased=False, every=case.step)
    _, output, _ = observe(recording, observing(vehicle, kind, case.step), kind, case.step, made)
    moves, iterated, requests = made.counted()
    substeps = case.step if case.car == "full" else 1
    count = max(moves / substeps, 1.0)
    iterations = iterated / count
    clocks = seconds = 0.0
    for name, number in requests.items():
        each = KERNELS[name].cycles() + board.link.cycles(KERNELS[name])
        clocks += number * each / count
        seconds += number * board.link.seconds(each) / count
    flop = flop_of(vehicle, case.car, case.observer, case.step)
    processor = board.processor_us(flop.processor(iterations, iterations + substeps, kernels))
    line = Implementation(
        case.car, case.observer, case.kernels, case.step, case.tolerance, iterations, clocks, 1e6 * seconds, processor,
        0.0, made.client.fallbacks,
    )  # fmt: skip
    wheels = [output[f"vsense/wheel_force/{wheel}"].columns["force"] for wheel in WHEELS]
    return line, [*wheels, output["vsense/odometry"].columns["linear"], output["vsense/odometry"].columns["angular"]]


def flop_of(vehicle: Vehicle, car: str, observer: str, step: int) -> Operations:
    """Operations of an observer of the table in a step of so many milliseconds."""
    model = observing(vehicle, OBSERVERS[observer], step)
    return flop_of_simplified(model) if car == "simplified" else flop_of_full(model, step)


def iterations_ratio(rows: Sequence[Implementation]) -> float:
    """Iterations with the solver on the accelerator over those in double precision, the largest of all lines."""
    alone = {(r.car, r.observer, r.step, r.tolerance): r.iterations for r in rows if r.kernels == "none"}
    return max(r.iterations / alone[r.car, r.observer, r.step, r.tolerance] for r in rows if r.kernels == "solver")


def shares(vehicle: Vehicle, rows: Sequence[Implementation]) -> dict[str, dict[str, float]]:
    """Shares of the thesis's kernels in the operations of a step of 4 ms at his finest tolerance [%], for errorEKF and
    SPI, simplified and full."""
    percent = {}
    for row in rows:
        if (row.kernels, row.step, row.tolerance) == ("none", 4, 1e-5):
            substeps = row.step if row.car == "full" else 1
            flop = flop_of(vehicle, row.car, row.observer, row.step)
            percent[f"{row.car} {row.observer}"] = flop.shares(row.iterations, row.iterations + substeps)
    return percent
