"""Every part of every sensor, failing in every way: the systematic table of faults.

A row is a part of a sensor × a kind of fault × a duration × a phase of driving × a drive that has such a phase.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, product, zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.assess.faults import CIRCLE, LANE_CHANGE, RAV4, drive
from vsense_ros.bag import datasets
from vsense_ros.bag.importers import genesis
from vsense_ros.evaluate import faults
from vsense_ros.evaluate.faults import (
    ACCELEROMETER,
    FIX,
    GYRO,
    IMU,
    PLACE,
    STEERING,
    VELOCITY,
    WHEELS,
    Change,
    Fault,
)
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]

RAMP = 2.0  # [s] in which a ramp reaches the large offset
SEED = 46  # of generated drives, and of the choice of some rows
DURATIONS: Mapping[str, float] = {"0.3 s": 0.3, "1 s": 1.0, "5 s": 5.0, "for good": np.inf}


@dataclass(frozen=True)
class Signal:
    """Components `axes` of a `field` of messages, and sizes of faults in its unit: a `small` and a `large` offset, a
    drift each second, the noise of a value that is stuck, and how much of a change is `noticeable`."""

    field: str
    axes: tuple[int, ...]
    small: float
    large: float
    drift: float
    noise: float
    noticeable: float

    def times(self, size: float) -> Signal:
        """The signal with all sizes so many times as large."""
        sizes = ("small", "large", "drift", "noise", "noticeable")
        return replace(self, **{name: size * getattr(self, name) for name in sizes})


@dataclass(frozen=True)
class Part:
    """What can fail by itself: signals of one topic.

    `line` is the line of diagnostics that has to name it. A part that is all of a sensor can also have wrong stamps, by
    `late` [s], and be in another frame or unit, which `frame` does to it.
    """

    name: str
    line: str
    topic: str
    signals: tuple[Signal, ...]
    late: float = 0.0
    frame: Callable[[], tuple[Change, ...]] | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of what can happen to it."""
        return (*OF_VALUES, *(OF_STAMPS if self.late else ()), *((WRONG_FRAME,) if self.frame is not None else ()))

    def changes(self, kind: str, size: float) -> tuple[Change, ...]:
        """What this kind of fault does to messages, one after the other; `size` times as much."""
        if kind in OF_STAMPS:
            return (faults.stamped(OF_STAMPS[kind] * self.late),)
        if kind == WRONG_FRAME:
            assert self.frame is not None
            return self.frame()
        made = tuple(OF_VALUES[kind](signal.times(size)) for signal in self.signals)
        return tuple(map(faults.on_map, made)) if self.topic == FIX else made


OF_VALUES: Mapping[str, Callable[[Signal], Change]] = {
    "zero": lambda s: faults.replaced(s.field, s.axes, 0.0),
    "stuck": lambda s: faults.held(s.field, s.axes),
    "stuck with noise": lambda s: faults.held(s.field, s.axes, s.noise),
    "×2": lambda s: faults.scaled(s.field, s.axes, 2.0),
    "×0.5": lambda s: faults.scaled(s.field, s.axes, 0.5),
    "sign": lambda s: faults.scaled(s.field, s.axes, -1.0),
    "small offset": lambda s: faults.added(s.field, s.axes, s.small),
    "large offset": lambda s: faults.added(s.field, s.axes, s.large),
    "ramp": lambda s: faults.added(s.field, s.axes, s.large, rise=RAMP),
    "drift": lambda s: faults.drifting(s.field, s.axes, s.drift),
    "NaN": lambda s: faults.replaced(s.field, s.axes, np.nan),
}
OF_STAMPS: Mapping[str, float] = {"late": 1.0, "early": -1.0}
WRONG_FRAME = "wrong frame"

# [rad/s] and [m/s²]; noise of a good inertial sensor of a car.
_RATE = Signal(GYRO, (2,), small=0.02, large=0.5, drift=0.02, noise=0.003, noticeable=0.1)
_FORCE = Signal(ACCELEROMETER, (1,), small=0.3, large=5.0, drift=0.3, noise=0.1, noticeable=2.0)
# [rad] of the steering wheel. Noticeable is 0.1 rad/s of yaw rate, with a wheelbase of 2.7 m and a ratio of 16.
_ANGLE = Signal("position", (0,), small=0.1, large=1.05, drift=0.1, noise=0.005, noticeable=4.3)  # [rad m/s]
_SPIN = Signal("velocity", (0, 1, 2, 3), small=0.5, large=10.0, drift=1.0, noise=0.05, noticeable=5.0)  # [rad/s]
_SPEED = Signal("linear", (0, 1), small=0.3, large=5.0, drift=0.3, noise=0.05, noticeable=2.0)  # [m/s]
_FIX = Signal(PLACE, (0, 1), small=3.0, large=20.0, drift=1.0, noise=0.3, noticeable=10.0)  # [m]
_QUARTER = ((1, 0, 2), (1.0, -1.0, 1.0))  # axes and signs of a vector seen from a frame turned by 90° about z

_WHEELS = {"fl": 0, "rr": 3}  # of single wheels one that is steered, and one that is not

PARTS: Sequence[Part] = (
    *(Part(f"gyro {'xyz'[i]}", "imu", IMU, (replace(_RATE, axes=(i,)),)) for i in range(3)),
    *(Part(f"accelerometer {'xyz'[i]}", "imu", IMU, (replace(_FORCE, axes=(i,)),)) for i in range(3)),
    Part(
        "imu", "imu", IMU, (replace(_RATE, axes=(0, 1, 2)), replace(_FORCE, axes=(0, 1, 2))), late=0.1,
        frame=lambda: tuple(faults.turned(field, *_QUARTER) for field in (GYRO, ACCELEROMETER)),
    ),
    Part("steering", "steering", STEERING, (_ANGLE,), late=0.2,
         frame=lambda: (faults.scaled("position", [0], 180 / np.pi),)),  # degrees
    Part("wheels", "wheel_speeds", WHEELS, (_SPIN,), late=0.2,
         frame=lambda: (faults.turned("velocity", (1, 0, 3, 2), (1.0,) * 4),)),  # left and right exchanged
    *(Part(f"wheel {name}", "wheel_speeds", WHEELS, (replace(_SPIN, axes=(i,)),)) for name, i in _WHEELS.items()),
    Part("GNSS velocity", "velocity", VELOCITY, (_SPEED,), late=0.3,
         frame=lambda: (faults.turned("linear", (1, 0, 2), (1.0, 1.0, -1.0)),)),  # north, east, down
    Part("GNSS position", "position", FIX, (_FIX,), late=0.5,
         frame=lambda: (faults.on_map(faults.turned(PLACE, *_QUARTER)),)),
)  # fmt: skip


class Phase(NamedTuple):
    """A moment of a drive at which faults begin: `begin`, and the stretch that is run, from and to [s]. `lacks` are
    parts that the car does not have; its steering sensor measures `on_road_wheel` or else at the steering wheel."""

    name: str
    drive: str
    begin: float
    stretch: tuple[float, float]
    lacks: tuple[str, ...] = ()
    on_road_wheel: bool = False


STRAIGHT, STOP, GENESIS = "accelerate_and_brake", "stop_and_go", "genesis"
_GENESIS = ("wheels", "wheel fl", "wheel rr", "gyro x", "gyro y", "accelerometer z"), True
# Where a drive is straight or bends is seen in the yaw rate of its reference.
PHASES: Mapping[str, Sequence[Phase]] = {
    "straight": (
        Phase("straight", STRAIGHT, 5.0, (0.0, 14.0)),
        Phase("straight", RAV4, 45.0, (36.0, 56.0)),
        Phase("straight", GENESIS, 290.0, (282.0, 302.0), *_GENESIS),
    ),
    "bend": (
        Phase("bend", LANE_CHANGE, 3.5, (0.0, 12.0)),
        Phase("bend", CIRCLE, 10.0, (4.0, 19.0)),
        Phase("bend", GENESIS, 205.0, (196.0, 216.0), *_GENESIS),
    ),
    "standstill": (Phase("standstill", STOP, 7.0, (0.0, 17.0)),),
    "start": (
        Phase("start", LANE_CHANGE, 0.0, (0.0, 10.0)),
        Phase("start", RAV4, 40.0, (40.0, 52.0)),
        Phase("start", GENESIS, 200.0, (200.0, 212.0), *_GENESIS),
    ),
}


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    part: Part
    kind: str
    duration: str
    phase: Phase

    @property
    def name(self) -> str:
        """The row in words."""
        drive = self.phase.drive.replace("_", " ")
        return f"{self.part.name} {self.kind}, {self.duration}, {self.phase.name}, {drive}"

    @property
    def size(self) -> float:
        """Size of faults in the unit of the drive's sensor over that of the part."""
        return 1 / _ratio(self.phase.drive) if self.part.topic == STEERING and self.phase.on_road_wheel else 1.0

    @property
    def span(self) -> tuple[float, float]:
        """Begin and end of the fault [s from the start of the stretch]."""
        begin = self.phase.begin - self.phase.stretch[0]
        return begin, begin + DURATIONS[self.duration]

    def of(self, recording: Recording) -> Recording:
        """The stretch of the drive with the fault in it."""
        for change in self.part.changes(self.kind, self.size):
            recording = Fault(self.name, (self.part.topic,), change, *self.span).of(recording)
        return recording


def rows() -> list[Row]:
    """All rows."""
    phases = list(chain.from_iterable(PHASES.values()))
    return [
        Row(part, kind, duration, phase)
        for part in PARTS
        for kind, duration, phase in product(part.kinds, DURATIONS, phases)
        if part.name not in phase.lacks
    ]


def some_rows(count: int, seed: int = SEED, only: str = "") -> list[Row]:
    """So many of the rows that have the words `only` in their names, at random, from all parts in turn; the same ones
    for each seed, and fewer are the first of more."""
    rng = np.random.RandomState(seed)
    every = [row for row in rows() if only in row.name]
    by_part = [[row for row in every if row.part is part] for part in PARTS]
    mixed = [[some[i] for i in rng.permutation(len(some))] for some in by_part]
    return [row for row in chain.from_iterable(zip_longest(*mixed)) if row is not None][:count]


def car_of(name: str) -> Path:
    """The file of the car of a drive."""
    return vehicle_path({RAV4: "rav4", GENESIS: "genesis_identified"}.get(name, "prototype_model"))


@cache
def _ratio(name: str) -> float:
    """Angle of the steering wheel over that of the road wheels, of the car of a drive."""
    return load_vehicle(car_of(name)).physics.steering.ratio


@cache
def stretch(phase: Phase) -> Recording:
    """The part of a drive that is run. Raises `InputError` where its recording is not here."""
    if phase.drive == GENESIS:
        whole = genesis.read(datasets.fetch("genesis_oxts_can").parent / "med_lap_center_8_21.mat")
    elif phase.drive in (STRAIGHT, STOP):
        whole = generate(phase.drive, load_vehicle(vehicle_path("prototype_real")), SEED)
    else:
        whole = drive(phase.drive)
    return whole.between(*phase.stretch)
