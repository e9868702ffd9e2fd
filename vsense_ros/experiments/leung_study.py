"""A study of filters on simulated drives: one run for each manoeuvre, seed, receiver and filter, kept by its content.

The plant is the car of a vehicle file with all its degrees of freedom. Its sensors are those of Leung 2010, appendix B:
all at cog, at 100 Hz, with white noise and a constant bias; a fix each second. Filters get the readings directly, in
order, so that a study measures the filter and no transport.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import wrap
from vsense_ros.files.atomic import in_place_of
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.manoeuvre.receivers import RECEIVERS
from vsense_ros.mismatch.fleet import workers
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import PITCH, ROLL, SPEED_X, SPEED_Y, SPIN, STEERING, YAW, YAW_RATE
from vsense_ros.model.sensors import GnssAttitude, GnssVelocity, Imu, SensorBase, Steering, WheelSpeeds
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.motion import Motions, Readout
from vsense_ros.navigation.space import MOTION

Array = NDArray[np.float64]

PLANT = "jaguar_saloon"
STEP = 0.01  # [s] between readings
KEPT = 10  # steps between estimates that are scored
SETTLED = 20.0  # [s] after which estimates are scored: the thesis does not tell its window
_DEGREE = np.pi / 180


class Error(NamedTuple):
    """Standard deviation of the noise, and bias."""

    noise: float
    bias: float


_GYRO, _FORCE = Error(0.1 * _DEGREE, 1.0 * _DEGREE), Error(0.5, 1.0)
_STEERING = Error(1.0 * _DEGREE / 17.58, 5.0 * _DEGREE / 17.58)


@dataclass(frozen=True)
class Errors:
    """Of the sensors (tables B.1 and B.2), at cog: standard deviations of the noise, and biases."""

    gyro: Error = _GYRO  # [rad/s]
    force: Error = _FORCE  # [m/s²]
    steering: Error = _STEERING  # of the road wheels [rad]
    spin: float = 0.04  # [rad/s]
    fix: float = 0.025  # [m/s] to the east and to the north
    fix_period: float = 1.0  # [s]
    heading: float | None = None  # [rad] of a magnetometer, or of two antennas; None: there is none
    feels_gravity: bool = True  # whether roll and pitch of the body enter the accelerometers


@dataclass(frozen=True)
class Case:
    """One drive of a study: manoeuvre by name, seed of the noise, errors of the sensors, and an outage [s] from, to."""

    manoeuvre: str
    seed: int
    errors: Errors = Errors()
    outage: tuple[float, float] | None = None
    plant: str = PLANT
    noise: float = 1.0  # of all sensors, as a share of what they have; with 0 what is left is the models' error


@dataclass(frozen=True)
class Truth:
    """What the plant did, n readings."""

    t: Array
    yaw: Array
    forward_velocity: Array
    lateral_velocity: Array
    yaw_rate: Array
    forces: Array  # (n, 2) specific, along and across
    level_forces: Array  # (n, 2) the same without gravity
    steer: Array
    spins: Array  # (n, 4)

    @property
    def side_slip(self) -> Array:
        """[rad]"""
        return np.arctan2(self.lateral_velocity, self.forward_velocity)


def receiver(name: str, errors: Errors | None = None) -> Errors:
    """Errors with the velocity of a receiver of table 4.8. Raises `InputError` for an unknown name."""
    if name not in RECEIVERS:
        raise InputError(f"no receiver {name!r}; known are {', '.join(RECEIVERS)}")
    return replace(errors or Errors(), fix=RECEIVERS[name].velocity)


def drive_plant(manoeuvre: str, plant: str, store: Path) -> Truth:
    """What the plant does in a manoeuvre; kept in `store`, since it takes a tenth of the time that is driven."""
    file = store / f"plant_{manoeuvre}_{_digest(plant, manoeuvre, *_sources('model', 'manoeuvre'))}.npz"
    if not file.exists():
        car, found = load_vehicle(vehicle_path(plant)), MANOEUVRES[manoeuvre]
        q, u = rolling_straight(car, found.speed)
        s = simulate(car, found.driver(car), found.duration, step=1e-3, keep_every=round(STEP / 1e-3), q=q, u=u)
        roll, pitch = s.q[:, ROLL], s.q[:, PITCH]
        gravity = GRAVITY * np.column_stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch)])
        level = s.acceleration[:, :2]
        kept = {
            "t": s.t, "yaw": s.q[:, YAW], "forward_velocity": s.u[:, SPEED_X], "lateral_velocity": s.u[:, SPEED_Y],
            "yaw_rate": s.u[:, YAW_RATE], "forces": level + gravity, "level_forces": level,
            "steer": s.inputs[:, STEERING], "spins": s.u[:, SPIN],
        }  # fmt: skip
        file.parent.mkdir(parents=True, exist_ok=True)
        with in_place_of(file) as temporary, temporary.open("wb") as out:
            np.savez(out, **kept)  # type: ignore[arg-type]  # names of arrays, not options
    with np.load(file) as found_again:
        return Truth(**{key: found_again[key] for key in found_again.files})


@cache
def _study_car(plant: str) -> Vehicle:
    return load_vehicle(vehicle_path(plant))


def sensors_of(errors: Errors) -> dict[str, SensorBase]:
    """Sensors at cog with these errors, without gates of their own: a study has no receivers that lie."""
    gyro, force = errors.gyro.noise, errors.force.noise
    found: dict[str, SensorBase] = {
        "imu": Imu(rate_noise=(gyro,) * 3, force_noise=(force,) * 3, gate=1e6),
        "wheels": WheelSpeeds(noise=errors.spin, gate=1e6),
        "steering": Steering(gate=1e6),
        "velocity": GnssVelocity(noise=errors.fix, gate=1e6),
    }
    if errors.heading is not None:
        found["heading"] = GnssAttitude(noise=errors.heading, gate=1e6)
    return found


@dataclass(frozen=True)
class Readings:
    """Of one case, one row for each reading; `fixes` (n, 2) are NaN where there is none."""

    imu: Array  # (n, 6)
    wheels: Array  # (n, 4)
    steering: Array  # (n, 1)
    fixes: Array
    heading: Array  # (n, 2) cosine and sine


def readings(truth: Truth, case: Case) -> Readings:
    """With the noise of the case's seed."""
    errors, n = case.errors, len(truth.t)
    random = np.random.default_rng([case.seed, 2010])
    noise = case.noise * random.standard_normal((n, 11))
    imu = np.zeros((n, 6))
    imu[:, 2] = truth.yaw_rate + errors.gyro.bias + errors.gyro.noise * noise[:, 0]
    forces = truth.forces if errors.feels_gravity else truth.level_forces
    imu[:, 3:5] = forces + errors.force.bias + errors.force.noise * noise[:, 1:3]
    imu[:, 5] = GRAVITY
    wheels = truth.spins + errors.spin * noise[:, 3:7]
    steering = (truth.steer + errors.steering.bias + errors.steering.noise * noise[:, 7])[:, None]
    c, s = np.cos(truth.yaw), np.sin(truth.yaw)
    east = c * truth.forward_velocity - s * truth.lateral_velocity
    north = s * truth.forward_velocity + c * truth.lateral_velocity
    fixes = np.column_stack([east, north]) + errors.fix * noise[:, 8:10]
    every = max(1, round(errors.fix_period / STEP))
    silent = np.arange(n) % every != 0
    if case.outage is not None:
        silent |= (truth.t >= case.outage[0]) & (truth.t < case.outage[1])
    fixes[silent] = np.nan
    heading = truth.yaw + (errors.heading or 0.0) * noise[:, 10]
    return Readings(imu, wheels, steering, fixes, np.column_stack([np.cos(heading), np.sin(heading)]))


def estimate(name: str, truth: Truth, case: Case) -> dict[str, Any]:
    """What a filter makes of a case, and how far that is from the truth: by quantity RMSE and range of the truth, over
    the whole run and when settled; normalized errors squared of side slip and yaw; final parameters."""
    read = readings(truth, case)
    motions, at = follow(name, truth, case, read)
    return _scores(motions, truth, at, read, case.errors)


def follow(name: str, truth: Truth, case: Case, read: Readings) -> tuple[Motions, NDArray[np.int64]]:
    """What a filter makes of the readings of a case, at each tenth of them, whose places (n,) come with it."""
    sensors = sensors_of(case.errors)
    # The plant's road is level, which every filter of the thesis takes for granted.
    numbers = {**car_numbers(_study_car(case.plant), sensors.values()), "road_bank": 1e-3}
    filter = Aided(name, DEFINITIONS[name][1], numbers, sensors)
    readout = Readout(filter)
    variances = {key: sensor.deviations() ** 2 for key, sensor in sensors.items()}
    fix = read.fixes[0]
    first = {
        "yaw": float(np.arctan2(fix[1], fix[0])), "forward_velocity": float(np.hypot(*fix)),
        "velocity_east": float(fix[0]), "velocity_north": float(fix[1]), "yaw_rate": float(read.imu[0, 2]),
    }  # fmt: skip
    rows = {"imu": read.imu, "wheels": read.wheels, "steering": read.steering, "velocity": read.fixes}
    if case.errors.heading is not None:
        rows["heading"] = read.heading
    for key, values in rows.items():
        filter.give_reading(key, values[0])
    filter.start(filter.definition.start({**numbers, **first}))
    used = [key for key in ("heading", "wheels", "steering", "imu") if key in rows and filter.uses(key)]
    has_fix = np.isfinite(read.fixes[:, 0]).tolist()
    snapshots, at = [], []
    means = {key: 0.5 * (rows[key][1:] + rows[key][:-1]) for key in used}  # of a step's two ends
    for k in range(1, len(truth.t)):
        for key in used:
            filter.give_reading(key, means[key][k - 1])
        filter.predict(STEP)
        if has_fix[k]:
            filter.correct("velocity", read.fixes[k], variances["velocity"])
        for key in used:
            filter.correct(key, rows[key][k], variances[key])
        if k % KEPT == 0:
            snapshots.append(readout.snapshot(k))
            at.append(k)
    return readout.motions(snapshots), np.array(at)


def _scores(motions: Motions, truth: Truth, at: NDArray[np.int64], read: Readings, errors: Errors) -> dict[str, Any]:
    settled = truth.t[at] > SETTLED
    straight = np.abs(truth.yaw_rate) < 1e-3
    radius = float(np.mean(2 * truth.forward_velocity[straight] / truth.spins[straight, 2:].sum(axis=1)))
    true = {name: getattr(truth, name)[at] for name in ("yaw", "forward_velocity", "lateral_velocity", "yaw_rate")}
    true["side_slip"] = truth.side_slip[at]
    found: dict[str, Any] = {}
    for name in true:
        if name == "side_slip" and motions.tells_side_slip:
            error = motions.side_slip[:, 0] - true[name]
        elif name in motions.told:
            error = motions.value[:, MOTION.index(name)] - true[name]
        else:
            continue
        found[name] = _errors(wrap(error) if name in ("yaw", "side_slip") else error, true[name], settled)
    biases = {
        "gyro_bias": errors.gyro.bias, "acceleration_bias_x": errors.force.bias,
        "acceleration_bias_y": errors.force.bias, "steering_bias": errors.steering.bias, "rolling_radius": radius,
    }  # fmt: skip
    for j, full in enumerate(motions.parameter_names):
        name = full.rpartition(".")[2]
        if name in biases and name not in found:
            error = motions.parameters[:, j] - biases[name]
            found[name] = _errors(error, np.zeros(len(at)), settled)
    found["nees"] = {}
    if "side_slip" in found:
        deviation = np.where(np.isfinite(motions.side_slip[:, 1]), motions.side_slip[:, 1], np.nan)
        square = ((motions.side_slip[:, 0] - true["side_slip"]) / deviation)[settled] ** 2
        found["nees"]["side_slip"] = float(np.nanmean(square))
        found["expected_side_slip"] = float(np.sqrt(np.nanmean(deviation[settled] ** 2)))
    if "yaw" in motions.told:
        rows = np.flatnonzero(np.isfinite(read.fixes[at, 0]))
        course = np.arctan2(read.fixes[at[rows], 1], read.fixes[at[rows], 0])
        raw = wrap(course - motions.value[rows, MOTION.index("yaw")])
        found["raw_side_slip"] = _errors(wrap(raw - true["side_slip"][rows]), true["side_slip"], settled[rows])
    return found


def _errors(error: Array, true: Array, settled: NDArray[np.bool_]) -> dict[str, float]:
    return {
        "rmse": float(np.sqrt(np.mean(error[settled] ** 2))) if settled.any() else float("nan"),
        "whole": float(np.sqrt(np.mean(error**2))),
        "range": float(np.ptp(true)),
    }


Results = Mapping[tuple[Case, str], Mapping[str, Any]]


def study(
    cases: Iterable[tuple[Case, Sequence[str]]],
    store: Path,
    progress: Callable[[float], None] = lambda share: None,
    *,
    processes: int | None = None,
) -> Results:
    """Scores of each case and filter. What is in `store` from a run that was stopped is not done again; a change of
    the filters, the plant or the sensors makes anew what depends on it. Raises `InputError` for unknown names."""
    wanted = [(case, tuple(dict.fromkeys(names))) for case, names in cases]
    for case, names in wanted:
        if case.manoeuvre not in MANOEUVRES:
            raise InputError(f"no manoeuvre {case.manoeuvre!r}; known are {', '.join(MANOEUVRES)}")
        for name in names:
            FILTERS[name]
    store.mkdir(parents=True, exist_ok=True)
    found: dict[tuple[Case, str], Mapping[str, Any]] = {}
    missing = []
    for case, names in wanted:
        left = []
        for name in names:
            file = _file(store, case, name)
            if file.exists():
                found[case, name] = json.loads(file.read_text(encoding="utf-8"))
            else:
                left.append(name)
        if left:
            missing.append((case, tuple(left)))
    if not missing:
        progress(1.0)
        return found
    # Longest drives first, so that no process is left alone with one at the end.
    missing.sort(key=lambda one: -MANOEUVRES[one[0].manoeuvre].duration * len(one[1]))
    weights = [MANOEUVRES[case.manoeuvre].duration * len(names) for case, names in missing]
    done = 0.0
    if processes == 1:
        for (case, names), weight in zip(missing, weights, strict=True):
            found |= {(case, name): one for name, one in _work(case, names, store).items()}
            done += weight
            progress(done / sum(weights))
        return found
    from distributed import as_completed

    with workers(None, processes) as client:
        # Plants first: many cases share one.
        drives = list({(case.manoeuvre, case.plant) for case, _ in missing})
        for future in as_completed([client.submit(_plant, *drive, store, pure=False) for drive in drives]):
            future.result()
        tasks = {
            client.submit(_work, case, names, store, pure=False): (case, weight)
            for (case, names), weight in zip(missing, weights, strict=True)
        }
        for future in as_completed(list(tasks)):
            case, weight = tasks[future]
            found |= {(case, name): one for name, one in future.result().items()}
            done += weight
            progress(done / sum(weights))
    return found


def _plant(manoeuvre: str, plant: str, store: Path) -> None:
    drive_plant(manoeuvre, plant, store)


def _work(case: Case, names: Sequence[str], store: Path) -> dict[str, Mapping[str, Any]]:
    """One drive by some filters, kept."""
    truth = drive_plant(case.manoeuvre, case.plant, store)
    found: dict[str, Mapping[str, Any]] = {}
    for name in names:
        found[name] = estimate(name, truth, case)
        with in_place_of(_file(store, case, name)) as temporary:
            temporary.write_text(json.dumps(found[name]), encoding="utf-8")
    return found


def _file(store: Path, case: Case, name: str) -> Path:
    digest = _digest(json.dumps(asdict(case)), name, *_sources("navigation", "estimation", "manoeuvre", "model"))
    return store / f"{case.manoeuvre}_{case.seed}_{name}_{digest}.json"


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def _sources(*rooms: str) -> tuple[str, ...]:
    """Contents of the package's rooms that a result depends on, and of the vehicle files."""
    package = Path(str(resources.files("vsense_ros")))
    files = [file for room in rooms for file in sorted((package / room).rglob("*.py"))]
    own = [vehicle_path(PLANT), Path(__file__)]
    return tuple(hashlib.sha256(file.read_bytes()).hexdigest() for file in [*files, *own])
