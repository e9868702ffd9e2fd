"""Does a vehicle file fit a recording? What the sensors say against each other, and what a calibration would change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from vsense_ros.checks.examination import findings
from vsense_ros.checks.roles import topics_of
from vsense_ros.checks.sentences import sentences
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrated import Calibrated
from vsense_ros.prepare.calibration import calibrate


@dataclass(frozen=True)
class FitSettings:
    """By how much a vehicle file may differ from what a drive says of it."""

    sure: float = setting(4.0, "-", "standard deviations of a difference that is no chance", JUDGEMENT)
    radius: float = setting(0.03, "-", "relative difference of a rolling radius", "wear and pressure, ETRTO")
    ratio: float = setting(0.12, "-", "relative difference of the steering ratio, or the wheelbase", JUDGEMENT)
    angle: float = setting(0.09, "rad", "difference of a mounting angle: 5°", JUDGEMENT)
    place: float = setting(1.0, "m", "difference of the place of an antenna", JUDGEMENT)
    latency: float = setting(0.1, "s", "difference of a latency", JUDGEMENT)
    rate: float = setting(0.02, "rad/s", "difference of a gyro's bias", "data sheets: below 1 deg/s")
    force: float = setting(0.5, "m/s²", "difference of an accelerometer's offset", "data sheets: below 0.5 m/s²")


FIT = FitSettings()

# Tolerances by the beginning of a quantity's name: of its value, or as a share of it.
_RELATIVE = {"rolling radius": FIT.radius, "steering ratio": FIT.ratio, "steering gain": FIT.ratio}
_ABSOLUTE = {
    "roll of": FIT.angle, "pitch of": FIT.angle, "yaw of": FIT.angle, "place of": FIT.place, "latency of": FIT.latency,
    "bias of": FIT.rate, "offset of the l": FIT.force,
}  # fmt: skip


@dataclass(frozen=True)
class FitCheck:
    """Where a vehicle file and recordings do not fit; and why they could not be compared, a sentence, if they could
    not."""

    findings: Sequence[FitFinding]
    not_compared: str = ""


@dataclass(frozen=True)
class FitFinding:
    """One thing in which a vehicle file and a recording do not fit: the keys of the file, and a sentence."""

    recording: str
    sentence: str
    keys: tuple[str, ...] = ()


def check_fit(vehicle: Vehicle, recordings: Sequence[Recording]) -> FitCheck:
    """Where a vehicle file and recordings of the car do not fit. What cannot be compared is no finding."""
    fit_findings = []
    topics, radius = topics_of(vehicle.sensors.values()), float(np.mean(rolling_radii(vehicle)))
    for recording in recordings:
        fit_findings += [
            FitFinding(recording.name, sentence) for sentence in sentences(findings(recording, topics, radius))
        ]
    try:
        quantities = calibrate(recordings, vehicle).quantities
    except InputError as error:
        return FitCheck(fit_findings, str(error))
    names = ", ".join(recording.name for recording in recordings)
    return FitCheck([*fit_findings, *(_finding(names, quantity) for quantity in quantities if _is_off(quantity))])


def _is_off(quantity: Calibrated) -> bool:
    """True if a drive determines a quantity, and surely another one than the file says."""
    relative = next((share for start, share in _RELATIVE.items() if quantity.name.startswith(start)), None)
    absolute = next((limit for start, limit in _ABSOLUTE.items() if quantity.name.startswith(start)), None)
    tolerance = absolute if relative is None else relative * abs(quantity.before)
    if tolerance is None or not quantity.determined:
        return False
    return abs(quantity.after - quantity.before) > hypot(tolerance, FIT.sure * quantity.deviation)


def _finding(recordings: str, quantity: Calibrated) -> FitFinding:
    keys = tuple(quantity.changes)
    unit = "" if quantity.unit == "-" else f" {quantity.unit}"
    sentence = (
        f"{', '.join(keys)}: {quantity.name} is {quantity.before:.4g}{unit} in the file, and by {recordings} "
        f"{quantity.after:.4g} ± {quantity.deviation:.2g}{unit}; `vsense calibrate` would put it there"
    )
    return FitFinding(recordings, sentence, keys)
