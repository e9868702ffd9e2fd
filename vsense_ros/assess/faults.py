"""What the observer does when sensors fail: each fault put into a recording, the observer run on it, and looked at.

Each case reports the largest error of the lateral velocity from the fault on, that error over the standard deviation
that the observer states, beside the same of the drive without the fault, what was said of the sensor and after which
time, and how long after the fault the error was more than `LATERAL` still.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate import faults
from vsense_ros.evaluate.faults import ACCELEROMETER, FIX, GYRO, IMU, VELOCITY, WHEELS, Fault
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.catalogue import FILTERS as NAVIGATION
from vsense_ros.runner import Runner
from vsense_ros.runner.catalogue import every_filter

Array = NDArray[np.float64]

LATERAL = 0.3  # [m/s] error of the lateral velocity at most
SIGMAS = 3.0  # standard deviations within which it is to be, or within
USUAL = 1.1  # times as many as on the drive without the fault
RECOVERED = 2.0  # [s] after the end of a fault, when the error is to be small
SETTLED = 2.0  # [s] from the start of a recording on
CIRCLE, LANE_CHANGE, DWELL, STEP, BRAKE = (
    *("steady_state_circle", "double_lane_change", "sine_with_dwell", "step_steer", "brake_in_turn"),
)
RAV4 = "comma2k19_rav4"
YAW, SIDEWAYS = [2], [1]
ALL = [0, 1, 2]


@dataclass(frozen=True)
class Run:
    """What an observer made of a recording: at each of n estimates time [s] after the start, errors of the lateral
    velocity and of the position (n, 2), their standard deviations, and each line of diagnostics, when it changed."""

    t: Array
    lateral: Array
    lateral_deviation: Array
    position: Array
    position_deviation: Array
    said: Mapping[str, Sequence[tuple[float, Diagnostic]]]
    resets: int

    def after(self, begin: float) -> NDArray[np.bool_]:
        """Estimates from a time [s] on, once the filter has settled."""
        return self.t >= max(begin, SETTLED)


def observe(recording: Recording, vehicle: Vehicle, filter: str = "") -> Run:
    """Run a filter, by default the vehicle's observer, as `vsense run` does, and keep what it reports."""
    runner = _runner(recording, vehicle, filter)
    topics = tuple(topic for topic in runner.topics if topic in recording)
    rows: list[tuple[float, ...]] = []
    said: dict[str, list[tuple[float, Diagnostic]]] = {}
    last = asked = 0
    for sample in recording.samples(topics):
        runner.add(sample)
        now = sample.received or sample.stamp
        if now >= asked + 50_000_000:
            asked = now
            for line in runner.diagnostics(now):
                lines = said.setdefault(line.name, [])
                if not lines or (lines[-1][1].level, lines[-1][1].message) != (line.level, line.message):
                    lines.append(((now - recording.start) * 1e-9, line))
        if runner.started and runner.stamp >= last + 9_990_000:
            last = runner.stamp
            estimate = runner.estimate()
            if not estimate:  # the filter has just been given up, and waits for a start
                continue
            odometry = estimate[0].values
            twist, pose = (odometry[name].reshape(6, 6) for name in ("twist_covariance", "pose_covariance"))
            deviations = np.sqrt([twist[1, 1], *pose.diagonal()[:2]])
            rows.append((last, odometry["linear"][1], *odometry["position"][:2], *deviations))
    estimates = np.array(rows).reshape(-1, 7)
    reference = recording["reference/odometry"]
    t, at = (np.asarray((one - recording.start) * 1e-9, float) for one in (estimates[:, 0], reference.stamp))
    true = [
        np.interp(t, at, reference.columns[name][:, axis])
        for name, axis in (("linear", 1), ("position", 0), ("position", 1))
    ]
    error = estimates[:, 1:4] - np.column_stack(true)
    return Run(t, error[:, 0], estimates[:, 4], error[:, 1:], estimates[:, 5:], said, len(runner.resets.reported))


def _runner(recording: Recording, vehicle: Vehicle, filter: str) -> Runner:
    return Runner(vehicle, recording.map_origin, every_filter()[filter].make if filter else None)


@dataclass(frozen=True)
class Case:
    """A fault on a drive. `named` is the status that has to leave OK within the fault, empty where nothing needs to;
    `more` says what else must hold, in words and as a test of the run."""

    title: str
    drive: str
    faults: tuple[Fault, ...]
    named: str = "imu"
    more: tuple[str, Callable[[Run], bool]] | None = None
    group: str = "inertial"

    @property
    def vehicle(self) -> str:
        """The name of its file."""
        return "rav4" if self.drive == RAV4 else "prototype_model"

    @property
    def times(self) -> tuple[float, float]:
        """Begin and end [s]."""
        return min(f.begin for f in self.faults), max(f.end for f in self.faults)


@dataclass(frozen=True)
class Outcome:
    """What became of a case."""

    title: str
    drive: str
    lateral: float  # largest error [m/s]
    sigmas: float  # largest error over its standard deviation
    sigmas_undisturbed: float  # the same without the fault
    said: str
    said_after: float  # [s]
    recovered: float  # time after the end of the fault for which the error was too large [s]
    more: str = ""
    failed: tuple[str, ...] = field(default=())  # what does not hold

    @property
    def holds(self) -> bool:
        """True if every requirement is met."""
        return not self.failed


def judge(case: Case, run: Run, undisturbed: Run, *, strict: bool = True) -> Outcome:
    """What became of a case, beside the same drive without the fault.

    The lateral velocity has to be right, and within the deviation that is stated. Where this is not `strict`, of a
    filter that does not know the car, either is enough, and right is what it is without the fault.
    """
    begin, end = case.times
    part = run.after(begin)
    error, sigma = np.abs(run.lateral[part]), run.lateral_deviation[part]
    whole = undisturbed.after(begin)
    usual_error, usual_sigma = np.abs(undisturbed.lateral[whole]), undisturbed.lateral_deviation[whole]
    usual = float((usual_error / usual_sigma).max(initial=0.0))
    most = LATERAL if strict else max(LATERAL, USUAL * float(usual_error.max(initial=0.0)))
    most_sigmas = max(SIGMAS, USUAL * usual)
    lateral, sigmas = float(error.max(initial=0.0)), float((error / sigma).max(initial=0.0))
    wrong = error > most if strict else (error > most) & (error > most_sigmas * sigma)
    large = run.t[part][wrong]
    recovered = max(float(large.max()) - end, 0.0) if large.size and np.isfinite(end) else 0.0
    named = case.named if run.t.size else "observer"  # which says what it waits for, where it never starts
    first = begin if run.t.size else 0.0
    lines = [(t, d) for t, d in run.said.get(named, ()) if first <= t <= end + 1.0 and d.level is not Level.OK]
    said, after = (lines[0][1].message, lines[0][0] - begin) if lines else ("", np.nan)
    failed = []
    if large.size:
        failed.append("lateral velocity")
    if strict and sigmas > most_sigmas:
        failed.append("standard deviation")
    if case.named and not lines:
        failed.append("not named")
    if recovered > RECOVERED:
        failed.append("not recovered")
    if case.more is not None and not case.more[1](run):
        failed.append(case.more[0])
    more = "" if case.more is None else case.more[0]
    return Outcome(case.title, case.drive, lateral, sigmas, usual, said, after, recovered, more, tuple(failed))


@cache
def drive(name: str) -> Recording:
    """A recording that cases are made of. Raises `InputError` where it is not here."""
    if name == RAV4:
        return import_recording(datasets.fetch(name))
    path = shared_folder("bags") / name
    if not path.exists():
        raise InputError(f"{path} is not there; `make bags` generates it")
    return import_recording(path)


@cache
def _undisturbed(name: str, vehicle: str, filter: str) -> Run:
    return observe(drive(name), load_vehicle(vehicle_path(vehicle)), filter)


def examine(case: Case, filter: str = "") -> Outcome:
    """Run a case with a filter, by default the observer. Raises `InputError` where its recording is not here."""
    recording = drive(case.drive)
    for fault in case.faults:
        recording = fault.of(recording)
    run = observe(recording, load_vehicle(vehicle_path(case.vehicle)), filter)
    return judge(case, run, _undisturbed(case.drive, case.vehicle, filter), strict=filter not in NAVIGATION.names)


def concerns(case: Case, filter: str) -> bool:
    """True if a fault matters to a filter: it uses the sensor; it estimates a position where that is looked at; and for
    a velocity that is wrong for good, it has another that contradicts."""
    adapter = _runner(Recording({}), load_vehicle(vehicle_path(case.vehicle)), filter).adapter
    used = {sensor.topic: sensor for name, sensor in adapter.sensors.items() if adapter.uses(name)}
    topics = {topic for fault in case.faults for topic in fault.topics}
    if FIX in topics:
        return adapter.has_position
    if topics == {VELOCITY}:
        return any(topic != VELOCITY and sensor.measures_speed for topic, sensor in used.items())
    return bool(topics & set(used))


def _imu(title: str, of: str, change: faults.Change, begin: float, length: float = np.inf, named: str = "imu") -> Case:
    return Case(title, of, (Fault(title, (IMU,), change, begin, begin + length),), named)


def _offsets() -> list[Case]:
    """Amounts, signs, times and axes."""
    cases = []
    for of, begin in ((CIRCLE, 6.0), (LANE_CHANGE, 3.5), (DWELL, 2.2), (STEP, 4.0), (RAV4, 20.0), (RAV4, 41.0)):
        for field_, unit, axes, amounts in (
            (GYRO, "rad/s", (0, 1, 2), (0.1, -0.3, 1.0)),
            (ACCELEROMETER, "m/s²", (0, 1, 2), (-3.0, 5.0, 20.0)),
        ):
            for axis, amount, length in zip(axes, amounts, (2.0, 0.5, 1.0), strict=True):
                title = (
                    f"{'gyro' if field_ == GYRO else 'accelerometer'} {'xyz'[axis]} {amount:+g} {unit}, {length:g} s"
                )
                cases.append(_imu(title, of, faults.added(field_, [axis], amount), begin, length))
    return cases


def _place_is(run: Run, word: str, until: float) -> bool:
    return any(word in line.message and t < until for t, line in run.said["observer"])


def _levels(run: Run, begin: float) -> int:
    """Changes of the headline's level from a time [s] on."""
    levels = [line.level for t, line in run.said["observer"] if t >= begin]
    return sum(a != b for a, b in pairwise(levels))


_GNSS = (FIX, VELOCITY)
CASES: tuple[Case, ...] = (
    _imu("accelerometers zero", CIRCLE, faults.replaced(ACCELEROMETER, ALL, 0.0), 8.0),
    _imu("gyro z +0.5 rad/s, 0.4 s", CIRCLE, faults.added(GYRO, YAW, 0.5), 8.0, 0.4),
    _imu("gyro z +3 rad/s, 3 s", CIRCLE, faults.added(GYRO, YAW, 3.0), 8.0, 3.0),
    _imu("gyro z +3 rad/s, 0.3 s", CIRCLE, faults.added(GYRO, YAW, 3.0), 8.0, 0.3),
    _imu("gyro z +3 rad/s, one sample", CIRCLE, faults.added(GYRO, YAW, 3.0), 8.0, 0.004),
    _imu("gyro z zero", CIRCLE, faults.replaced(GYRO, YAW, 0.0), 8.0),
    _imu("gyro z nothing but noise", LANE_CHANGE, faults.noise(GYRO, YAW, 0.00175), 2.5),
    _imu("gyro z 50 % more", CIRCLE, faults.scaled(GYRO, YAW, 1.5), 8.0, 4.0),
    _imu("gyro z +0.1 rad/s, rising for 1 s", CIRCLE, faults.added(GYRO, YAW, 0.1, rise=1.0), 8.0, 4.0),
    _imu("gyro z +0.5 rad/s, 1 s", LANE_CHANGE, faults.added(GYRO, YAW, 0.5), 4.0, 1.0),
    _imu("gyro z +0.5 rad/s, 0.7 s", RAV4, faults.added(GYRO, YAW, 0.5), 20.0, 0.7),
    _imu("gyro z +1 rad/s, 1.5 s", RAV4, faults.added(GYRO, YAW, 1.0), 20.0, 1.5),
    _imu("accelerometer y -2 m/s², 1 s", LANE_CHANGE, faults.added(ACCELEROMETER, SIDEWAYS, -2.0), 3.0, 1.0),
    _imu("gyros frozen", LANE_CHANGE, faults.held(GYRO, ALL), 4.0, 4.0),
    _imu("accelerometers frozen", LANE_CHANGE, faults.held(ACCELEROMETER, ALL), 4.0, 4.0),
    _imu("gyros absent", LANE_CHANGE, faults.replaced(GYRO, ALL, np.nan), 0.0),
    _imu("accelerometers absent", LANE_CHANGE, faults.replaced(ACCELEROMETER, ALL, np.nan), 0.0),
    _imu("10 kHz, alternating ±0.005 rad/s", CIRCLE, faults.shaken(1e4, 0.005, 0.0), 8.0, 1.0, named=""),
    _imu("10 kHz, alternating ±1 rad/s, ±5 m/s²", CIRCLE, faults.shaken(1e4, 1.0, 5.0), 8.0, 1.0, named=""),
    *(_imu(f"IMU at {rate:g} Hz", CIRCLE, faults.shaken(rate, 0.0, 0.0), 8.0, 4.0, named="") for rate in (83.0, 750.0)),
    Case(
        "position jumps by 20 m and stays", CIRCLE, (Fault("", (FIX,), faults.moved(0.0, 20.0), 8.0),), "position",
        ("one reset, to 1 m", lambda run: run.resets == 1 and abs(np.hypot(*run.position[-1]) - 20.0) < 1.0), "GNSS",
    ),
    Case(
        "position jumps by 20 m and stays", RAV4, (Fault("", (FIX,), faults.moved(20.0, 0.0), 20.0),), "position",
        ("one reset, to 1 m", lambda run: run.resets == 1 and abs(np.hypot(*run.position[-1]) - 20.0) < 2.0), "GNSS",
    ),
    Case(
        "position jumps by 20 m for 1.5 s", CIRCLE, (Fault("", (FIX,), faults.moved(0.0, 20.0), 8.0, 9.5),), "position",
        ("no reset", lambda run: run.resets == 0 and np.hypot(*run.position[-1]) < 1.0), "GNSS",
    ),
    Case(
        "fix lost", CIRCLE, (Fault("", (FIX,), faults.without_fix, 8.0),), "observer",
        ("dead reckoning, invalid within 5.1 s", lambda run: _place_is(run, "dead reckoning", 9.2)
         and _place_is(run, "position not valid", 13.1)), "GNSS",
    ),
    Case(
        "GNSS silent for 11 s", CIRCLE, (Fault("", _GNSS, faults.silent, 6.0, 17.0),), "observer",
        ("position within 1 m", lambda run: np.hypot(*run.position[-1]) < 1.0), "GNSS",
    ),
    Case(
        "GNSS velocity 5 m/s too fast", CIRCLE, (Fault("", (VELOCITY,), faults.scaled("linear", ALL, 1.4), 8.0),),
        "velocity", ("not believed", lambda run: run.resets == 0), "GNSS",
    ),
    Case(
        "a fix every 2.6 s", CIRCLE, (Fault("", (FIX,), faults.rare(2.6), 4.0),), "observer",
        ("at most 2 changes of level", lambda run: _levels(run, 4.0) <= 2), "GNSS",
    ),
    Case(
        "GNSS never there", LANE_CHANGE, (Fault("", _GNSS, faults.silent, 0.0),), "position",
        ("says so", lambda run: _place_is(run, "until GNSS comes", 12.0)), "GNSS",
    ),
    Case(
        "IMU silent for 3 s", LANE_CHANGE, (Fault("", (IMU,), faults.silent, 4.0, 7.0),), "imu",
        ("within 0.25 s", lambda run: any(4.0 < t < 4.25 and d.level is Level.STALE for t, d in run.said["imu"])),
        "GNSS",
    ),
    Case("wheel speeds silent for 4 s", CIRCLE, (Fault("", (WHEELS,), faults.silent, 8.0, 12.0),), "wheel_speeds"),
    *_offsets(),
)  # fmt: skip


def table(outcomes: Sequence[Outcome]) -> Table:
    """Table of the outcomes for the terminal."""
    rows = Table(box=box.SIMPLE_HEAD)
    for heading in ("fault", "drive"):
        rows.add_column(heading)
    for heading in ("lateral velocity\n[m/s]", "error/σ\n(without)", "said\nafter [s]", "too large\nafter [s]"):
        rows.add_column(heading, justify="right")
    rows.add_column("holds")
    for one in outcomes:
        rows.add_row(
            one.title, one.drive.replace("_", " "), f"{one.lateral:.2f}",
            f"{one.sigmas:.1f} ({one.sigmas_undisturbed:.1f})",
            "–" if np.isnan(one.said_after) else f"{one.said_after:.2f}", f"{one.recovered:.1f}",
            "yes" if one.holds else f"no: {', '.join(one.failed)}",
        )  # fmt: skip
    return rows


def write(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the outcomes as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [{**asdict(one), "holds": one.holds} for one in outcomes]
    path.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
