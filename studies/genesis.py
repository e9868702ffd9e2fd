"""Identification of a car from two laps, and the observer's examination on a third.

The laps are those of the MPC Berkeley Genesis: the vehicle file's handling parameters, the mounting of the reference
and the filter's noise levels come from the slow and the fast lap, whose lateral velocity may be used for that. On the
third lap the observer gets steering, yaw rate, accelerations and GNSS; lateral velocity and heading are for the
comparison only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from studies.coverage import Compared, within
from studies.heading_transient import HeadingTransient, transient_of, without_transient
from studies.side_slip_fit import SideSlipFit, fit_side_slip
from vsense_ros.bag.importers import genesis
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.metrics import SignalScore, compare
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.identification.free_parameter import FreeParameter, added, multiplied
from vsense_ros.identification.progress import Progress, part
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.observed import fitted_place
from vsense_ros.model.vehicle import Reference, Vehicle
from vsense_ros.runner import run

IDENTIFIED_FROM = ("cpg_slow_lap.mat", "cpg_fast_lap.mat")
EXAMINED_ON = "med_lap_center_8_21.mat"
OUTAGE = 10.0  # length of the GNSS outage [s]

SOURCE = (
    "Fitted to the slow and the fast lap by `python -m studies genesis --identify`: {fitted}, mounting of the "
    "reference. All else is as in genesis_start.yaml, which says where it comes from."
)


def _factor(name: str, deviation: float, numbers: Mapping[str, float]) -> FreeParameter:
    """Numbers that change together by a factor, of which `deviation` is a likely logarithm."""
    return FreeParameter(name, "-", deviation, -np.inf, np.inf, multiplied(numbers))


def _shift(name: str, unit: str, deviation: float, *numbers: str) -> FreeParameter:
    """Numbers that the same is added to."""
    return FreeParameter(name, unit, deviation, -np.inf, np.inf, added(*numbers))


def _cornering_stiffness(axle: str) -> dict[str, float]:
    """Powers of what makes up the cornering stiffness of an axle, at unchanged largest force and unchanged shape of the
    curve."""
    powers: dict[str, float] = {}
    for load in ("nominal", "double"):
        curve = f"{axle}.tyre.lateral.{load}"
        powers |= {
            f"{curve}.initial_slope": 1.0,
            f"{curve}.slip_at_maximum": -1.0,
            f"{curve}.slip_at_sliding": -1.0,
        }
    return powers


# Deviations are how far the truth may well be from what genesis_start.yaml says.
FREE_PARAMETERS = (
    _factor("steering gain", 0.1, {"sensors.steering.gain": 1}),
    _factor("front cornering stiffness", 0.2, _cornering_stiffness("front")),
    _factor("rear cornering stiffness", 0.2, _cornering_stiffness("rear")),
    _shift(
        "place of antenna and reference", "m", 0.3,
        "reference.position.0", "sensors.position.position.0", "sensors.velocity.position.0",
    ),
    _shift("latency of the car's bus", "s", 0.02, "sensors.imu.latency", "sensors.steering.latency"),
    _factor("lateral force error", 0.7, {"observer.force_errors.lateral": 1}),
    _factor("yaw force error", 0.7, {"observer.force_errors.yaw": 1}),
    _factor("force error time constant", 0.7, {"observer.force_errors.time_constant": 1}),
    _factor("bank", 0.7, {"observer.surroundings.bank": 1}),
    _factor("steering offset", 0.7, {"observer.surroundings.steering_offset": 1}),
    _factor("gyro noise", 0.5, {"sensors.imu.rate_noise": 1}),
    _factor("accelerometer noise", 0.7, {"sensors.imu.force_noise": 1}),
    _factor("GNSS velocity noise", 0.5, {"sensors.velocity.noise": 1}),
)  # fmt: skip


def identification_laps(folder: Path) -> list[Recording]:
    """The slow and the fast lap, with GNSS as in the three cases of the examination in turn: `OUTAGE` seconds each at
    10 Hz, at 1 Hz and silent.

    With GNSS there all the time, the fit would come to rely on it, and fail where it is gone.
    """
    return [_with_changing_gnss(genesis.read(folder / name)) for name in IDENTIFIED_FROM]


def _with_changing_gnss(lap: Recording) -> Recording:
    channels = dict(lap.channels)
    for topic in ("gps/fix", "gps/velocity"):
        channel = channels[topic]
        case = (channel.seconds // OUTAGE).astype(int) % 3
        each_second = np.round(channel.seconds * 10).astype(int) % 10 == 0
        channels[topic] = channel.select((case == 0) | ((case == 1) & each_second))
    return replace(lap, channels=channels)


def identify(start: Vehicle, laps: Sequence[Recording], progress: Progress | None = None) -> SideSlipFit:
    """The vehicle whose side slip on the laps comes closest to the reference, searched from `start`."""
    fit = fit_side_slip(start, FREE_PARAMETERS, laps, progress=progress)
    source = SOURCE.format(fitted=", ".join(parameter.name for parameter in FREE_PARAMETERS))
    return replace(fit, vehicle=fit.vehicle.model_copy(update={"source": source}))


def fastest_corner(lap: Recording) -> tuple[float, float]:
    """Begin and end [s after the first row] of the `OUTAGE` seconds around the largest product of speed and gyro."""
    imu, velocity = lap["imu/data"], lap["gps/velocity"]
    speed = np.interp(imu.stamp, velocity.stamp, np.hypot(*velocity.columns["linear"][:, :2].T))
    lateral = np.abs(imu.columns["angular_velocity"][:, 2] * speed)
    middle = float(imu.seconds[np.argmax(lateral)])
    return middle - OUTAGE / 2, middle + OUTAGE / 2


@dataclass(frozen=True)
class Examination:
    """Scores on the third lap by case: of all of it, of what comes after the start-up transient of the reference's
    heading, and with that taken out; and of two formulas that an observer has to beat."""

    whole: Mapping[str, Compared]
    settled: Mapping[str, Compared]
    without_transient: Mapping[str, Compared]
    formulas: Mapping[str, Mapping[str, SignalScore]]
    transient: HeadingTransient

    def figures(self) -> dict[str, dict[str, Any]]:
        """Figures of each case, ready for JSON: side slip in degrees where the car is faster than 3 m/s, lateral
        velocity as NRMSD in percent, and for each signal what `Compared.figures` has."""
        found: dict[str, dict[str, Any]] = {}
        for case, compared in self.whole.items():
            found[case] = _figures(compared.scores) | {
                "after_transient": _figures(self.settled[case].scores),
                "without_transient": _figures(self.without_transient[case].scores),
                "signals": compared.figures(),
                "signals_after_transient": self.settled[case].figures(),
            }
        found |= {name: _figures(scores) for name, scores in self.formulas.items()}
        return found | {"reference": asdict(self.transient) | {"over": self.transient.over}}


def examine(folder: Path, vehicle: Vehicle, progress: Progress | None = None) -> Examination:
    """Examine the observer on the third lap: GNSS at 10 Hz, at 1 Hz, with an outage in the fastest corner (scored
    within it).

    The transient of the reference is fitted to the formula whose coefficients come from the two other laps.
    """
    path = folder / EXAMINED_ON
    lap = genesis.read(path)
    coefficients = baselines.fit_regression([genesis.read(folder / name) for name in IDENTIFIED_FROM])
    formulas = {
        "regression": baselines.regression(lap, coefficients),
        "kinematic": baselines.kinematic(lap, vehicle.physics.chassis.cog_to_rear_axle),
    }
    transient = transient_of(lap, formulas["regression"])
    assert transient is not None
    outage = fastest_corner(lap)
    cases = {
        "10hz": (lap, (0.0, np.inf)),
        "1hz": (genesis.read(path, gnss_rate_hz=1.0), (0.0, np.inf)),
        "outage": (genesis.read(path, gnss_outage=outage), outage),
    }
    whole, settled, without = {}, {}, {}
    for i, (name, (recording, (begin, end))) in enumerate(cases.items()):
        output = at_reference(run(recording, vehicle, progress=part(progress, i, len(cases))).output, vehicle)
        whole[name] = Compared.of(output, recording, (begin, end))
        settled[name] = Compared.of(output, recording, (max(begin, transient.over), end))
        without[name] = Compared.of(output, without_transient(recording, transient), (begin, end))
    scores = {name: baselines.score_all(series, lap) for name, series in formulas.items()}
    return Examination(whole, settled, without, scores, transient)


def side_slip(folder: Path, vehicle: Vehicle, stated: Reference, progress: Progress | None = None) -> dict[str, float]:
    """Error of the side slip on the third lap [deg], at 10 Hz and within the outage: with the reference where it is
    `stated` to be, and without its constant, where it is by the lap at 10 Hz itself. A place is measured from the
    centre of gravity, which is another for another vehicle file."""
    path = folder / EXAMINED_ON
    lap = genesis.read(path)
    window = fastest_corner(lap)
    output = run(lap, vehicle, progress=part(progress, 0, 2)).output
    silent = genesis.read(path, gnss_outage=window)
    in_outage = run(silent, vehicle, progress=part(progress, 1, 2)).output
    place = fitted_place([output], [lap], vehicle)
    assert place is not None
    own = stated.model_copy(update={"position": (place.x, place.y, 0.0), "yaw": place.yaw})

    def error(
        estimates: Recording, recording: Recording, where: Reference, inside: tuple[float, float] | None
    ) -> float:
        moved = at_reference(estimates, vehicle.model_copy(update={"reference": where}))
        judged = recording if inside is None else within(recording, *inside)
        return _figures(compare(moved, judged))["side_slip_rmse_deg"]

    return {
        "side_slip_deg": error(output, lap, stated, None),
        "side_slip_without_constant_deg": error(output, lap, own, None),
        "outage_deg": error(in_outage, silent, stated, window),
        "outage_without_constant_deg": error(in_outage, silent, own, window),
    }


def _figures(scores: Mapping[str, SignalScore]) -> dict[str, float]:
    return {
        "side_slip_rmse_deg": float(np.degrees(scores["side_slip"].rmse)),
        "lateral_velocity_nrmsd_percent": float(scores["lateral_velocity"].nrmsd_percent or np.nan),
    }


def write_results(results: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """The results as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
