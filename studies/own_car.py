"""A newcomer's way with cars that are not ours: from catalogue values and ordinary drives to an estimate.

The newcomer has logs in formats of other makers (own_car_logs.py) and types commands: `new-vehicle`, `can` or
`import --guess`, `import`, `check`, `calibrate`, `identify`, and `run` on a drive that no step has used. No file is
edited. Five cars are simulated by the plants of test/blind, which share no equation with the package; what they hide,
and the true motion, stays with this study. Two more are recordings.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.own_car_logs import FORMATS, LogFormat
from studies.own_car_plants import PLANTS, Plant, blind, simulated
from vsense_ros.api.recording import read
from vsense_ros.bag import datasets, write_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Reference, Vehicle

Array = NDArray[np.float64]
Figures = Mapping[str, float | None]

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class OwnCarSettings:
    """Decisions of this study."""

    slowest: float = 3.0  # [m/s] above which a side slip is compared
    half_rav4: float = 30.0  # [s] of the RAV4's minute to calibrate on; the rest is held out
    warm_up: float = 2.0  # [s] that are not compared
    warm_up_genesis: float = 50.0  # [s] for which the heading of its reference is not settled, as README has it
    # Errors of catalogue values: of mass and of the load on the front axle [-], and of the steering ratio [-].
    mass_error: float = 0.03
    load_error: float = 0.01
    ratio_error: float = 0.05


SETTINGS = OwnCarSettings()


@dataclass(frozen=True)
class Truth:
    """What really happened on a drive: side slip [rad], yaw rate [rad/s] and wheel loads (n, 4) [N], where they are
    known, at stamps [ns]."""

    stamp: NDArray[np.int64]
    side_slip: Array
    yaw_rate: Array | None = None
    loads: Array | None = None
    speed: Array | None = None


@dataclass(frozen=True)
class Car:
    """A car with the options of `new-vehicle` that its catalogue fills, drives to learn from, and one held out with its
    truth. `radius` [m] is what its control unit takes a wheel for; `log` is None where recordings are bags already.
    `reference` is where the system that measured the truth sits, its x ahead of the rear axle [m]; None where the truth
    is that of the centre of gravity."""

    name: str
    catalogue: Mapping[str, str | float]
    drives: tuple[Recording, ...]
    held_out: Recording
    truth: Truth
    log: LogFormat | None = None
    radius: float = 0.0
    reference: Reference | None = None
    warm_up: float = SETTINGS.warm_up


@dataclass(frozen=True)
class Outcome:
    """What came of a car: the commands that were typed, minutes of computing, findings of `check`, what `calibrate`
    determined, and figures of the held-out drive with the file of `new-vehicle`, of `calibrate` and of `identify`."""

    commands: tuple[str, ...]
    minutes: float
    findings: int
    calibrated: tuple[str, ...]
    before: Figures
    by_calibration: Figures
    after: Figures


def cars(only: Sequence[str] = (), kind: str | None = None) -> Iterator[Car]:
    """The cars of the study, each made when it is asked for; `only` some of them, by name. With `kind`, all simulated
    cars are of this kind of plant."""
    plants = [one if kind is None else replace(one, kind=kind) for one in PLANTS]
    wanted = [one for one in plants if not only or one.name in only]
    makers: dict[str, Callable[[], Car]] = {one.name: partial(plant, one, wanted) for one in plants}
    makers |= {"Genesis": genesis, "RAV4": rav4}
    for unknown in set(only) - set(makers):
        raise InputError(f"--car: {unknown!r} is no car of this study; it has {', '.join(makers)}")
    for name, make in makers.items():
        if not only or name in only:
            yield make()


def genesis() -> Car:
    """The Genesis: slow and fast lap to calibrate on, the third held out."""
    folder = datasets.fetch("genesis_oxts_can").parent
    slow, fast, third = (
        import_recording(folder / name) for name in ("cpg_slow_lap.mat", "cpg_fast_lap.mat", "med_lap_center_8_21.mat")
    )
    values: dict[str, str | float] = {
        "mass": 2100.0, "wheelbase": 3.01, "track": 1.62, "track-rear": 1.65, "axle-load-front": 1090.0,
        "tyre": "245/45R18 100", "driven": "rear", "height": 1.48, "like": "saloon",
    }  # fmt: skip
    reference = _from_rear_axle(load_vehicle(vehicle_path("genesis")))
    return Car("Genesis", values, (slow, fast), third, _reference_of(third), reference=reference,
               warm_up=SETTINGS.warm_up_genesis)  # fmt: skip


def rav4() -> Car:
    """The RAV4: half of its minute to calibrate on, the other held out."""
    whole = import_recording(datasets.fetch("comma2k19_rav4"))
    values: dict[str, str | float] = {
        "mass": 1650.0, "wheelbase": 2.66, "track": 1.57, "axle-load-front": 970.0, "tyre": "225/65R17 102",
        "height": 1.70,
    }  # fmt: skip
    first, second = whole.between(None, SETTINGS.half_rav4), whole.between(SETTINGS.half_rav4, None)
    reference = _from_rear_axle(load_vehicle(vehicle_path("rav4")))
    return Car("RAV4", values, (first,), second, _reference_of(second), reference=reference)


def _from_rear_axle(vehicle: Vehicle) -> Reference:
    """Where the reference system of a vehicle file sits, ahead of the rear axle: the file counts from its centre of
    gravity, which other files of the car have elsewhere."""
    ahead, left, up = vehicle.reference.position
    position = (ahead + vehicle.physics.chassis.cog_to_rear_axle, left, up)
    return vehicle.reference.model_copy(update={"position": position})


def _with_reference(vehicle: Vehicle, reference: Reference | None) -> Vehicle:
    """A vehicle with the reference system at its place ahead of the rear axle."""
    if reference is None:
        return vehicle.model_copy(update={"reference": Reference()})
    ahead, left, up = reference.position
    position = (ahead - vehicle.physics.chassis.cog_to_rear_axle, left, up)
    return vehicle.model_copy(update={"reference": reference.model_copy(update={"position": position})})


def _reference_of(recording: Recording) -> Truth:
    signals = read_signals(recording, "reference")
    slip, speed = signals["side_slip"], signals["speed"]
    rate = signals.get("yaw_rate")
    return Truth(
        slip.stamp, slip.value[:, 0],
        None if rate is None else np.interp(slip.stamp, rate.stamp, rate.value[:, 0]),
        None, np.interp(slip.stamp, speed.stamp, speed.value[:, 0]),
    )  # fmt: skip


def plant(one: Plant, group: Sequence[Plant] = ()) -> Car:
    """A simulated car with the recordings of its sensors, and errors in its catalogue values; `group` are cars that are
    simulated with it."""
    hidden, lanes = simulated(one, group)
    car, rng, sensors = hidden.car, hidden.rng, blind("sensors")
    grade = sorted(sensors.GRADES)[0]
    bench = sensors.Bench(grade, sensors.Mounting.drawn(rng), sensors.Biases.drawn(sensors.GRADES[grade], rng), {})
    recordings = [
        bench.record(lane, course.name, i, rng)
        for i, (lane, course) in enumerate(zip(lanes, hidden.courses, strict=True))
    ]
    last = lanes[-1]
    stamp = (
        sensors.EPOCH + (len(lanes) - 1) * 120_000_000_000 + (np.arange(len(last["position"])) * 5e6).astype(np.int64)
    )
    forward, left = last["velocity"][:, 0], last["velocity"][:, 1]
    truth = Truth(stamp, np.arctan2(left, forward), last["rates"][:, 2], last["load"], forward)
    loaded = car.front.radius - car.mass * GRAVITY / 4 / car.front.tyre_vertical
    return Car(
        one.name, _catalogue_of(car, rng), tuple(recordings[:-1]), recordings[-1], truth, FORMATS[one.log],
        round(loaded * rng.uniform(0.99, 1.01), 3),
    )  # fmt: skip


def _catalogue_of(car: Any, rng: np.random.Generator) -> dict[str, str | float]:
    """What a catalogue would say of a plant, with the errors of `SETTINGS`."""
    mass = float(round(car.mass * (1 + SETTINGS.mass_error * rng.uniform(-1, 1))))
    share = car.rear_arm / car.wheelbase + SETTINGS.load_error * rng.uniform(-1, 1)
    sizes = {0.305: "185/60R15 84", 0.328: "225/50R17 94", 0.360: "235/60R18 103"}
    return {
        "mass": mass, "wheelbase": round(car.wheelbase, 2), "track": round(car.front.track, 2),
        "track-rear": round(car.rear.track, 2), "axle-load-front": float(round(mass * share)),
        "tyre": sizes[car.front.radius],
        "driven": "front" if car.front_drive == 1 else "rear" if car.front_drive == 0 else "all",
        "steering-ratio": round(car.ratio * (1 + SETTINGS.ratio_error * rng.uniform(-1, 1)), 1),
    }  # fmt: skip


class Terminal:
    """A newcomer's shell in a folder: `vsense` commands, each with what it took."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.typed: list[str] = []
        self.seconds = 0.0

    def vsense(self, *arguments: str, allowed: Sequence[int] = (0,)) -> str:
        """Run a command; what it printed. Raises `RuntimeError` where its exit code is none of those `allowed`."""
        begun = time.perf_counter()
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        done = subprocess.run(
            [sys.executable, "-m", "vsense_ros.cli", *arguments], cwd=self.folder, env=environment,
            capture_output=True, text=True, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        self.seconds += time.perf_counter() - begun
        self.typed.append(" ".join(["vsense", *arguments]))
        if done.returncode not in allowed:
            raise RuntimeError(f"{self.typed[-1]} (exit code {done.returncode})\n{done.stdout}\n{done.stderr}")
        return done.stdout


def newcomer(car: Car, kept: Path | None = None) -> Outcome:
    """The way of a newcomer with a car, by commands in a folder of its own; with `kept`, a folder that stays, in a
    folder there that has the car's name."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) if kept is None else kept / car.name.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        terminal = Terminal(folder)
        drives, held_out = _imported(car, terminal)
        options = [part for key, value in car.catalogue.items() for part in (f"--{key}", f"{value}")]
        terminal.vsense("new-vehicle", "my_car.yaml", *options)
        check = json.loads(terminal.vsense("check", "my_car.yaml", *drives, "--json", allowed=(0, 1)))
        calibration = json.loads(
            terminal.vsense("calibrate", *drives, "--vehicle", "my_car.yaml", "--output", "calibrated.yaml", "--json")
        )
        terminal.vsense(
            "identify", *drives, "--vehicle", "calibrated.yaml", "--model", "single_track", "--report", "identified"
        )
        files = ("my_car.yaml", "calibrated.yaml", "identified/vehicle.yaml")
        before, calibrated, after = (figures(car, terminal, file, held_out) for file in files)
        names = tuple(one["name"] for one in calibration["quantities"] if one["determined"])
        findings = len(check["findings"]) + len(check["fit"])
        return Outcome(
            tuple(terminal.typed), terminal.seconds / 60, findings, names, before, calibrated, after
        )  # fmt: skip


def _imported(car: Car, terminal: Terminal) -> tuple[list[str], str]:
    """The drives as bags in the newcomer's folder, imported by the commands that the format needs; their names."""
    recordings = {f"drive_{i + 1}": one for i, one in enumerate(car.drives)} | {"drive_held_out": car.held_out}
    *drives, held_out = recordings
    if car.log is None:
        for name, recording in recordings.items():
            write_bag(terminal.folder / name, recording)
        return drives, held_out
    logs = {name: f"log_{name}{car.log.suffix}" for name in recordings}
    for name, recording in recordings.items():
        car.log.write(recording, terminal.folder / logs[name], car.radius)
    database = []
    if car.log.database:
        (terminal.folder / "car.dbc").write_text(car.log.database, encoding="utf-8")
        database = ["--dbc", "car.dbc"]
        terminal.vsense("can", logs[drives[0]], *database, "--output", "mapping.yaml")
    else:
        proposed = terminal.vsense("import", logs[drives[0]], "--guess")
        (terminal.folder / "mapping.yaml").write_text(proposed, encoding="utf-8")
    for name in recordings:
        terminal.vsense("import", logs[name], name, *database, "--mapping", "mapping.yaml")
    return drives, held_out


def figures(car: Car, terminal: Terminal, file: str, held_out: str) -> dict[str, float | None]:
    """Errors of `vsense run` on the held-out drive: side slip [deg], share within two standard deviations, yaw rate
    [deg/s], vertical forces [% of the mean load of a wheel]; None where the truth is not known."""
    out = re.sub(r"\W", "_", file)
    terminal.vsense("run", held_out, "--vehicle", file, "--out", out)
    vehicle = _with_reference(load_vehicle(terminal.folder / file), car.reference)
    output = read_signals(at_reference(read(terminal.folder / out / "output"), vehicle), "vsense")
    truth = car.truth
    # A table counts from its first row: both begin with the first message of the inertial sensor.
    first = read(terminal.folder / held_out)["imu/data"].stamp[0]
    imu = car.held_out["imu/data"]
    logged = imu.received[0] if car.log is not None and car.log.logs_arrival else imu.stamp[0]
    stamp = truth.stamp + (first - logged)
    begin = stamp[0] + round(car.warm_up * 1e9)

    def at(name: str, values: Array) -> tuple[Array, Array]:
        series = output[name]
        rows = (series.stamp > begin) & (series.stamp < stamp[-1])
        if truth.speed is not None:
            rows &= np.interp(series.stamp, stamp, truth.speed) > SETTINGS.slowest
        error = series.value[rows, 0] - np.interp(series.stamp[rows], stamp, values)
        deviation = np.full(len(error), np.nan) if series.deviation is None else series.deviation[rows]
        return error, deviation

    error, deviation = at("side_slip", truth.side_slip)
    found: dict[str, float | None] = {
        "side_slip_deg": float(np.degrees(np.sqrt(np.mean(error**2)))),
        "within_2s": float(np.mean(np.abs(error) < 2 * deviation)),
        "yaw_rate_deg_s": None,
        "fz_percent": None,
    }
    if truth.yaw_rate is not None:
        found["yaw_rate_deg_s"] = float(np.degrees(np.sqrt(np.mean(at("yaw_rate", truth.yaw_rate)[0] ** 2))))
    if truth.loads is not None:
        errors = [at(f"wheel_force_{wheel}_z", truth.loads[:, i])[0] for i, wheel in enumerate(WHEELS)]
        found["fz_percent"] = float(100 * np.sqrt(np.mean(np.square(errors))) / truth.loads.mean())
    return found


def write(outcomes: Mapping[str, Outcome], path: Path, parts: Mapping[str, Any]) -> None:
    """The figures of all cars as JSON, and `parts` of other examinations beside them."""
    content = {
        "cars": {
            name: {"minutes": one.minutes, **one.after, "before": dict(one.before),
                   "calibrated": dict(one.by_calibration), "determined": list(one.calibrated),
                   "findings": one.findings, "commands": list(one.commands)}
            for name, one in outcomes.items()
        },
        **parts,
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps(content, indent=2) + "\n")
