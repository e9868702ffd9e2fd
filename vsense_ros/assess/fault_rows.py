"""Every part of every sensor, failing in every way: the systematic table of faults.

A row is a part of a sensor × a kind of fault × a duration × a phase of driving, on one of the drives that have such a
phase. Where the recording is generated the error is that against the truth; on a real drive, whose reference has errors
of its own, it is what the fault changes of the estimate.

A row holds if

- the lateral velocity is never off by more than `LATERAL` *and* by more than `SIGMAS` of its standard deviations,
- the headline is never OK for longer than `LONGEST_OK` while it is off by more than these standard deviations,
- the sensor that fails is named, where the fault changes what it reports by more than the part's `noticeable`, and
- no other sensor is taken out for longer than `LONGEST_OUT`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import chain, product, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pymap3d
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from vsense_ros.assess.faults import CIRCLE, LANE_CHANGE, LATERAL, RAV4, SIGMAS, USUAL, Run, drive, observe
from vsense_ros.bag import datasets
from vsense_ros.bag.importers import genesis
from vsense_ros.checks.aligned import stretches
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
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]

LONGEST_OK = 0.5  # [s] of a headline that is OK while the estimate is outside of its standard deviations
LONGEST_OUT = 2.0  # [s] for which a sensor that is right may be out
NAMED_WITHIN = 1.0  # [s] after the end of a fault
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
    """All rows; the drives of a phase take turns."""
    made = []
    for i, part in enumerate(PARTS):
        for (j, kind), (k, duration), phases in product(enumerate(part.kinds), enumerate(DURATIONS), PHASES.values()):
            drives = [phase for phase in phases if part.name not in phase.lacks]
            made.append(Row(part, kind, duration, drives[(i + j + k) % len(drives)]))
    return made


def some_rows(count: int, of: Sequence[Row] | None = None) -> list[Row]:
    """So many of the rows, from all parts in turn; the same ones each time, and fewer are the first of more."""
    rng = np.random.RandomState(SEED)
    every = rows() if of is None else of
    by_part = [[row for row in every if row.part is part] for part in PARTS]
    mixed = [[some[i] for i in rng.permutation(len(some))] for some in by_part]
    return [row for row in chain.from_iterable(zip_longest(*mixed)) if row is not None][:count]


@dataclass(frozen=True)
class RowOutcome:
    """What became of a row."""

    row: str
    v_lat: float  # largest error of the lateral velocity from the fault on [m/s]
    sigmas: float  # largest error of it over its standard deviation
    in_sigma: bool  # whether it was always small, or within its standard deviations
    ok_outside: float  # longest time of an OK headline outside of them [s]
    named: bool | None  # None: the fault is not noticeable
    said: str  # of the sensor, or all others that are out
    right_out: float  # longest time for which a sensor that is right was out [s]
    position_sigmas: float  # largest error of the position over its standard deviation

    @property
    def holds(self) -> bool:
        """True if all that is required of a row holds."""
        return (
            self.in_sigma
            and self.ok_outside <= LONGEST_OK
            and self.named is not False
            and self.right_out <= LONGEST_OUT
        )


def examine(row: Row, filter: str = "") -> RowOutcome:
    """Run a row with a filter, by default the vehicle's observer. Raises `InputError` where its recording is not
    here."""
    recording = stretch(row.phase)
    broken = row.of(recording)
    vehicle = load_vehicle(_vehicle(row.phase.drive))
    clean = _undisturbed(row.phase, filter)
    return judge(row, observe(broken, vehicle, filter), clean, noticeable=_noticed(row, recording, broken))


def judge(row: Row, run: Run, clean: Run, *, noticeable: bool) -> RowOutcome:
    """What became of a row, whose drive without the fault gave `clean`."""
    begin, end = row.span
    part = run.after(begin)
    lateral, position = run.lateral, run.position
    usual = 0.0
    if row.phase.drive in (RAV4, GENESIS):
        # The estimate without the fault in place of the reference, of which both have the same error.
        lateral = lateral - np.interp(run.t, clean.t, clean.lateral)
        position = position - np.column_stack([np.interp(run.t, clean.t, axis) for axis in clean.position.T])
    else:
        settled = clean.after(begin)
        usual = float((np.abs(clean.lateral) / clean.lateral_deviation)[settled].max(initial=0.0))
    t, error, sigma = run.t[part], np.abs(lateral[part]), run.lateral_deviation[part]
    sigmas = error / sigma
    most = max(SIGMAS, USUAL * usual)
    outside = sigmas > most
    ok = _is_ok(run, "observer", t)
    usual_words = {_words(line.message) for _, line in clean.said.get(row.part.line, ())}
    complaints = [
        line.message
        for when, line in run.said.get(row.part.line, ())
        if begin <= when <= end + NAMED_WITHIN
        and line.level is not Level.OK
        and _words(line.message) not in usual_words
    ]
    headline = [line.message for when, line in run.said.get("observer", ()) if begin <= when <= end + NAMED_WITHIN]
    named = bool(complaints) or any(row.part.line in text for text in headline)
    topics = {name: sensor.topic for name, sensor in load_vehicle(_vehicle(row.phase.drive)).sensing().items()}
    out = {name: _longest_out(run, name, begin) for name, topic in topics.items() if topic != row.part.topic}
    worst = max(out, key=lambda name: out[name], default="")
    said = "; ".join([*complaints[:1], *([f"{worst} out"] if worst and out[worst] > LONGEST_OUT else [])])
    places = np.abs(position[part]) / run.position_deviation[part]
    return RowOutcome(
        row.name,
        v_lat=float(error.max(initial=0.0)),
        sigmas=float(sigmas.max(initial=0.0)),
        in_sigma=not bool((outside & (error > LATERAL)).any()),
        ok_outside=max((t[end - 1] - t[first] for first, end in stretches(outside & ok)), default=0.0),
        named=named if noticeable else None,
        said=said,
        right_out=out.get(worst, 0.0),
        position_sigmas=float(np.nan_to_num(places, nan=0.0).max(initial=0.0)),
    )


def _vehicle(name: str) -> Path:
    """The file of the car of a drive."""
    return vehicle_path({RAV4: "rav4", GENESIS: "genesis_identified"}.get(name, "prototype_model"))


@cache
def _ratio(name: str) -> float:
    """Angle of the steering wheel over that of the road wheels, of the car of a drive."""
    return load_vehicle(_vehicle(name)).physics.steering.ratio


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


@cache
def _undisturbed(phase: Phase, filter: str) -> Run:
    return observe(stretch(phase), load_vehicle(_vehicle(phase.drive)), filter)


def _noticed(row: Row, recording: Recording, broken: Recording) -> bool:
    """True if the fault changes what the part reports by more than is noticeable, as a root mean square over its
    time; a value that is gone is."""
    topic = row.part.topic
    original, changed = recording[topic], broken[topic]
    times = (original.stamp - recording.start) * 1e-9
    hit = (times >= row.span[0]) & (times < row.span[1])
    weight = np.ones(len(original))
    if topic == STEERING:
        truth = recording["reference/odometry"]
        weight = np.interp(original.stamp, truth.stamp, truth.columns["linear"][:, 0])
    for signal in row.part.signals:
        change = _values(changed, signal, original) - _values(original, signal, original)
        if not np.isfinite(change[hit]).all() and row.kind == "NaN":
            return True
        if np.sqrt(np.nanmean((weight[:, None] * change)[hit] ** 2)) > signal.times(row.size).noticeable:
            return True
    return False


def _values(channel: Channel, signal: Signal, at: Channel) -> Array:
    """What a signal of a channel (m, k) is at the stamps of another one; places in metres."""
    order = np.argsort(channel.stamp, kind="stable")
    if signal.field == PLACE and channel.topic == FIX:
        places, origin = ([one.columns[name][:, 0] for name in ("latitude", "longitude")] for one in (channel, at))
        there = [float(np.nanmedian(axis)) for axis in origin]
        columns = np.column_stack(pymap3d.geodetic2enu(*places, 0.0, *there, 0.0)[:2])
    else:
        columns = channel.columns[signal.field][:, list(signal.axes)]
    return np.column_stack([np.interp(at.stamp, channel.stamp[order], axis[order]) for axis in columns.T])


def _words(sentence: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"[\d.]+", "", sentence)


def _is_ok(run: Run, name: str, t: Array | float) -> NDArray[np.bool_]:
    """True at those of the times (n,) [s] at which a line of the diagnostics is OK."""
    changes = run.said.get(name, ())
    when = np.array([-np.inf, *(at for at, _ in changes)])
    ok = np.array([False, *(line.level is Level.OK for _, line in changes)])
    return np.asarray(ok[np.searchsorted(when, t, side="right") - 1])


def _longest_out(run: Run, name: str, begin: float) -> float:
    """Longest time from `begin` [s] on for which a sensor is not believed [s]."""
    longest, since = 0.0, None
    last = float(run.t[-1]) if len(run.t) else 0.0
    for when, line in (*run.said.get(name, ()), (last, None)):
        if since is not None:
            longest = max(longest, min(when, last) - max(since, begin))
        out = line is not None and (line.level is Level.ERROR or "not believed" in line.message)
        since = (when if since is None else since) if out else None
    return longest


def summary(outcomes: Sequence[RowOutcome]) -> dict[str, float]:
    """Shares of the rows [%] for which each requirement holds, and how many there are."""
    noticed = [one for one in outcomes if one.named is not None]

    def percent(of: Sequence[RowOutcome], holds: Callable[[RowOutcome], bool]) -> float:
        return 100.0 * sum(map(holds, of)) / max(len(of), 1)

    return {
        "rows": len(outcomes),
        "holds_percent": percent(outcomes, lambda one: one.holds),
        "lateral_percent": percent(outcomes, lambda one: one.in_sigma),
        "never_ok_outside_percent": percent(outcomes, lambda one: one.ok_outside <= LONGEST_OK),
        "named_percent": percent(noticed, lambda one: one.named is True),
        "no_right_sensor_out_percent": percent(outcomes, lambda one: one.right_out <= LONGEST_OUT),
    }


def as_json(outcomes: Sequence[RowOutcome]) -> dict[str, dict[str, Any]]:
    """The outcomes by row, ready for JSON."""
    return {one.row: {**{k: v for k, v in asdict(one).items() if k != "row"}, "holds": one.holds} for one in outcomes}


def table(outcomes: Sequence[RowOutcome]) -> Table:
    """Table of the rows that do not hold, and of the shares of all, for the terminal."""
    lines = Table(box=box.SIMPLE_HEAD)
    lines.add_column("row")
    for heading in ("v_lat\n[m/s]", "error/σ", "OK outside\n[s]", "right one\nout [s]"):
        lines.add_column(heading, justify="right")
    lines.add_column("named")
    for one in outcomes:
        if not one.holds:
            named = {None: "–", True: "yes", False: "no"}[one.named]
            figures = (f"{one.v_lat:.2f}", f"{one.sigmas:.1f}", f"{one.ok_outside:.1f}", f"{one.right_out:.1f}")
            lines.add_row(one.row, *figures, named)
    lines.add_section()
    for name, value in summary(outcomes).items():
        lines.add_row(name.replace("_", " ").replace("percent", "[%]"), f"{value:.4g}")
    return lines
