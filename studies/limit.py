"""Drives to the limit of the tyres: side slip by observers and by simpler ways, each identified on other drives only.

Recordings are taken in two halves, and each is estimated with what was found on the other half: stiffness of the tyres
and friction by the error of the side slip, of the car that all filters share, of the single-track UKF by itself, and
the regression by least squares. `inertial` and the kinematic formula have nothing to identify but the angle of the
reference. Errors of all are compared at the same instants. Those of neighbouring instants are alike, so that intervals
come of resampled blocks of time (Künsch 1989, Annals of Statistics 17), the same for each of two that are compared.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import least_squares

from studies.genesis import FREE_PARAMETERS
from studies.side_slip_fit import fit_side_slip
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.estimation.ukf import Ukf
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import SIGNALS, Series, read_signals, wrap
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.tir import read_tir
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.free_parameter import FreeParameter, multiplied
from vsense_ros.manoeuvre import MANOEUVRES, STEP, recorded
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.integrated import brush
from vsense_ros.runner import run

Array = NDArray[np.float64]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class LimitSettings:
    """How the drives are made and compared: decisions of this project."""

    friction: float = 0.7  # [-] of the road of generated drives, on which these manoeuvres are at the limit
    seed: int = 46
    begin: float = 1.0  # [s] after the beginning of a drive that are not compared
    rate: float = 20.0  # [Hz] at which errors are compared
    slowest: float = 3.0  # [m/s] below which a side-slip angle means little
    block: float = 1.0  # [s] that are resampled together
    resamples: int = 4000
    iterations: int = 2  # of the search for tyres and friction
    ukf_steps: int = 40  # evaluations of the search of the single-track UKF


SETTINGS = LimitSettings()
MULTIBODY = ("error_ekf", "spi")
FILTERS = (*MULTIBODY, "integrated", "inertial")
UKF, REGRESSION, KINEMATIC = "UKF", "regression", "kinematic"  # the first of a single-track model
WAYS = (*FILTERS, UKF, REGRESSION, KINEMATIC)
GENERATED = ("sine_with_dwell", "double_lane_change", "slow_ramp_steer", "brake_in_turn")
PLANT, START = "prototype_real", "prototype_model"
TYRES = "pacejka_2012_205_60r15.tir"  # of the plant; the observer's is TMeasy
FREE = (
    *(one for one in FREE_PARAMETERS if one.name.endswith("cornering stiffness")),
    FreeParameter("friction", "-", 0.2, -np.inf, np.inf, multiplied({"road.friction": 1.0})),
)


def generated(store: Path) -> list[Recording]:
    """Drives of the full car on other tyres than those of the observer's file; they are kept in `store`."""
    return [_generated(name, store) for name in GENERATED]


def _generated(name: str, store: Path) -> Recording:
    path = store / f"friction_{SETTINGS.friction:g}_seed_{SETTINGS.seed}" / name
    if not path.exists():
        car = load_vehicle(vehicle_path(PLANT)).with_parameters({"road.friction": SETTINGS.friction})
        tyre = read_tir(shared_folder("config") / "tyres" / TYRES)
        axles = {axle: getattr(car.physics, axle).model_copy(update={"tyre": tyre}) for axle in ("front", "rear")}
        car = car.model_copy(update={"physics": car.physics.model_copy(update=axles)})
        manoeuvre = MANOEUVRES[name]
        q, u = rolling_straight(car, manoeuvre.speed)
        trajectory = simulate_full_car(car, manoeuvre.driver(car), manoeuvre.duration, step=STEP, q=q, u=u)
        write_bag(path, recorded(name, trajectory, car, SETTINGS.seed), overwrite=True)
    return read_bag(path)


# The single-track UKF, as race cars have it: v_y and ṙ, tyres of a brush.


class SingleTrack(StateSpace):
    """Lateral velocity and yaw rate of a single-track model whose axles have brush tyres."""

    names = ("lateral_velocity", "yaw_rate")
    inputs = ("steering", "speed")
    parameters = (
        "mass", "yaw_inertia", "to_front", "to_rear", "front_stiffness", "rear_stiffness", "friction", "force_noise",
        "moment_noise", "gravity",
    )  # fmt: skip
    auxiliaries = ("lateral_force",)

    def _forces(self, x: Named, u: Named, theta: Named) -> tuple[ca.SX, ca.SX]:
        speed = ca.fmax(u.speed, SETTINGS.slowest)
        front = u.steering - (x.lateral_velocity + theta.to_front * x.yaw_rate) / speed
        rear = (theta.to_rear * x.yaw_rate - x.lateral_velocity) / speed
        grip = theta.friction * theta.mass * theta.gravity / (theta.to_front + theta.to_rear)
        return (
            brush(theta.front_stiffness * front, grip * theta.to_rear) * ca.cos(u.steering),
            brush(theta.rear_stiffness * rear, grip * theta.to_front),
        )

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        front, rear = self._forces(x, u, theta)
        return [(front + rear) / theta.mass]

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        front, rear = self._forces(x, u, theta)
        turning = (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia
        sliding = (front + rear) / theta.mass - x.yaw_rate * u.speed
        return [x.lateral_velocity + h * sliding, x.yaw_rate + h * turning]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [h * theta.force_noise**2, h * theta.moment_noise**2]


GYRO = Measurement("gyro", lambda x, z, u, p: x.yaw_rate, (0.01,))
LATERAL = Measurement("lateral_force", lambda x, z, u, p: z.lateral_force, (0.3,))
_SEARCHED = ("front_stiffness", "rear_stiffness", "friction", "force_noise")  # by their logarithms


@dataclass(frozen=True)
class Readings:
    """What a single-track model takes of a recording, at the stamps of its inertial sensor: time [ns], steering [rad],
    speed [m/s], yaw rate [rad/s] and lateral acceleration [m/s²], (n,) each."""

    stamp: NDArray[np.int64]
    rows: Array  # (n, 4)

    @classmethod
    def of(cls, recording: Recording, car: Vehicle) -> Readings:
        """Steering and speed of a recording at the stamps of its inertial sensor, whose axes are turned into the
        car's."""
        by_topic = {sensor.topic: sensor.of_car(car.physics) for sensor in car.sensors.values()}
        imu, steering = recording["imu/data"], recording["vehicle/steering"]
        velocity = recording["gps/velocity"].columns["linear"]
        angle = np.zeros((len(steering), 1))
        by_topic[steering.topic].read_rows(tuple(steering.names), steering.columns, angle, np.zeros_like(angle))
        felt = np.hstack([imu.columns["angular_velocity"], imu.columns["linear_acceleration"]])
        felt = by_topic["imu/data"].in_axes_of_car(np.nan_to_num(felt))
        speed = np.interp(imu.stamp, recording["gps/velocity"].stamp, np.hypot(velocity[:, 0], velocity[:, 1]))
        steered = np.interp(imu.stamp, steering.stamp, np.nan_to_num(angle[:, 0]))
        return cls(imu.stamp, np.column_stack([steered, speed, felt[:, 2], felt[:, 4]]))


class SingleTrackUkf:
    """The unscented filter of a car, with what its search has found."""

    def __init__(self, car: Vehicle) -> None:
        numbers = {**car_numbers(car, car.sensors.values()), "force_noise": 1.0, "moment_noise": 1.0}
        self._numbers = {name: numbers[name] for name in SingleTrack.parameters}
        self._filter = Ukf(SingleTrack(), [GYRO, LATERAL], self._numbers)
        self._car, self._found, self.angle = car, np.zeros(len(_SEARCHED)), 0.0

    def identify(self, recordings: Sequence[Recording]) -> None:
        """Find stiffness, friction and noise by which the side slip of recordings is the truest, and the angle at which
        their reference is mounted."""
        known = [(Readings.of(one, self._car), _truth(one)) for one in recordings]

        def errors(found: Array) -> Array:
            self._found, self.angle = found[:-1], found[-1]
            parts = [
                np.nan_to_num(_error(self.estimate(readings), truth)) / np.sqrt(len(truth.stamp))
                for readings, truth in known
            ]
            return np.concatenate([*parts, 1e-3 * found])

        begin = np.zeros(len(_SEARCHED) + 1)
        found = least_squares(errors, begin, diff_step=0.02, x_scale=0.2, max_nfev=SETTINGS.ukf_steps // len(begin))
        self._found, self.angle = found.x[:-1], found.x[-1]

    def estimate(self, readings: Readings) -> Series:
        """The side slip of a drive."""
        factors = dict(zip(_SEARCHED, np.exp(self._found), strict=True))
        ukf = self._filter
        ukf.parameters[:] = [value * factors.get(name, 1.0) for name, value in self._numbers.items()]
        ukf.inputs[:] = readings.rows[0, :2]
        ukf.start(Gaussian(np.array([0.0, readings.rows[0, 2]]), np.diag([0.1, 0.05]) ** 2))
        steps = np.diff(readings.stamp) * 1e-9
        noise = [np.array([0.01**2]), np.array([0.3**2])]
        lateral = np.zeros(len(readings.rows))
        for k, (row, h) in enumerate(zip(readings.rows[1:], steps, strict=True), 1):
            ukf.inputs[:] = row[:2]
            ukf.predict(float(h))
            ukf.correct(GYRO.name, row[2:3], noise[0])
            ukf.correct(LATERAL.name, row[3:4], noise[1])
            lateral[k] = ukf.mean[0]
        slip = np.arctan2(lateral, np.maximum(readings.rows[:, 1], SETTINGS.slowest)) + self.angle
        return Series(SIGNALS["side_slip"], readings.stamp, slip[:, None])


# Comparison


@dataclass(frozen=True)
class Compared:
    """Errors of the side slip on one drive at instants that all ways have in common (n,) [rad], by way, and why a way
    is absent."""

    errors: Mapping[str, Array]
    largest: float  # [m/s²] lateral acceleration
    absent: Mapping[str, str]

    def rmse(self, way: str) -> float:
        """Root mean square error [°]; NaN where the way is absent."""
        return float(np.degrees(np.sqrt(np.mean(self.errors[way] ** 2)))) if way in self.errors else float("nan")

    def blocks(self, ways: Sequence[str]) -> Array:
        """Mean squares of the errors of ways in blocks of time (b, k) [rad²]."""
        squares = np.column_stack([self.errors[way] ** 2 for way in ways])
        count = max(len(squares) // round(SETTINGS.block * SETTINGS.rate), 1)
        return np.array([part.mean(axis=0) for part in np.array_split(squares, count)])


def ratio_interval(blocks: Array, seed: int = SETTINGS.seed) -> tuple[float, float, float]:
    """Root mean square error of the second of two ways over that of the first, with the 95 % interval of resampled
    blocks (b, 2) of their squares."""
    rng = np.random.default_rng(seed)
    drawn = blocks[rng.integers(len(blocks), size=(SETTINGS.resamples, len(blocks)))].mean(axis=1)
    low, high = np.percentile(np.sqrt(drawn[:, 1] / drawn[:, 0]), (2.5, 97.5))
    means = blocks.mean(axis=0)
    return float(np.sqrt(means[1] / means[0])), float(low), float(high)


def compare_all(
    recordings: Sequence[Recording], start: Vehicle, progress: Progress = lambda share: None
) -> dict[str, Compared]:
    """By the name of each recording what all ways make of it, identified on those of the other half, that `start`
    begins the search for. Raises `InputError` where there are fewer than two."""
    if len(recordings) < 2:
        raise InputError(
            f"expected two recordings or more, to identify on others than are estimated: {len(recordings)}"
        )
    results: dict[str, Compared] = {}
    halves = [list(recordings[0::2]), list(recordings[1::2])]
    for number, (estimated, others) in enumerate((halves, halves[::-1])):
        fitted = fit_side_slip(start, FREE, others, iterations=SETTINGS.iterations).vehicle
        ukf = SingleTrackUkf(start)
        ukf.identify(others)
        coefficients = baselines.fit_regression(others)
        for k, recording in enumerate(estimated):
            results[recording.name] = _compared(recording, fitted, ukf, coefficients)
            progress((number + (k + 1) / len(estimated)) / 2)
    return {one.name: results[one.name] for one in recordings}


def _compared(recording: Recording, car: Vehicle, ukf: SingleTrackUkf, coefficients: Array) -> Compared:
    truth = _truth(recording)
    estimates: dict[str, Series] = {}
    absent = {}
    for name in FILTERS:
        try:
            output = at_reference(run(recording, car, name).output, car)
            estimates[name] = read_signals(output, "vsense")["side_slip"]
        except (InputError, KeyError, FloatingPointError) as error:
            absent[name] = str(error)
    estimates[UKF] = ukf.estimate(Readings.of(recording, car))
    estimates[REGRESSION] = baselines.regression(recording, coefficients)[1]
    rolling = baselines.kinematic(recording, car.physics.chassis.cog_to_rear_axle)[1]
    estimates[KINEMATIC] = Series(rolling.signal, rolling.stamp, rolling.value - car.reference.yaw)
    errors = {way: _error(series, truth) for way, series in estimates.items()}
    common = np.isfinite(np.array(list(errors.values()))).all(axis=0)
    accelerations = read_signals(recording, "reference").get("lateral_acceleration")
    felt = (
        recording["imu/data"].columns["linear_acceleration"][:, 1:2] if accelerations is None else accelerations.value
    )
    return Compared(
        {way: error[common] for way, error in errors.items()}, float(np.nanpercentile(np.abs(felt), 99)), absent
    )


def _truth(recording: Recording) -> Series:
    """The side slip of the reference at `SETTINGS.rate`, NaN where the car is slow."""
    signals = read_signals(recording, "reference")
    slip, speed = signals["side_slip"], signals["speed"]
    begin, end = slip.stamp[0] + round(SETTINGS.begin * 1e9), slip.stamp[-1]
    stamp = np.arange(begin, end, round(1e9 / SETTINGS.rate))
    value = np.interp(stamp, slip.stamp, np.unwrap(slip.value[:, 0]))
    value[np.interp(stamp, speed.stamp, speed.value[:, 0]) < SETTINGS.slowest] = np.nan
    return Series(slip.signal, stamp, value[:, None])


def _error(estimate: Series, truth: Series) -> Array:
    """Estimate less truth (n,) at the instants of the truth, NaN where either is not known."""
    known = np.isfinite(estimate.value[:, 0])
    angle = np.unwrap(estimate.value[known, 0])
    at = np.interp(truth.stamp, estimate.stamp[known], angle, left=np.nan, right=np.nan)
    return np.asarray(wrap(at - truth.value[:, 0]))


def ratios(results: Mapping[str, Compared]) -> dict[str, dict[str, tuple[float, float, float]]]:
    """For each multibody observer and each other way, on all drives together on which both are there, the error of the
    other over that of the observer with its interval."""
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for observer in MULTIBODY:
        for way in WAYS[len(MULTIBODY) :]:
            both = [one for one in results.values() if observer in one.errors and way in one.errors]
            if both:
                blocks = np.vstack([one.blocks((observer, way)) for one in both])
                found.setdefault(observer, {})[way] = ratio_interval(blocks)
    return found


def not_better(results: Mapping[str, Compared]) -> list[str]:
    """Sentences on drives on which no multibody observer is significantly better than a way, by name and interval."""
    lines = []
    for title, one in results.items():
        observers = [name for name in MULTIBODY if name in one.errors]
        if not observers:
            lines.append(f"{title}: no multibody observer got through")
            continue
        best = min(observers, key=one.rmse)
        for way in WAYS[len(MULTIBODY) :]:
            if way in one.errors:
                ratio, low, high = ratio_interval(one.blocks((best, way)))
                if low <= 1.0:
                    lines.append(f"{title}: {way} has {ratio:.2f} times the error of {best} ({low:.2f} to {high:.2f})")
    return lines


def write(results: Mapping[str, Compared], path: Path) -> None:
    """Write errors [°] and ratios as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rmse = {title: {way: one.rmse(way) for way in WAYS if way in one.errors} for title, one in results.items()}
    with atomic_write(path) as file:
        json.dump({"side_slip_rmse_deg": rmse, "ratios": ratios(results)}, file, indent=2)
        file.write("\n")


def show(results: Mapping[str, Compared], console: Console) -> None:
    """Print errors by drive, then how many times those of the multibody observers the others have."""
    table = plain_table("side slip, RMSE [°]", "a_y", *WAYS, right=("a_y", *WAYS))
    for title, one in results.items():
        cells = [f"{one.rmse(way):.2f}" if way in one.errors else "–" for way in WAYS]
        table.add_row(title, f"{one.largest:.1f}", *cells)
    console.print(table)
    found = ratios(results)
    table = plain_table("all drives: error over that of", *found, right=tuple(found))
    for way in WAYS[len(MULTIBODY) :]:
        cells = ["{:.2f} ({:.2f} to {:.2f})".format(*row[way]) if way in row else "–" for row in found.values()]
        table.add_row(way, *cells)
    console.print(table)
    for line in not_better(results):
        console.print(f"Not significantly better: {line}.")
    for title, one in results.items():
        for way, reason in one.absent.items():
            console.print(f"{title}: {way} is absent: {reason}.")
