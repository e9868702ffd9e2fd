"""Estimates from recordings: what the command `vsense run` does, as functions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vsense_ros.api.recording import Source, read
from vsense_ros.api.result import Result
from vsense_ros.api.vehicle import load_vehicle
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.examination import findings
from vsense_ros.checks.mending import mends
from vsense_ros.checks.roles import topics_of
from vsense_ros.checks.sentences import mend_in_words, sentences
from vsense_ros.errors import InputError
from vsense_ros.estimation.reading import noise_at_start
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.metrics import SignalScore, compare
from vsense_ros.evaluate.reference import REFERENCE, as_smoothed, at_reference, judged_by, mounting_in_words
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.identification.averages import AVERAGES
from vsense_ros.identification.mass_and_grade import MassAndGrade, mass_in
from vsense_ros.identification.towing import Towing, towing_in
from vsense_ros.identification.tyre_radii import TyreRadii, radii_in
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import unheard
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.run import Run, run

Progress = Callable[[float], None]  # takes the share done, 0 to 1
UNSETTLED = 0.5  # standard deviations that a last iteration may move a state by without a warning


class RecordingWarning(UserWarning):
    """Something in a recording looks wrong, or does not fit the vehicle."""


@dataclass(frozen=True)
class Task:
    """A recording that has been examined for one vehicle: `warnings` say what looks wrong in it or is missing, `notes`
    what was mended and which standard deviations count, in sentences."""

    recording: Recording
    vehicle: Vehicle
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Smoothed:
    """A recording with the motion of its car on `smoothed/odometry`, `smoothed/sideslip` and so on, at the centre of
    gravity.

    `deviations` has the median standard deviation of each of its signals [SI], `parameters` those of sensors and car
    that the recording determines, by name, value and standard deviation; the last iteration still moved a state by
    `change` standard deviations. `scores` compare the motion with the reference of the recording, which is not used
    otherwise.
    """

    recording: Recording
    deviations: Mapping[str, float]
    parameters: Mapping[str, tuple[float, float]]
    change: float
    scores: Mapping[str, SignalScore]


def prepare(source: Source, vehicle: str | Path | Vehicle, *, mend: bool = False) -> Task:
    """Examine a recording for a vehicle, and correct what cannot be right in it if `mend`: signs, axes and units.

    Raises `InputError` as `read` and `load_vehicle` do.
    """
    recording, car = read(source), load_vehicle(vehicle)
    if not recording.name:
        recording = replace(recording, name=source.stem if isinstance(source, Path) else "recording")
    sensors = car.sensors.values()
    doubts = list(unheard(recording.channels, sensors, car.name))
    topics, radius = topics_of(sensors), float(np.mean(rolling_radii(car)))
    notes = []
    if mend:
        corrections = mends(recording, topics, radius)
        recording = mended(recording, corrections)
        notes += [f"Mended: {mend_in_words(correction)}." for correction in corrections]
    doubts += sentences(findings(recording, topics, radius))
    heading = [sensor.topic for sensor in sensors if sensor.on_map]
    if heading and not any(topic in recording for topic in heading):
        doubts.append(f"none of {', '.join(heading)} is in the recording: the car's heading on the map stays unknown")
    for sensor, noise in noise_at_start(recording, car.sensing()).items():
        if noise.doubt:
            doubts.append(f"{sensor}: {noise.doubt}")
        else:
            notes.append(f"{sensor}: standard deviation {noise.words}")
    return Task(recording, car, tuple(filter(None, doubts)), tuple(notes))


def estimate(
    source: Source,
    vehicle: str | Path | Vehicle,
    filter: str = "",
    *,
    smooth: bool = False,
    lag: float | None = None,
    against: str = REFERENCE,
    mend: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Estimate what a car did that its sensors did not measure, and compare it with the reference if there is one.

        result = vs.estimate("lap.mcap", "genesis", filter="error_ekf")
        result["side_slip"].value, result["side_slip"].sigma  # (n,) rad
        result.save("lap.csv")

    Args:
        source: a recording, or a path as `read` takes it.
        vehicle: a vehicle, its file, or the name of one that comes with the project.
        filter: its name, as `vsense filters` lists them; by default the errorEKF, or the SPI where the vehicle file
            lists parameters to be estimated.
        smooth: use the whole recording for each estimate (GNSS/INS filters of one state space).
        lag: use so many seconds of later data for each estimate [s]; the same filters.
        against: first part of the topics that the estimates are compared with: `reference`, or `smoothed` of what
            `smooth` returns.
        mend: correct signs, axes and units of the recording that cannot be right.
        progress: is called with the share done, 0 to 1.

    What looks wrong in the recording is issued as a `RecordingWarning` each. Raises `InputError` if the recording has
    none of the vehicle's sensors, the filter does not exist, does not fit the vehicle or never starts. A filter that
    diverges raises nothing: `result.failure` says when and why.
    """
    task = prepare(source, vehicle, mend=mend)
    for sentence in task.warnings:
        warnings.warn(sentence, RecordingWarning, stacklevel=2)
    return estimate_task(task, filter, smooth=smooth, lag=lag, against=against, progress=progress)


def smooth(
    source: Source, vehicle: str | Path | Vehicle, *, mend: bool = False, progress: Progress | None = None
) -> Smoothed:
    """Compute how a car moved from all that its sensors measured before and after: a reference where none was driven.

        smoothed = vs.smooth("lap.mcap", "my_car.yaml")
        vs.estimate(smoothed.recording, "my_car.yaml", against="smoothed")

    Arguments and errors are those of `estimate`.
    """
    task = prepare(source, vehicle, mend=mend)
    for sentence in task.warnings:
        warnings.warn(sentence, RecordingWarning, stacklevel=2)
    return smooth_task(task, progress)


def smooth_task(task: Task, progress: Progress | None = None) -> Smoothed:
    """Smooth a recording that has been prepared; errors are those of `smooth`."""
    from vsense_ros.runner.smoothing import run_offline

    smoothed = run_offline(task.recording, task.vehicle, progress=progress)
    signals = read_signals(smoothed.output, "vsense")
    deviations = {
        name: float(np.median(series.deviation)) for name, series in signals.items() if series.deviation is not None
    }
    scores = compare(at_reference(smoothed.output, task.vehicle), task.recording)
    return Smoothed(
        as_smoothed(task.recording, smoothed.output), deviations, smoothed.parameters, smoothed.change, scores
    )


def estimate_task(
    task: Task,
    filter: str = "",
    *,
    smooth: bool = False,
    lag: float | None = None,
    against: str = REFERENCE,
    progress: Progress | None = None,
) -> Result:
    """Estimate a recording that has been prepared; arguments and errors are those of `estimate`."""
    recording, car = judged_by(task.recording, against), task.vehicle
    estimation = _run(recording, car, filter, smooth, lag, progress or (lambda share: None))
    absent = [f"{line.message}." for line in estimation.diagnostics if line.name == "observability"]
    if against == REFERENCE:  # which sits elsewhere than cog
        place, compared = mounting_in_words(car), replace(estimation, output=at_reference(estimation.output, car))
    else:
        place, compared = f"Compared with the topics {against}/….", estimation
    compared = replace(compared, diagnostics=[*compared.diagnostics, *_beside(recording, car)])
    notes = tuple(sentence for sentence in (place, *absent) if sentence)
    title = f"{recording.name}, {car.name}"
    drive = Drive.of(recording.name, title, recording, compared, vehicle=car, way="without ROS", notes=notes)
    return Result(drive, estimation.output, car, estimation.parameters, estimation.failure)


def _beside(recording: Recording, car: Vehicle) -> list[Diagnostic]:
    """What filters beside the observer say at the end of a recording that has the sensors they need, and is long enough
    for them."""
    towing = towing_in(recording, car)
    found: list[TyreRadii | MassAndGrade | Towing | None] = [towing]
    if recording.duration >= AVERAGES.shortest:
        found = [radii_in(recording, car), mass_in(recording, car), towing]
    return [estimator.diagnostic() for estimator in found if estimator is not None]


def check_filter(filter: str, *, smooth: bool = False, lag: float | None = None) -> None:
    """Raises `InputError` for a filter that does not exist, or cannot be smoothed if that is asked for."""
    from vsense_ros.navigation.catalogue import FILTERS as NAVIGATION

    if filter:
        every_filter()[filter]
    if (smooth or lag) and filter not in NAVIGATION.names:
        raise InputError(
            "--smooth and --lag are for a GNSS/INS filter of one state space, which --filter names; `vsense filters` "
            "lists them"
        )


def _run(recording: Recording, car: Vehicle, filter: str, smooth: bool, lag: float | None, progress: Progress) -> Run:
    """Estimate a recording message by message, or smoothed."""
    check_filter(filter, smooth=smooth, lag=lag)
    if not (smooth or lag):
        return run(recording, car, filter, progress=progress)
    from vsense_ros.runner.smoothing import run_smoothed

    return run_smoothed(recording, car, filter, lag=lag, progress=progress)
