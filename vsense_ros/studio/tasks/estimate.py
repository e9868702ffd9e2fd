"""Estimates of a recording with one vehicle and one filter."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import vsense_ros as vs
from vsense_ros.api.estimation import Task, estimate_task, prepare
from vsense_ros.api.result import Result
from vsense_ros.bag import write_bag
from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import SIGNALS
from vsense_ros.evaluate.wording import score_cells
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.messages.laps import laps
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.studio.curves import CURVES, DISTANCE, CurveWriter, driven
from vsense_ros.studio.tasks.data import EAST, NORTH, recording_of


def estimate(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Estimate a recording; writes curves with ±2σ and reference, the bag of the estimates and, if the car was changed
    for it, the vehicle file that was used."""
    car = _with_sensors(vs.load_vehicle(options["vehicle"]), options.get("without", []))
    if options.get("without"):
        save_vehicle(folder / "vehicle.yaml", car)
    task = prepare(recording_of(options["recording"]), car, mend=bool(options.get("mend")))
    result = estimate_task(
        task, options["filter"], smooth=bool(options.get("smooth")), lag=options.get("lag") or None, progress=progress
    )
    write_estimates(result, task, folder / CURVES)
    write_bag(folder / "output", result.output, overwrite=True)
    drive = result.drive
    return {
        "name": drive.name,
        "title": drive.title,
        "failure": result.failure,
        "warnings": list(task.warnings),
        "notes": [*task.notes, *drive.notes],
        "facts": drive.facts(),
        "scores": [
            {"name": name, "label": SIGNALS[name].label, "cells": score_cells(name, one, drive.trivial.get(name)),
             "within_2s": one.within_2s}
            for name, one in drive.scores.items()
        ],
        "balance": None if drive.balance is None else drive.balance.percent,
        "parameters": {name: list(value) for name, value in result.parameters.items()},
        "diagnostics": [
            {"name": one.name, "level": one.level.name, "message": one.message} for one in drive.diagnostics
        ],
        "static_loads": static_loads(car),
        "curves": CURVES,
    }  # fmt: skip


def _with_sensors(car: Vehicle, without: list[str]) -> Vehicle:
    sensors = {name: sensor for name, sensor in car.sensors.items() if name not in without}
    if not sensors:
        raise InputError("all sensors are switched off; switch on an inertial sensor at least")
    document = car.model_dump(mode="json")
    document["sensors"] = {name: document["sensors"][name] for name in sensors}
    keys = document["uncertainty"]
    document["uncertainty"] = {
        key: value for key, value in keys.items() if key.split(".")[0] != "sensors" or key.split(".")[1] in sensors
    }
    return Vehicle.model_validate(document)


def static_loads(car: Vehicle) -> dict[str, float]:
    """Vertical force on each tyre of the car at rest [N]."""
    chassis = car.physics.chassis
    front = chassis.cog_to_rear_axle / (chassis.cog_to_front_axle + chassis.cog_to_rear_axle)
    weight = chassis.mass * 9.80665
    return {wheel: weight * (front if wheel[0] == "f" else 1 - front) / 2 for wheel in ("fl", "fr", "rl", "rr")}


def write_estimates(result: Result, task: Task, folder: Path) -> None:
    """Curves of all estimated signals in the units that people read, over the time since the first stamp of the
    recording; `NAME:low`, `NAME:high` are ±2σ, `NAME:reference` is the reference, `NAME:error` the difference."""
    recording = task.recording
    start = recording.first_stamp
    begins = [(lap.first_stamp - start) * 1e-9 for lap in laps(recording)]
    writer = CurveWriter(folder, name=result.drive.title, laps=[*begins, recording.duration] if len(begins) > 1 else [])
    for name, signal in result.signals.items():
        shown = SIGNALS[name]
        scale = shown.shown_per_unit
        time = (signal.stamp - start) * 1e-9
        about = {"unit": shown.shown_unit, "label": shown.label, "topic": "estimates"}
        if signal.value.ndim == 2:
            writer.add(
                time, {EAST: signal.value[:, 0], NORTH: signal.value[:, 1]}, unit="m", label="path", topic="path"
            )
            continue
        parts = {name: signal.value * scale}
        if signal.sigma is not None:
            band = np.where(np.isfinite(signal.sigma), 2 * signal.sigma, np.nan)
            parts |= {f"{name}:low": (signal.value - band) * scale, f"{name}:high": (signal.value + band) * scale}
        if signal.reference is not None:
            parts[f"{name}:reference"] = signal.reference * scale
        if signal.error is not None:
            parts[f"{name}:error"] = signal.error * scale
        writer.add(time, parts, **about)
        if name == "speed":
            writer.add(time, {DISTANCE: driven(time, signal.value)}, unit="m", label="distance", topic="path")
    writer.close()
