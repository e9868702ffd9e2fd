"""Steering ratio, offset and understeer: the steering angle against curvature and lateral acceleration.

In slow turns and fast ones alike, δ = g (L r / V + K V r) + offset, where g is the true ratio over the file's, L the
wheelbase and K the understeer gradient, which is the cornering compliance of the front axle less that of the rear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.regression import posterior
from vsense_ros.model.sensors import Steering
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_course import compliance, relative_compliance
from vsense_ros.prepare.calibrated import Calibrated, Change
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive

Array = NDArray[np.float64]

_ADVICE = "tight bends at 15 to 30 km/h, as in a car park, and bends of a country road, with GNSS"


def steering(drives: Sequence[CalibrationDrive], car: Vehicle) -> Iterator[Calibrated]:
    """Steering ratio, its offset, and cornering stiffness of the front axle."""
    sensor = next(((name, s) for name, s in car.sensors.items() if isinstance(s, Steering)), None)
    chassis, around = car.physics.chassis, car.observer.surroundings
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    blocks: list[tuple[Array, Array]] = []
    for drive in drives:
        # A slow receiver knows a speed, which changes slowly; a turn at a junction is over in a few of its messages.
        speed, rate, angle = (
            drive.smooth(component, CALIBRATION.cut_off)
            for component in (np.hypot(*drive.velocity.T), drive.rates[:, 2], drive.steering)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            x = np.column_stack([wheelbase * rate / speed, speed * rate, np.ones(len(speed)), drive.slope(angle)])
        blocks += drive.blocks(x, angle, drive.driving)
    if sensor is None or not blocks:
        return
    front, rear = compliance(car, "front"), compliance(car, "rear")
    name, settings = sensor
    own_scale = settings.ratio is not None or any(drive.at_road_wheel for drive in drives)
    path, before = (
        (f"sensors.{name}.gain", settings.gain) if own_scale else ("physics.steering.ratio", car.physics.steering.ratio)
    )
    stated = _relative_deviation(car, path, before)
    spread = np.hypot(relative_compliance(car, "front") * front, relative_compliance(car, "rear") * rear)
    prior = np.array([stated, spread, max(around.steering_offset, 1e-4), CALIBRATION.lag_deviation])
    estimated = posterior(blocks, np.array([1.0, front - rear, 0.0, 0.0]), prior)
    share, share_deviation = float(estimated.values[0]), float(estimated.deviations[0])
    yield (
        _gain(name, before, stated, share, share_deviation)
        if own_scale
        else _ratio(before, stated, share, share_deviation)
    )
    yield _offset(float(estimated.values[2]) / share, float(estimated.deviations[2]) / share, around.steering_offset)
    after = float(estimated.values[1]) / share + rear
    deviation = float(np.hypot(estimated.deviations[1] / share, relative_compliance(car, "rear") * rear))
    scale, after = car.physics.front.cornering_scale, max(after, 0.2 * front)
    value = scale * front / after
    yield Calibrated(
        "cornering stiffness of the front axle over the file's tyre", "-", scale, value,
        relative_compliance(car, "front") * scale, deviation / after * value,
        {"physics.front.cornering_scale": Change(round(value, 4), deviation / after * value)},
        "bends at 60 km/h and more with 2 to 4 m/s², as a winding road has, with GNSS",
    )  # fmt: skip


def _relative_deviation(car: Vehicle, path: str, value: float) -> float:
    """Standard deviation of a number of the file over its value [-], or what is usual where the file does not say."""
    stated = car.uncertainty.get(path)
    return CALIBRATION.ratio_deviation if stated is None else stated.deviation / value


def _gain(name: str, before: float, prior: float, share: float, deviation: float) -> Calibrated:
    """Gain of a sensor that does not use the car's steering ratio: it reports the angle of the road wheels, or has a
    ratio of its own. `share` is the measured angle over the true one, with its standard deviation [-]."""
    after = before / share
    return Calibrated(
        "steering gain, true over measured road-wheel angle", "-", before, after, prior * before, deviation * after,
        {f"sensors.{name}.gain": Change(round(after, 4), deviation * after)}, _ADVICE,
    )  # fmt: skip


def _ratio(before: float, prior: float, share: float, deviation: float) -> Calibrated:
    """Steering ratio of the car; `share` is the true one over that of the file, with its standard deviation [-]."""
    after = before * share
    return Calibrated(
        "steering ratio", "-", before, after, prior * before, deviation * before,
        {"physics.steering.ratio": Change(round(after, 3), deviation * before)}, _ADVICE,
    )  # fmt: skip


def _offset(value: float, deviation: float, before: float) -> Calibrated:
    """The observer estimates the offset itself: the file says how large it may be."""
    size = float(f"{np.hypot(value, 2 * deviation):.2g}")
    return Calibrated(
        "offset of the steering, at the road wheels", "rad", 0.0, value, before, deviation,
        {"observer.surroundings.steering_offset": Change(max(size, 2e-4))},
        "straight ahead for two minutes",
    )  # fmt: skip
