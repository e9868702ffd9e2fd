"""What an ordinary drive says of a car's sensors, wheels and steering: estimates, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.evaluate.printable import Printable
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.identification.prediction import Comparison, compare, predict
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_course import course
from vsense_ros.prepare.calibrate_inertial import inertial
from vsense_ros.prepare.calibrate_noise import noise_levels
from vsense_ros.prepare.calibrate_radii import radii
from vsense_ros.prepare.calibrate_steering import steering
from vsense_ros.prepare.calibrated import Calibrated, apply
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive, drive_of

if TYPE_CHECKING:
    from rich.console import Console

Estimator = Callable[[Sequence[CalibrationDrive], Vehicle], Iterable[Calibrated]]

# By what they estimate. Each begins with what those before it have changed: what a turn does needs the gyro's bias and
# the latencies.
ESTIMATORS: Mapping[str, Estimator] = {
    "rolling radii": radii,
    "yaw rate, latency, antenna and rear tyres": course,
    "steering and front tyres": steering,
    "mounting and offsets of the inertial sensor": inertial,
    "noise": noise_levels,
}


@dataclass(frozen=True, repr=False)
class Calibration(Printable):
    """A vehicle before and after, every quantity that was looked at, and sentences about sensors that are missing.

    `verdict` compares how well the observer predicts with both files, where that was judged (`calibrate_and_judge`);
    `refused` are parts of the calibration with which it predicts worse, and which therefore are not in the file.
    """

    before: Vehicle
    vehicle: Vehicle
    quantities: tuple[Calibrated, ...]
    missing: tuple[str, ...] = ()
    verdict: Comparison | None = None
    refused: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Name of the vehicle, and how many quantities changed."""
        changed = sum(quantity.is_changed for quantity in self.quantities)
        return f"{self.vehicle.name}, {changed} of {len(self.quantities)} quantities changed"

    def show(self, out: Console) -> None:
        """Print what changed, by how much and how sure that is, and what to drive next."""
        table = plain_table("quantity", "before", "after", "±", "unit", "", right=("before", "after", "±"))
        for quantity in self.quantities:
            stays = "agrees with the file, stays" if quantity.determined else "not determined, stays"
            after, verdict = (
                (f"{quantity.after:.4g}", "") if quantity.is_changed else (f"({quantity.after:.4g})", stays)
            )
            table.add_row(
                quantity.name, f"{quantity.before:.4g}", after, f"{quantity.deviation:.2g}", quantity.unit, verdict
            )
        out.print(table)
        for sentence in (*self.missing, *self.judgement):
            out.print(sentence)
        for advice in self.advice:
            out.print(f"To drive next: {advice}.")

    @property
    def judgement(self) -> tuple[str, ...]:
        """What the prediction says of the new file, and what was refused because of it, a sentence each."""
        refused = tuple(
            f"Refused: {name}. With it the observer predicts the course worse than without; the file keeps its values."
            for name in self.refused
        )
        return refused if self.verdict is None else (self.verdict.sentence, *refused)

    @property
    def paths(self) -> tuple[str, ...]:
        """Dotted paths of the numbers whose value or standard deviation has changed."""
        return tuple(path for quantity in self.quantities for path, _, _ in quantity.written())

    @property
    def advice(self) -> tuple[str, ...]:
        """What to drive next for the quantities that the drives do not determine, each once."""
        return tuple(
            dict.fromkeys(
                quantity.drive_next for quantity in self.quantities if not quantity.determined and quantity.drive_next
            )
        )


def calibrate(
    recordings: Sequence[Recording], vehicle: Vehicle, estimators: Mapping[str, Estimator] = ESTIMATORS
) -> Calibration:
    """Calibrate a vehicle by ordinary drives. References in the recordings are not looked at.

    Raises `InputError` for recordings without a GNSS velocity or a yaw rate, that are too short, or in which the car
    hardly drives.
    """
    car, quantities = vehicle, []
    drives = [drive_of(recording, car) for recording in recordings]
    _check_that_it_drives(drives)
    missing = _missing(drives)
    for estimator in estimators.values():
        estimated = list(estimator([drive_of(recording, car) for recording in recordings], car))
        car = apply(car, estimated, _source(recordings))
        quantities += estimated
    return Calibration(vehicle, car, tuple(quantities), missing)


def calibrate_and_judge(recordings: Sequence[Recording], vehicle: Vehicle) -> Calibration:
    """Calibrate a vehicle as `calibrate` does, and keep only what lets the observer predict no worse than before.

    The observer predicts the course in silences of the receiver (`identification/prediction.py`) with the file before
    and the file after. If it predicts worse, the parts of the calibration are tried one by one, and those with which it
    predicts worse are left out. Raises `InputError` as `calibrate` does.
    """
    calibration = calibrate(recordings, vehicle)
    before = predict(recordings, vehicle)
    verdict = compare(before, predict(recordings, calibration.vehicle))
    if not verdict.is_worse:
        return replace(calibration, verdict=verdict)
    accepted: dict[str, Estimator] = {}
    refused: list[str] = []
    calibration, best = calibrate(recordings, vehicle, accepted), before
    for name, estimator in ESTIMATORS.items():
        tried = calibrate(recordings, vehicle, {**accepted, name: estimator})
        predicted = predict(recordings, tried.vehicle)
        if compare(best, predicted).is_worse:
            refused.append(name)
        else:
            accepted[name], calibration, best = estimator, tried, predicted
    return replace(calibration, verdict=compare(before, best), refused=tuple(refused))


def _source(recordings: Sequence[Recording]) -> str:
    """What the vehicle file says of where a calibrated number comes from."""
    return "calibrated by " + ", ".join(recording.name for recording in recordings)


def _check_that_it_drives(drives: Sequence[CalibrationDrive]) -> None:
    """Raises `InputError` where the car stands, or nearly so, in all drives together."""
    seconds = sum(float(drive.driving.sum()) for drive in drives) * CALIBRATION.step
    if seconds < CALIBRATION.block:
        names = ", ".join(drive.name for drive in drives)
        raise InputError(
            f"{names}: the car drives faster than {CALIBRATION.least_speed:g} m/s for {seconds:.0f} s only; expected "
            f"{CALIBRATION.block:.0f} s of ordinary driving or more"
        )


def _missing(drives: Sequence[CalibrationDrive]) -> tuple[str, ...]:
    """What cannot be calibrated because no drive has the signal, a sentence each."""
    signals = (
        (
            "steering",
            "steering angle (vehicle/steering)",
            "steering ratio, its offset and the front cornering stiffness",
        ),
        ("spin", "speeds of four wheels (vehicle/wheel_speeds)", "rolling radii"),
        ("forces", "accelerations (imu/data)", "the mounting of the inertial sensor and its offsets"),
    )
    return tuple(
        f"No {words} in {', '.join(drive.name for drive in drives)}: {stays} stay as they are in the file."
        for name, words, stays in signals
        if not any(np.isfinite(getattr(drive, name)).any() for drive in drives)
    )
