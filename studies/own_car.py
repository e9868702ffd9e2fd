"""A newcomer's way with cars that are not ours: from catalogue values and ordinary drives to an estimate.

For each car: `new-vehicle` from catalogue values, `check`, `calibrate` on the drives to learn from, and the observer on
a drive that nothing has seen, with the file before and after. Two cars are recordings, two are simulated by the plants
of test/blind, which share no equation with the package; what they hide, and the truth, stays with this study.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Reference, Vehicle
from vsense_ros.prepare.calibration import Calibration, calibrate
from vsense_ros.prepare.car_check import check_car
from vsense_ros.prepare.catalogue import CatalogueValues, catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle
from vsense_ros.runner import run

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
SLOWEST = 3.0  # [m/s] above which a side slip is compared
HALF_RAV4 = 30.0  # [s] of the RAV4's minute to calibrate on; the rest is held out
WARM_UP = {"Genesis": 50.0}  # [s] for which the heading of the reference is not settled, as README has it
DRIVES = (("town", 60.0, 14.0, 5.0, 14.0, 2.8), ("rural road", 60.0, 22.0, 10.0, 40.0, 3.4))
HELD_OUT = ("way home", 40.0, 19.0, 9.0, 28.0, 3.2)


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
    """A car with its catalogue values, drives to calibrate on, and one held out with its truth; where the reference of
    a recording is mounted is no number of the car."""

    name: str
    catalogue: CatalogueValues
    drives: tuple[Recording, ...]
    held_out: Recording
    truth: Truth
    reference: Reference = field(default_factory=Reference)


@dataclass(frozen=True)
class Outcome:
    """What came of a car: files and figures of the held-out drive before and after calibration."""

    minutes: float
    calibration: Calibration
    doubts: int
    before: Mapping[str, float | None]
    after: Mapping[str, float | None]


def cars(only: Sequence[str] = ()) -> Iterator[Car]:
    """The cars of the study, each made when it is asked for; `only` some of them, by name."""
    for name, make in (
        ("Genesis", genesis), ("RAV4", rav4), ("hatchback", lambda: plant("newton_euler", 0, 7)),
        ("saloon", lambda: plant("newton_euler", 1, 11)),
    ):  # fmt: skip
        if not only or name in only:
            yield make()


def genesis() -> Car:
    """The Genesis: slow and fast lap to calibrate on, the third held out."""
    folder = datasets.fetch("genesis_oxts_can").parent
    slow, fast, third = (
        import_recording(folder / name) for name in ("cpg_slow_lap.mat", "cpg_fast_lap.mat", "med_lap_center_8_21.mat")
    )
    values = catalogue_values(
        name="Genesis", mass=2100.0, wheelbase=3.01, track=1.62, track_rear=1.65, axle_load_front=1090.0,
        tyre="245/45R18 100", driven="rear", height=1.48, like="saloon",
    )  # fmt: skip
    reference = load_vehicle(vehicle_path("genesis")).reference
    return Car("Genesis", values, (slow, fast), third, _reference_of(third), reference)


def rav4() -> Car:
    """The RAV4: half of its minute to calibrate on, the other held out."""
    whole = import_recording(datasets.fetch("comma2k19_rav4"))
    values = catalogue_values(
        name="RAV4", mass=1650.0, wheelbase=2.66, track=1.57, axle_load_front=970.0, tyre="225/65R17 102", height=1.70
    )
    first, second = whole.between(None, HALF_RAV4), whole.between(HALF_RAV4, None)
    reference = load_vehicle(vehicle_path("rav4")).reference
    return Car("RAV4", values, (first,), second, _reference_of(second), reference)


def _reference_of(recording: Recording) -> Truth:
    signals = read_signals(recording, "reference")
    slip, speed = signals["side_slip"], signals["speed"]
    rate = signals.get("yaw_rate")
    return Truth(
        slip.stamp, slip.value[:, 0],
        None if rate is None else np.interp(slip.stamp, rate.stamp, rate.value[:, 0]),
        None, np.interp(slip.stamp, speed.stamp, speed.value[:, 0]),
    )  # fmt: skip


def plant(kind: str, which: int, seed: int) -> Car:
    """A car of the blind examination, drawn a few per cent off its type, with errors in its catalogue values."""
    if str(ROOT / "test") not in sys.path:
        sys.path.append(str(ROOT / "test"))
    blind = {name: import_module(f"blind.{name}") for name in ("cars", "courses", "knobs", "sensors", "tyres")}
    rng = np.random.default_rng(seed)
    car = blind["cars"].CARS[which]
    factor = rng.uniform(0.97, 1.03, 3)
    hidden = replace(car, mass=car.mass * factor[0], cog_height=car.cog_height * factor[1],
                     yaw_inertia=car.yaw_inertia * factor[2])  # fmt: skip
    courses = [
        replace(blind["courses"].road(rng, duration, *limits, name), roughness=0.002, seed=int(rng.integers(2**31)))
        for name, duration, *limits in (*DRIVES, HELD_OUT)
    ]
    simulate = import_module(f"blind.plants.{kind}").simulate
    log = simulate(
        blind["cars"].side_by_side([hidden] * len(courses)), blind["knobs"].side_by_side([{}] * len(courses)), courses,
        blind["tyres"].mixed(["magic_formula_1989"] * len(courses)),
    )  # fmt: skip
    sensors = blind["sensors"]
    grade = sorted(sensors.GRADES)[0]
    bench = sensors.Bench(grade, sensors.Mounting.drawn(rng), sensors.Biases.drawn(sensors.GRADES[grade], rng), {})
    lanes = [log.lane(i, course.duration) for i, course in enumerate(courses)]
    recordings = [
        bench.record(lane, course.name, i, rng) for i, (lane, course) in enumerate(zip(lanes, courses, strict=True))
    ]
    last = lanes[-1]
    stamp = (
        sensors.EPOCH + (len(lanes) - 1) * 120_000_000_000 + (np.arange(len(last["position"])) * 5e6).astype(np.int64)
    )
    forward, left = last["velocity"][:, 0], last["velocity"][:, 1]
    truth = Truth(stamp, np.arctan2(left, forward), last["rates"][:, 2], last["load"], forward)
    return Car(hidden.name, _catalogue_of(hidden, rng), tuple(recordings[:-1]), recordings[-1], truth)


def _catalogue_of(car: Any, rng: np.random.Generator) -> CatalogueValues:
    """What a catalogue would say of a plant: mass off by up to 3 %, the load on the axle by 2 %, the ratio by 5 %."""
    mass = float(round(car.mass * rng.uniform(0.97, 1.03)))
    share = car.rear_arm / car.wheelbase + rng.uniform(-0.01, 0.01)
    sizes = {0.305: "185/60R15 84", 0.328: "225/50R17 94", 0.360: "235/60R18 103"}
    return catalogue_values(
        name=car.name, mass=mass, wheelbase=round(car.wheelbase, 2), track=round(car.front.track, 2),
        track_rear=round(car.rear.track, 2), axle_load_front=float(round(mass * share)), tyre=sizes[car.front.radius],
        driven="front" if car.front_drive == 1 else "rear" if car.front_drive == 0 else "all",
        steering_ratio=round(car.ratio * rng.uniform(0.95, 1.05), 1),
    )  # fmt: skip


def newcomer(car: Car) -> Outcome:
    """The way of a newcomer with a car."""
    start = time.perf_counter()
    made = new_vehicle(car.catalogue).vehicle
    doubts = len(check_car(made))
    calibration = calibrate(car.drives, made)
    doubts += len(check_car(calibration.vehicle))
    before, after = (figures(car, vehicle) for vehicle in (made, calibration.vehicle))
    return Outcome((time.perf_counter() - start) / 60, calibration, doubts, before, after)


def figures(car: Car, vehicle: Vehicle) -> dict[str, float | None]:
    """Errors of the observer on the held-out drive: side slip [deg], share within two standard deviations, yaw rate
    [deg/s], vertical forces [% of the mean load of a wheel]; None where the truth is not known."""
    vehicle = vehicle.model_copy(update={"reference": car.reference})
    output = read_signals(at_reference(run(car.held_out, vehicle, rate=50.0).output, vehicle), "vsense")
    truth = car.truth
    begin = truth.stamp[0] + round(WARM_UP.get(car.name, 2.0) * 1e9)

    def at(name: str, values: Array) -> tuple[Array, Array]:
        series = output[name]
        rows = (series.stamp > begin) & (series.stamp < truth.stamp[-1])
        if truth.speed is not None:
            rows &= np.interp(series.stamp, truth.stamp, truth.speed) > SLOWEST
        error = series.value[rows, 0] - np.interp(series.stamp[rows], truth.stamp, values)
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


def write(outcomes: Mapping[str, Outcome], path: Path) -> None:
    """The figures of all cars as JSON."""
    content = {
        "cars": {
            name: {"minutes": one.minutes, **one.after, "before": dict(one.before), "doubts": one.doubts,
                   "calibrated": [quantity.name for quantity in one.calibration.quantities if quantity.determined]}
            for name, one in outcomes.items()
        }
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps(content, indent=2) + "\n")
