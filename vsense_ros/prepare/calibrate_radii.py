"""Rolling radii: speed over ground by GNSS over the spin of the wheels, straight ahead at a constant speed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.regression import posterior
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrated import Calibrated, Change
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive

Array = NDArray[np.float64]


def radii(drives: Sequence[CalibrationDrive], car: Vehicle) -> Iterator[Calibrated]:
    """Unloaded radii of both axles, such that the loaded tyres roll as they did."""
    nominal_radii = rolling_radii(car)
    for axle, wheels in (("front", slice(0, 2)), ("rear", slice(2, 4))):
        if all(np.isnan(drive.spin).all() for drive in drives):
            continue
        blocks: list[tuple[Array, Array]] = []
        for drive in drives:
            spin = drive.smooth(drive.spin[:, wheels].mean(axis=1))
            straight = np.abs(drive.yaw_rate) < CALIBRATION.straight
            steady = np.abs(drive.slope(drive.speed)) < CALIBRATION.steady
            blocks += drive.blocks(spin[:, None], drive.speed, drive.driving & straight & steady)
        path, before = f"physics.{axle}.unloaded_radius", float(nominal_radii[wheels][0])
        unloaded = getattr(car.physics, axle).unloaded_radius
        prior = car.deviations().get(f"{axle}.unloaded_radius", car.observer.surroundings.radius_error * unloaded)
        advice = "straight ahead at a constant speed above 50 km/h for two minutes, with GNSS"
        if not blocks:
            yield Calibrated(f"rolling radius, {axle}", "m", before, before, prior, prior, {}, advice)
            continue
        estimated = posterior(blocks, np.array([before]), np.array([prior]))
        after, deviation = float(estimated.values[0]), float(estimated.deviations[0])
        changes = {path: Change(round(unloaded + after - before, 5), deviation)}
        yield Calibrated(f"rolling radius, {axle}", "m", before, after, prior, deviation, changes, advice)
