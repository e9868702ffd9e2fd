"""Identification of a car from two laps, and the observer's examination on a third.

The laps are those of the MPC Berkeley Genesis: the vehicle file's handling parameters, the mounting of the reference
and the filter's noise levels come from the slow and the fast lap, whose lateral velocity may be used for that. On the
third lap the observer gets steering, yaw rate, accelerations and GNSS; lateral velocity and heading are for the
comparison only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsense_ros.bag.importers import genesis
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.metrics import SignalScore, align, compare
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import run
from vsense_ros.recording import Recording

IDENTIFIED_FROM = ("cpg_slow_lap.mat", "cpg_fast_lap.mat")
EXAMINED_ON = "med_lap_center_8_21.mat"
OUTAGE = 10.0  # length of the GNSS outage [s]

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Knob:
    """Something to identify: the numbers of the vehicle file that change together, each by a power of one factor."""

    name: str
    powers: Mapping[str, float]  # dotted path in the file: power
    factor: float  # first step of the search

    def turned(self, vehicle: Vehicle, factor: float) -> Vehicle:
        """The vehicle with this knob turned by `factor`; raises `ValueError` if that is no valid vehicle."""
        data = vehicle.model_dump()
        for path, power in self.powers.items():
            *steps, last = path.split(".")
            node: Any = data
            for step in steps:
                node = node[step]
            if isinstance(node[last], tuple):
                node[last] = tuple(value * factor**power for value in node[last])
            else:
                node[last] = node[last] * factor**power
        return Vehicle.model_validate(data)


def _cornering(axle: str, power: float) -> dict[str, float]:
    """Cornering stiffness of an axle at unchanged largest force and unchanged shape of the curve."""
    powers: dict[str, float] = {}
    for load in ("nominal", "double"):
        curve = f"physics.{axle}.tyre.lateral.{load}"
        powers |= {
            f"{curve}.initial_slope": power,
            f"{curve}.slip_at_maximum": -power,
            f"{curve}.slip_at_sliding": -power,
        }
    return powers


def _curvature(axle: str) -> dict[str, float]:
    """How early the curve bends, at unchanged initial slope and largest force."""
    powers: dict[str, float] = {}
    for load in ("nominal", "double"):
        curve = f"physics.{axle}.tyre.lateral.{load}"
        powers |= {f"{curve}.slip_at_maximum": 1.0, f"{curve}.slip_at_sliding": 1.0}
    return powers


KNOBS = (
    Knob("steering gain", {"sensors.steering.gain": 1}, 1.04),
    Knob("front cornering stiffness", _cornering("front", 1), 1.08),
    Knob("rear cornering stiffness", _cornering("rear", 1), 1.08),
    Knob("front curvature", _curvature("front"), 1.2),
    Knob("rear curvature", _curvature("rear"), 1.2),
    Knob(
        "place of antenna and reference",
        {"sensors.position.position": 1, "sensors.velocity.position": 1, "reference.position": 1},
        1.5,
    ),
    Knob("front anti-roll stiffness", {"physics.front.antiroll_stiffness": 1}, 1.4),
    Knob("accelerometer offset", {"sensors.imu.force_offset": 1}, 1.05),
    Knob("latency of the car's bus", {"sensors.imu.latency": 1, "sensors.steering.latency": 1}, 1.4),
    Knob("lateral force error", {"observer.force_errors.lateral": 1}, 1.5),
    Knob("yaw force error", {"observer.force_errors.yaw": 1}, 1.5),
    Knob("force error time constant", {"observer.force_errors.time_constant": 1}, 1.6),
    Knob("bank", {"observer.surroundings.bank": 1}, 1.5),
    Knob("bank time constant", {"observer.surroundings.bank_time_constant": 1}, 1.6),
    Knob("gyro noise", {"sensors.imu.rate_noise": 1}, 1.5),
    Knob("accelerometer noise", {"sensors.imu.force_noise": 1}, 1.5),
    Knob("gyro bias drift", {"sensors.imu.rate_bias_drift": 1}, 3.0),
    Knob("GNSS velocity noise", {"sensors.velocity.noise": 1}, 1.5),
)


def lateral_error(vehicle: Vehicle, laps: Sequence[Recording]) -> tuple[float, float]:
    """Geometric mean of the RMSE of side slip [rad] and lateral velocity [m/s] over some laps, each lap with equal
    weight, once the mean error of the side slip is removed; and that mean error [rad], by which the mounting angle of
    the reference should change.

    The side slip alone would favour slow parts of the laps, the lateral velocity alone fast ones.
    """
    slip, lateral = [], []
    for lap in laps:
        output = read_signals(at_reference(run(lap, vehicle, rate=10.0).output, vehicle), "vsense")
        truth = read_signals(lap, "reference")
        slip.append(align(output["side_slip"], truth["side_slip"]).error[:, 0])
        both = align(output["lateral_velocity"], truth["lateral_velocity"])
        forward = align(output["longitudinal_velocity"], truth["longitudinal_velocity"])
        speed = np.interp(both.stamp, forward.stamp, forward.truth[:, 0])
        lateral.append((both.error[:, 0], speed))
    mean = float(np.concatenate(slip).mean())
    slip_square = np.mean([np.mean((e - mean) ** 2) for e in slip])
    lateral_square = np.mean([np.mean((e - mean * speed) ** 2) for e, speed in lateral])
    return float((slip_square * lateral_square) ** 0.25), mean


def identify(vehicle: Vehicle, laps: Sequence[Recording], sweeps: int = 3, progress: Progress | None = None) -> Vehicle:
    """Turn the knobs one after the other, by shrinking factors, as long as side slip and lateral velocity get better.

    A pattern search needs no derivatives and nothing but the observer itself; it costs about 40 runs over all laps a
    sweep. `progress` takes the share done.
    """
    best, mean = lateral_error(vehicle, laps)
    factors = {knob.name: knob.factor for knob in KNOBS}
    for sweep in range(sweeps):
        for i, knob in enumerate(KNOBS):
            factor = factors[knob.name]
            for turn in (factor, 1 / factor):
                try:
                    candidate = knob.turned(vehicle, turn)
                except ValueError:
                    continue
                error, candidate_mean = lateral_error(candidate, laps)
                if error < best:
                    vehicle, best, mean = candidate, error, candidate_mean
                    break
            else:
                factors[knob.name] = factor**0.5
            if progress is not None:
                progress((sweep + (i + 1) / len(KNOBS)) / sweeps)
    reference = vehicle.reference.model_copy(update={"yaw": vehicle.reference.yaw + mean})
    return vehicle.model_copy(update={"reference": reference})


def fastest_corner(lap: Recording) -> tuple[float, float]:
    """Begin and end [s after the first row] of the `OUTAGE` seconds around the largest product of speed and gyro."""
    imu, velocity = lap["imu/data"], lap["gps/velocity"]
    speed = np.interp(imu.stamp, velocity.stamp, np.hypot(*velocity.columns["linear"][:, :2].T))
    turn = np.abs(imu.columns["angular_velocity"][:, 2] * speed)
    middle = float(imu.seconds[np.argmax(turn)])
    return middle - OUTAGE / 2, middle + OUTAGE / 2


def examine(folder: Path, vehicle: Vehicle, progress: Progress | None = None) -> dict[str, dict[str, float]]:
    """Scores on the third lap: GNSS at 10 Hz, at 1 Hz, with an outage in the fastest corner (scored within it), and
    two formulas that an observer has to beat.

    Side slip in degrees where the car is faster than 3 m/s, lateral velocity as NRMSD in percent.
    """
    path = folder / EXAMINED_ON
    lap = genesis.read(path)
    outage = fastest_corner(lap)
    cases = {
        "10hz": (lap, None),
        "1hz": (genesis.read(path, gnss_rate_hz=1.0), None),
        "outage": (genesis.read(path, gnss_outage=outage), outage),
    }
    results: dict[str, dict[str, float]] = {}
    for i, (name, (recording, window)) in enumerate(cases.items()):
        output = run(recording, vehicle, progress=_part(progress, i, len(cases))).output
        results[name] = _figures(_scores(at_reference(output, vehicle), recording, window))
    others = [genesis.read(folder / name) for name in IDENTIFIED_FROM]
    fitted = baselines.regression(lap, baselines.fit_regression(others))
    results["regression"] = _figures(baselines.score_all(fitted, lap))
    rolling = baselines.kinematic(lap, vehicle.physics.chassis.cog_to_rear_axle)
    results["kinematic"] = _figures(baselines.score_all(rolling, lap))
    return results


def _part(progress: Progress | None, index: int, count: int) -> Progress | None:
    return None if progress is None else lambda share: progress((index + share) / count)


def _scores(output: Recording, lap: Recording, window: tuple[float, float] | None) -> Mapping[str, SignalScore]:
    if window is None:
        return compare(output, lap)
    reference = lap["reference/odometry"]
    inside = (reference.seconds >= window[0]) & (reference.seconds <= window[1])
    part = Recording({**lap.channels, "reference/odometry": reference.select(inside)}, lap.name, metadata=lap.metadata)
    return compare(output, part)


def _figures(scores: Mapping[str, SignalScore]) -> dict[str, float]:
    return {
        "side_slip_rmse_deg": float(np.degrees(scores["side_slip"].rmse)),
        "lateral_velocity_nrmsd_percent": float(scores["lateral_velocity"].nrmsd_percent or np.nan),
    }


def write_results(results: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """The results as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
