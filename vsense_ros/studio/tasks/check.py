"""Checks of recordings against a vehicle, calibration of its sensors, and what a drive can determine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import vsense_ros as vs
from vsense_ros.api.preparation import write_calibration
from vsense_ros.assess import observability
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Finding
from vsense_ros.checks.mending import mends
from vsense_ros.checks.roles import topics_of
from vsense_ros.checks.sentences import mend_in_words, sentence
from vsense_ros.errors import InputError
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.prepare.calibration_report import as_dict
from vsense_ros.studio.tasks.data import recording_of, recordings_of, write_curves


def check(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Check each recording by itself and against the vehicle; a mend comes with curves before and after."""
    car = vs.load_vehicle(options["vehicle"])
    topics, radius = topics_of(car.sensors.values()), float(np.mean(rolling_radii(car)))
    drives, recordings = [], []
    for i, one in enumerate(options["recordings"]):
        recording = recording_of(one)
        recordings.append(recording)
        corrections = mends(recording, topics, radius)
        if corrections:
            write_curves(mended(recording, corrections), folder / f"mended{i}")
        reported = findings(recording, topics, radius)
        drives.append(
            {
                "path": one["path"],
                "name": recording.name,
                "findings": [_as_dict(finding) for finding in reported],
                "mends": [{"topic": mend.topic, "words": mend_in_words(mend)} for mend in corrections],
                "mended_curves": f"mended{i}" if corrections else "",
                "absent": [one.topic for one in car.sensors.values() if one.topic not in recording],
                "blocking": bool(corrections),
            }
        )
        progress((i + 1) / (len(options["recordings"]) + 1))
    fit = vs.check(options["vehicle"], recordings)
    return {"drives": drives, "vehicle": fit.as_dict(), "sentences": fit.sentences()}


def _as_dict(finding: Finding) -> dict[str, Any]:
    return {
        "topic": finding.topic,
        "signal": finding.signal,
        "against": finding.against,
        "kind": finding.kind.value,
        "confidence": finding.confidence.name.lower(),
        "span": finding.span,
        "sentence": sentence(finding),
        "mend": mend_in_words(finding) if finding.mend is not None else "",
    }


def calibrate(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Calibrate the sensors: latencies, mountings, radii, steering; writes the vehicle file to `target`."""
    calibration = vs.calibrate(recordings_of(options["recordings"]), options["vehicle"])
    write_calibration(calibration, options["target"], options["vehicle"])
    return {**as_dict(calibration), "target": options["target"]}


def observe(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Which states of a GNSS/INS filter each recording determines, and which motion would determine the others."""
    car = vs.load_vehicle(options["vehicle"])
    (one,) = options["recordings"][:1] or [None]
    if one is None:
        raise InputError("open a recording first; without one there is nothing to observe")
    report = observability.report(recording_of(one), car, options["filter"], ask=True, progress=progress)
    return {
        "filter": report.filter,
        "drive": report.drive,
        "states": [
            {"name": state.name, "left": state.left, "at": state.determined_at, "motion": state.motion,
             "would": dict(report.would.get(state.name, {}))}
            for state in report.determined.states
        ],
    }  # fmt: skip
