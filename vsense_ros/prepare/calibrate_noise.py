"""Noise of the sensors on the car: what messages a tenth of a second apart differ by beyond the motion, and what their
uncertain latency makes of the motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.sensors import Imu, WheelSpeeds
from vsense_ros.model.sensors.gnss_velocity import GnssVelocity
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrated import Calibrated, Change
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive


def noise_levels(drives: Sequence[CalibrationDrive], car: Vehicle) -> Iterator[Calibrated]:
    """Standard deviations of gyros, accelerometers, wheel speeds and the GNSS velocity."""
    for name, sensor in car.sensors.items():
        path = f"sensors.{name}"
        if isinstance(sensor, Imu):
            for key, field, unit, before in (
                ("rates", "rate_noise", "rad/s", sensor.rate_noise),
                ("forces", "force_noise", "m/s²", sensor.force_noise),
            ):
                for axis, level in enumerate(_levels(drives, key, _latency(car, name))):
                    if np.isfinite(level):
                        words = f"noise of the {'gyro' if key == 'rates' else 'accelerometer'} {'xyz'[axis]}"
                        yield _noise(words, unit, before[axis], level, f"{path}.{field}.{axis}")
        elif isinstance(sensor, WheelSpeeds | GnssVelocity):
            key = "spin" if isinstance(sensor, WheelSpeeds) else "velocity"
            levels = _levels(drives, key, _latency(car, name))
            if np.isfinite(levels).any():
                words, unit = ("wheel speeds", "rad/s") if key == "spin" else ("the GNSS velocity", "m/s")
                yield _noise(f"noise of {words}", unit, sensor.noise, float(np.nanmax(levels)), f"{path}.noise")


def _levels(drives: Sequence[CalibrationDrive], key: str, latency: float) -> NDArray[np.float64]:
    """Root mean square over drives of the scatter of each component, and of its change in the standard deviation
    `latency` [s] of its age; NaN where it is not known."""
    powers = []
    for drive in drives:
        if key in drive.noise:
            change = latency * drive.slope(drive.smooth(getattr(drive, key)))
            moving = np.isfinite(change)
            power = np.where(moving, change, 0.0) ** 2
            powers.append(drive.noise[key] ** 2 + power.sum(axis=0) / np.maximum(moving.sum(axis=0), 1))
    return np.asarray(np.sqrt(np.mean(powers, axis=0))) if powers else np.array([np.nan])


def _latency(car: Vehicle, name: str) -> float:
    """Standard deviation of the latency of a sensor [s], which the drives have left."""
    stated = car.uncertainty.get(f"sensors.{name}.latency")
    if stated is None:  # of the two between which a latency was measured, the other one is the late one
        deviations = [
            stated_latency.deviation for path, stated_latency in car.uncertainty.items() if path.endswith(".latency")
        ]
        return max(deviations, default=0.0) / 2
    return stated.deviation


def _noise(words: str, unit: str, before: float, level: float, path: str) -> Calibrated:
    after = float(f"{max(level, CALIBRATION.least_noise_share * before):.3g}")
    return Calibrated(words, unit, before, after, max(before, after), 0.1 * after, {path: Change(after)})
