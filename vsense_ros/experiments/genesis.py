"""Identification of a car from two laps, and the observer's examination on a third.

The laps are those of the MPC Berkeley Genesis: the vehicle file's handling parameters, the mounting of the reference
and the filter's noise levels come from the slow and the fast lap, whose lateral velocity may be used for that. On the
third lap the observer gets steering, yaw rate, accelerations and GNSS; lateral velocity and heading are for the
comparison only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vsense_ros.bag.importers import genesis
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.metrics import SignalScore, compare
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.identify.side_slip import Fit, FreeParameter, Progress, fit, part
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import run

IDENTIFIED_FROM = ("cpg_slow_lap.mat", "cpg_fast_lap.mat")
EXAMINED_ON = "med_lap_center_8_21.mat"
OUTAGE = 10.0  # length of the GNSS outage [s]

SOURCE = (
    "Fitted to the slow and the fast lap by `vsense genesis --identify`: {knobs}, mounting of the reference. "
    "All else is as in genesis_start.yaml, which says where it comes from."
)


def _cornering(axle: str) -> dict[str, float]:
    """Cornering stiffness of an axle at unchanged largest force and unchanged shape of the curve."""
    powers: dict[str, float] = {}
    for load in ("nominal", "double"):
        curve = f"physics.{axle}.tyre.lateral.{load}"
        powers |= {
            f"{curve}.initial_slope": 1.0,
            f"{curve}.slip_at_maximum": -1.0,
            f"{curve}.slip_at_sliding": -1.0,
        }
    return powers


KNOBS = (
    FreeParameter("steering gain", {"sensors.steering.gain": 1}, 0.1),
    FreeParameter("front cornering stiffness", _cornering("front"), 0.2),
    FreeParameter("rear cornering stiffness", _cornering("rear"), 0.2),
    FreeParameter(
        "place of antenna and reference",
        {"reference.position.0": 1, "sensors.position.position.0": 1, "sensors.velocity.position.0": 1},
        0.3,
        adds=True,
    ),
    FreeParameter(
        "latency of the car's bus", {"sensors.imu.latency": 1, "sensors.steering.latency": 1}, 0.02, adds=True
    ),
    FreeParameter("lateral force error", {"observer.force_errors.lateral": 1}, 0.7),
    FreeParameter("yaw force error", {"observer.force_errors.yaw": 1}, 0.7),
    FreeParameter("force error time constant", {"observer.force_errors.time_constant": 1}, 0.7),
    FreeParameter("bank", {"observer.surroundings.bank": 1}, 0.7),
    FreeParameter("steering offset", {"observer.surroundings.steering_offset": 1}, 0.7),
    FreeParameter("gyro noise", {"sensors.imu.rate_noise": 1}, 0.5),
    FreeParameter("accelerometer noise", {"sensors.imu.force_noise": 1}, 0.7),
    FreeParameter("GNSS velocity noise", {"sensors.velocity.noise": 1}, 0.5),
)


def identification_laps(folder: Path) -> list[Recording]:
    """The slow and the fast lap, with GNSS as in the three cases of the examination in turn: `OUTAGE` seconds each at
    10 Hz, at 1 Hz and silent.

    With GNSS always there, the fit learns to lean on it, and has nothing to say once it is gone.
    """
    return [_with_changing_gnss(genesis.read(folder / name)) for name in IDENTIFIED_FROM]


def _with_changing_gnss(lap: Recording) -> Recording:
    channels = dict(lap.channels)
    for topic in ("gps/fix", "gps/velocity"):
        channel = channels[topic]
        turn = (channel.seconds // OUTAGE).astype(int) % 3
        tenth = np.round(channel.seconds * 10).astype(int) % 10 == 0
        channels[topic] = channel.select((turn == 0) | ((turn == 1) & tenth))
    return replace(lap, channels=channels)


def identify(start: Vehicle, laps: Sequence[Recording], progress: Progress | None = None) -> Fit:
    """The vehicle whose side slip on the laps comes closest to the reference, searched from `start`."""
    found = fit(start, KNOBS, laps, progress=progress)
    source = SOURCE.format(free_parameters=", ".join(parameter.name for parameter in KNOBS))
    return replace(found, vehicle=found.vehicle.model_copy(update={"source": source}))


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
        output = run(recording, vehicle, progress=part(progress, i, len(cases))).output
        results[name] = _figures(_scores(at_reference(output, vehicle), recording, window))
    fitted = baselines.regression(
        lap, baselines.fit_regression([genesis.read(folder / name) for name in IDENTIFIED_FROM])
    )
    results["regression"] = _figures(baselines.score_all(fitted, lap))
    rolling = baselines.kinematic(lap, vehicle.physics.chassis.cog_to_rear_axle)
    results["kinematic"] = _figures(baselines.score_all(rolling, lap))
    return results


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
