"""What an ordinary drive says of a car's sensors, wheels and steering: estimates, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.evaluate.printable import Printable
from vsense_ros.evaluate.terminal import plain_table
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

# Each begins with what those before it have changed: what a turn does needs the gyro's bias and the latencies.
ESTIMATORS: tuple[Estimator, ...] = (radii, course, steering, inertial, noise_levels)


@dataclass(frozen=True, repr=False)
class Calibration(Printable):
    """A vehicle before and after, every quantity that was looked at, and sentences about sensors that are missing."""

    before: Vehicle
    vehicle: Vehicle
    quantities: tuple[Calibrated, ...]
    missing: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Name of the vehicle, and how many quantities changed."""
        changed = sum(one.is_changed for one in self.quantities)
        return f"{self.vehicle.name}, {changed} of {len(self.quantities)} quantities changed"

    def show(self, out: Console) -> None:
        """Print what changed, by how much and how sure that is, and what to drive next."""
        table = plain_table("quantity", "before", "after", "±", "unit", "", right=("before", "after", "±"))
        for one in self.quantities:
            stays = "agrees with the file, stays" if one.determined else "not determined, stays"
            after, words = (f"{one.after:.4g}", "") if one.is_changed else (f"({one.after:.4g})", stays)
            table.add_row(one.name, f"{one.before:.4g}", after, f"{one.deviation:.2g}", one.unit, words)
        out.print(table)
        for sentence in self.missing:
            out.print(sentence)
        for advice in self.advice:
            out.print(f"To drive next: {advice}.")

    @property
    def paths(self) -> tuple[str, ...]:
        """Dotted paths of the numbers whose value or standard deviation has changed."""
        return tuple(path for one in self.quantities for path, _, _ in one.written())

    @property
    def advice(self) -> tuple[str, ...]:
        """What to drive next for the quantities that the drives do not determine, each once."""
        return tuple(dict.fromkeys(one.drive_next for one in self.quantities if not one.determined and one.drive_next))


def calibrate(recordings: Sequence[Recording], vehicle: Vehicle) -> Calibration:
    """Calibrate a vehicle by ordinary drives. References in the recordings are not looked at.

    Raises `InputError` for recordings without a GNSS velocity or a yaw rate, that are too short, or in which the car
    hardly drives.
    """
    car, found = vehicle, []
    drives = [drive_of(recording, car) for recording in recordings]
    _check_that_it_drives(drives)
    missing = _missing(drives)
    source = "calibrated by " + ", ".join(recording.name for recording in recordings)
    for estimator in ESTIMATORS:
        made = list(estimator([drive_of(recording, car) for recording in recordings], car))
        car = apply(car, made, source)
        found += made
    return Calibration(vehicle, car, tuple(found), missing)


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
