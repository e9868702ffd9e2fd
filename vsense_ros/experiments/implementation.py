"""The tables "Implementation" of Rodríguez 2020 again: an observer on a Zynq-7020 with none or one of the kernels.

Iterations are counted; times are modelled: operations that the processor has left by what one of them takes, requests
by the clocks of the kernels and the link's cost. The simplified car moves by the implicit trapezoidal rule and drives
the second manoeuvre. The full car goes in substeps of 1 ms, whose iterations are counted for a step of 4 or 8 ms, and
drives a shorter one: the same throttle and steering from 10 m/s.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import chain, groupby, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.experiments.flop import Operations, flop_of_full, flop_of_simplified
from vsense_ros.experiments.partition import Device as Board
from vsense_ros.experiments.partition import load_device
from vsense_ros.experiments.thesis import Kind, driven, observe, observing, with_his_sensors
from vsense_ros.manoeuvre import generate
from vsense_ros.manoeuvre.driver import STEERING_RATE, ramp
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.throttle_and_steer import ANGLE, MANOEUVRES, TORQUE
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.implicit import ImplicitCar, accelerated
from vsense_ros.observer.state import Prior

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
FULL_SPEED, FULL_SECONDS, FULL_TURN = 10.0, 1.2, 0.2  # of the full car's drive: at the start [m/s]; whole, steering [s]
SHORT_DRIVE = 2.5  # [s] of the lane change that iterations are measured on
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


def drive_of_full(plant: Vehicle) -> tuple[Vehicle, Trajectory]:
    """His second manoeuvre from 10 m/s and with the steering at once, for the full car, and that car."""
    friction = MANOEUVRES[1].friction
    assert friction is not None
    car = with_his_sensors(plant.with_parameters({"road.friction": friction}))

    def driver(t: float, q: Array, u: Array) -> Array:
        return np.array([ANGLE * ramp(t, FULL_TURN, abs(ANGLE) / STEERING_RATE), 0.0, 0.0, TORQUE, TORQUE])

    q, u = rolling_straight(car, FULL_SPEED)
    return car, simulate_full_car(car, driver, FULL_SECONDS, step=1e-3, q=q, u=u)


class _Made:
    """Makes the filter of a line, which knows where it starts, and counts what its model does in a step."""

    def __init__(self, car: str, observer: str, kernels: tuple[str, ...], tolerance: float) -> None:
        self._full, self._learning, self._tolerance = car == "full", observer == "SPI", tolerance
        self._kernels = kernels
        self.device = Device("mock")
        self._transport = Direct(self.device)
        self.client = Client(self._transport)
        self._car: ImplicitCar | FullCarBlocks | None = None
        self._before = (0, 0)
        self._requests: Counter[str] = Counter()

    def __call__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        names = [("solve56" if self._full else "solve14") if n == "solve" else n for n in self._kernels]
        name = f"{'full_' if self._full else ''}{'spi' if self._learning else 'error_ekf'}"
        make = accelerated(name, self.client, names, self._transport.at, self._tolerance)
        made = make(vehicle, sensors, Prior.of(vehicle, sensors).placed())
        assert isinstance(made.car, ImplicitCar | FullCarBlocks)
        self._car = made.car
        self._before, self._requests = self._count(), Counter(self.device.counts)
        return made

    def _count(self) -> tuple[int, int]:
        """Steps and iterations so far."""
        if isinstance(self._car, FullCarBlocks):
            return self._car.plant.integrator.steps, self._car.plant.integrator.calls
        assert self._car is not None
        return self._car.steps, self._car.iterations

    def counted(self) -> tuple[int, int, Counter[str]]:
        """Steps of the model and iterations since the filter was made, and requests of each kernel."""
        (steps, iterations), (steps_before, before) = self._count(), self._before
        requests = Counter({name: self.device.counts[name] - self._requests[name] for name in KERNELS})
        return steps - steps_before, iterations - before, requests


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
        found: list[list[Implementation]] = [[] for _ in groups]
        for job in as_completed(jobs):
            found[jobs[job]] = job.result()
            progress(sum(map(len, found)) / len(cases))
    return list(chain.from_iterable(found))


def _lines(
    vehicle: Vehicle, cases: Sequence[Case], drive: tuple[Vehicle, Trajectory], board: Board
) -> list[Implementation]:
    """Lines that differ in their kernels alone, of which the first has none."""
    found: list[Implementation] = []
    alone: list[Array] = []
    for case in cases:
        line, outputs = _line(vehicle, case, drive, board)
        alone = alone or outputs
        apart = max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(outputs, alone, strict=True))
        found.append(replace(line, difference=apart))
    return found


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
    made = _Made(case.car, case.observer, kernels, case.tolerance)
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


def measured(vehicle: Vehicle, full: bool) -> tuple[float, float]:
    """Iterations of the errorEKF in a step of 4 ms at his finest tolerance, on a short drive, in double precision; and
    by how much more they are with the solver on the accelerator."""
    if full:
        car, trajectory = drive_of_full(vehicle)
        recording = record(trajectory, car, 0, name="turn", biased=False, every=STEPS[0])
        model = observing(vehicle, OBSERVERS["errorEKF"], STEPS[0])
    else:
        whole, model = generate("double_lane_change", vehicle), vehicle
        end = whole.first_stamp + round(1e9 * SHORT_DRIVE)
        recording = replace(whole, channels={c.topic: c.select(c.stamp < end) for c in whole.channels.values()})
    found = []
    for kernels in ("none", "solver"):
        made = _Made("full" if full else "simplified", "errorEKF", KERNEL_SETS[kernels], TOLERANCES[0])
        observe(recording, model, OBSERVERS["errorEKF"], STEPS[0], made)
        moves, iterated, _ = made.counted()
        found.append(iterated / max(moves, 1) * (STEPS[0] if full else 1))
    return found[0], found[1] / found[0]


def iterations_ratio(rows: Sequence[Implementation]) -> float:
    """Iterations with the solver on the accelerator over those in double precision, the largest of all lines."""
    alone = {(r.car, r.observer, r.step, r.tolerance): r.iterations for r in rows if r.kernels == "none"}
    return max(r.iterations / alone[r.car, r.observer, r.step, r.tolerance] for r in rows if r.kernels == "solver")


def shares(vehicle: Vehicle, rows: Sequence[Implementation]) -> dict[str, dict[str, float]]:
    """Of errorEKF and SPI, simplified and full, the shares of the thesis's kernels in the operations of a step of 4 ms
    at his finest tolerance, in percent."""
    found = {}
    for row in rows:
        if (row.kernels, row.step, row.tolerance) == ("none", 4, 1e-5):
            substeps = row.step if row.car == "full" else 1
            flop = flop_of(vehicle, row.car, row.observer, row.step)
            found[f"{row.car} {row.observer}"] = flop.shares(row.iterations, row.iterations + substeps)
    return found
